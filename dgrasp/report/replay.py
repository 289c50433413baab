"""Replays for the page's viewer: choose the episodes, and pack meshes and poses as base64 of 16-bit numbers.

`hand` and `objects` have meshes of the surfaces; `shapes` has the same of the collision shapes, or is null if a stored
sequence lacks them.
A mesh: `v` (V x 3, uint16) are vertices, vertex = `lo` (3,) + `step` * v, m; `f` (F x 3, uint16) are faces.
A replay of n frames: `p` (n x B x 3, uint16) are positions, unpacked with the replay's own `lo` and `step`; `q` (n x B
x 4, int16) are quaternions w, x, y, z times 32767; `c` (n, uint32) has a bit for each part, set if it touches the
object. All are little endian. The B bodies are those of `DisplayMeshes.bodies`, plus the object's target if the object
is moved.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dgrasp.eval.summary import Row
from dgrasp.scene.scene import LOWERED_TOP, TABLE_TOP
from dgrasp.types import Array, EpisodeRecord
from dgrasp.view.camera import DISTANCE, viewpoint
from dgrasp.view.meshes import DisplayMeshes, Mesh, blendable, body_poses

SHOWN = 10
"""Number of replays at each end of the ranking."""
MAX_FRAMES = 320
"""Most frames of a replay; a longer episode is shown with every second step, every third step, and so on."""
REACH = 2.0
"""m. Positions are clipped, per axis, to this distance from the wrist's first position."""


def ranking(rows: Sequence[Row]) -> list[int]:
    """Indices of the rows from the best grasp to the worst.

    Held grasps come before lost ones; of the lost grasps, those that were held longer come first. Ties are ordered by
    SimDist, or, if objects are moved, by the distance to the target (MPE), smallest first.
    """
    def key(i: int) -> tuple[float, float, int]:
        row = rows[i]
        off = row["mpe_m"] if "mpe_m" in row else row.get("sim_dist_mm_per_step", np.inf)
        kept = row.get("lost_s", np.inf) if row.get("carried", True) else 0.0
        return -float(kept), float(off), i

    return sorted(range(len(rows)), key=key)


def told(row: Row) -> str:
    """The outcome of an episode in one to three words."""
    if "carried" in row:
        return "carried" if row["carried"] else "lost on the way"
    return str(row.get("failure", "held"))


def chosen(rows: Sequence[Row]) -> tuple[list[int], list[int]]:
    """Indices of the `SHOWN` worst rows, worst first, and of the `SHOWN` best, best first; no row is in both."""
    order = ranking(rows)
    best = order[: min(SHOWN, (len(order) + 1) // 2)]
    worst = order[len(best) :][-SHOWN:]
    return worst[::-1], best


def pack(
    shown: Sequence[tuple[str, EpisodeRecord, Row]], meshes: Mapping[str, DisplayMeshes]
) -> dict[str, Any]:
    """The page's data for episodes (group, record, row), with the meshes of their objects; plain JSON values."""
    shapes = {name: of.colliding() for name, of in meshes.items() if of.shapes}
    return {
        **_bodies(meshes),
        "shapes": _bodies(shapes) if len(shapes) == len(meshes) else None,
        "table": {"on": TABLE_TOP, "lowered": LOWERED_TOP},
        "replays": [_replay(group, record, row, meshes[record.label.object_id]) for group, record, row in shown],
    }


def _replay(group: str, record: EpisodeRecord, row: Row, meshes: DisplayMeshes) -> dict[str, Any]:
    stride = -(-len(record.gc) // MAX_FRAMES)
    q, t = (values[::stride] for values in body_poses(meshes, record))
    if record.T_WG is not None:
        T_WG = record.T_WG[::stride]
        q = np.concatenate([q, blendable(T_WG[:, None, :3, :3])], axis=1)
        t = np.concatenate([t, T_WG[:, None, :3, 3]], axis=1)
    t = np.clip(t, t[0, 0] - REACH, t[0, 0] + REACH)
    view = viewpoint(record)
    lo, step, places = _quantised(t)
    touching = np.asarray(record.contacts)[::stride] > 0.0
    bits = touching @ (1 << np.arange(touching.shape[1]))
    shown = ("sim_dist_mm_per_step", "contact_ratio", "interpenetration_cm3", "mpe_m", "geodesic_rad")
    return {
        "group": group, "object": row["object"], "index": row["index"],
        "outcome": told(row), "lost_s": row.get("lost_s"),
        "metrics": {name: row[name] for name in shown if name in row},
        "n": len(t), "bodies": t.shape[1], "dt": record.dt * stride, "start": (record.window_start - 1) / stride,
        "stays": record.table_stays,
        "yaw": round(view.yaw, 3), "target": [round(float(x), 4) for x in view.target],
        "zoom": round(DISTANCE / view.distance, 3),
        "lo": lo, "step": step, "p": _text(places, "<u2"), "q": _text(np.rint(q * 32767.0), "<i2"),
        "c": _text(bits, "<u4"),
    }  # fmt: skip


def _bodies(meshes: Mapping[str, DisplayMeshes]) -> dict[str, Any]:
    """The hand's parts, which are the same for all objects, and the objects."""
    first = next(iter(meshes.values()))
    return {"hand": [_mesh(part) for part in first.hand],
            "objects": {name: _mesh(of.object) for name, of in meshes.items()}}


def _mesh(mesh: Mesh) -> dict[str, Any]:
    lo, step, places = _quantised(np.asarray(mesh.vertices))
    return {"lo": lo, "step": step, "v": _text(places, "<u2"), "f": _text(mesh.faces, "<u2")}


def _quantised(points: Array) -> tuple[list[float], float, Array]:
    """Lowest corner (3,) m, step in m, and points (..., 3) in whole steps from that corner, 0 to 65535."""
    flat = points.reshape(-1, 3)
    if not len(flat):
        return [0.0, 0.0, 0.0], 1.0, points
    lo = flat.min(axis=0)
    step = max(float((flat.max(axis=0) - lo).max()) / 65535.0, 1e-9)
    return [round(float(x), 7) for x in lo], step, np.rint((points - lo) / step)


def _text(values: Array, dtype: str) -> str:
    return base64.b64encode(np.ascontiguousarray(values).astype(dtype).tobytes()).decode("ascii")
