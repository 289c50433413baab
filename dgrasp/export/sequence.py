"""Evaluated sequences on disk: one self-contained .npz for each, written by `test.py --records DIR`.

Members (T control steps; m, rad, s, world frame with z up; float32 unless stated otherwise):
- `meta`: a JSON text with method, engine, window_s, timestep_s, dt, window_start, terminated, table, the label's
  object and index, the result row, the stamp of the data, the names of the hand's joints, parts and key points, and,
  for a hand made from MANO, its side and betas.
- `gc` (T, D), `T_WH`, `T_WO` (T, 4, 4), `joints_W` (T, K, 3), `contact_impulse` (T, P) N s per substep, `contacts`
  (T, P) and `table_contact` (T,) bool, `reward` (T,): as in `EpisodeRecord`.
- `target_T_WO` (T, 4, 4), or (4, 4) for a constant pose: the record's T_WG, if it has one.
- `label_*`: the grasp label, float64.
- `parents` (P,), `offsets` (P, 3), `joint_parts` (J,), `axes` (J, 3), `joint_frames` (J, 3, 3), `keypoint_parts` (K,),
  `keypoint_offsets` (K, 3): the hand's `Kinematics`, float64 and int64.
- `mesh_vertices` (V, 3), `mesh_faces` (F, 3), `mesh_sizes` (P + 1, 2) int32: light meshes of the parts and the object,
  concatenated; `mesh_sizes` has each mesh's numbers of vertices and faces.
- `shape_vertices`, `shape_faces`, `shape_sizes`: the same for their collision shapes. Older files lack them.

Files of schema 1 have no names, and of the kinematics only `offsets`; their hands have MANO's joints.
"""

from __future__ import annotations

import io
import json
import os
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from dgrasp.errors import DataError
from dgrasp.eval.failures import KINDS
from dgrasp.files.atomic import write_atomic
from dgrasp.files.npz import open_npz
from dgrasp.hand.kinematics import Kinematics
from dgrasp.hand.layout import N_WRIST, HandNames
from dgrasp.hand.mano.layout import MANO_NAMES, mano_kinematics
from dgrasp.types import Array, EpisodeRecord, GraspLabel
from dgrasp.view.meshes import DisplayMeshes, Mesh

FORMAT, SCHEMA = "dgrasp-sequence", 2
MAX_BYTES = 256 * 2**20

_STATES = ("gc", "T_WH", "T_WO", "joints_W", "contact_impulse", "contacts", "table_contact", "reward")
_LABEL = ("hand_pose", "T_WH", "T_WO", "joints_W", "goal_contacts")
_CHAIN = tuple(field.name for field in fields(Kinematics))
_MESHES, _SHAPES = (tuple(f"{kind}_{name}" for name in ("vertices", "faces", "sizes")) for kind in ("mesh", "shape"))
_MASKS = ("contacts", "table_contact", "goal_contacts")
_ABOUT = {"method": str, "engine": str, "window_s": float, "timestep_s": float, "dt": float, "window_start": int,
          "terminated": str, "table": dict, "label": dict, "row": dict, "data": dict}


_NUMBERS = ("lost_s", "mpe_m", "geodesic_rad", "sim_dist_mm_per_step", "contact_ratio", "interpenetration_cm3")
"""Entries of a row that pages show as numbers."""


@dataclass(frozen=True, eq=False)
class StoredSequence:
    """An evaluated sequence, the meshes that draw it, and the names of the hand's joints, parts and key points.

    about: method, engine, window_s, timestep_s, table ("top_m", "lowered_m"), row (of the result), data (the stamp),
    and mano: for a hand made from MANO its side, betas and, if known, root_joint (3,) m; None for other hands.
    """

    record: EpisodeRecord
    meshes: DisplayMeshes
    names: HandNames
    about: dict[str, Any]


def file_name(label: GraspLabel) -> str:
    """The file name of a label's sequence, such as `004_sugar_box_0003.npz`."""
    return f"{label.object_id}_{label.index:04d}.npz"


def check_folder(folder: Path) -> None:
    """Raise `DataError` unless `folder` is new or empty."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise DataError(f"{folder} exists and is not an empty folder; choose another one, or remove it")


def write_folder(folder: Path, sequences: Iterable[StoredSequence]) -> int:
    """Write one file for each sequence; returns how many. Raises `DataError` for a folder that is not empty."""
    check_folder(folder)
    written: set[str] = set()
    for sequence in sequences:
        name = file_name(sequence.record.label)
        if name in written:
            # A label file with two sources can have two labels with the same object and index.
            name = f"{name[:-4]}_{len(written)}.npz"
        write_sequence(folder / name, sequence)
        written.add(name)
    return len(written)


def write_sequence(path: Path, sequence: StoredSequence) -> None:
    """Write one sequence atomically."""
    record, meshes, label = sequence.record, sequence.meshes, sequence.record.label
    meta = {
        "format": FORMAT, "schema": SCHEMA, **sequence.about, "dt": record.dt, "window_start": record.window_start,
        "terminated": record.terminated,
        "label": {"object": label.object_id, "index": label.index, "source": label.source, "hand": label.hand,
                  "on_table": label.on_table},
        "names": asdict(sequence.names),
    }  # fmt: skip
    arrays: dict[str, Array] = {
        "meta": np.array(json.dumps(meta, allow_nan=False)),
        **{name: _packed(name, getattr(record, name)) for name in _STATES},
        **{f"label_{name}": np.asarray(getattr(label, name)) for name in _LABEL},
        **{name: np.asarray(getattr(meshes.chain, name)) for name in _CHAIN},
        **dict(zip(_MESHES, _concatenated([*meshes.hand, meshes.object]), strict=True)),
        **(dict(zip(_SHAPES, _concatenated(meshes.shapes), strict=True)) if meshes.shapes else {}),
    }
    if record.T_WG is not None:
        arrays["target_T_WO"] = np.asarray(record.T_WG, dtype=np.float32)
    stream = io.BytesIO()
    packed: dict[str, Any] = arrays
    np.savez_compressed(stream, **packed)
    write_atomic(path, stream.getvalue())


def _packed(name: str, values: Array) -> Array:
    return np.asarray(values) > 0 if name in _MASKS else np.asarray(values, dtype=np.float32)


def _concatenated(meshes: Sequence[Mesh]) -> tuple[Array, Array, Array]:
    """Vertices, faces and sizes (the numbers of both for each mesh) of meshes, at least one."""
    return (np.concatenate([mesh.vertices for mesh in meshes]).astype(np.float32),
            np.concatenate([mesh.faces for mesh in meshes]).astype(np.int32),
            np.array([[len(mesh.vertices), len(mesh.faces)] for mesh in meshes], dtype=np.int32))


def read_sequence(path: Path, shapes: bool = False) -> StoredSequence:
    """Read a sequence that `write_sequence` wrote. Raises `DataError` for a file that is damaged or of another kind.

    shapes: refuse a file without collision shapes.
    """
    path = Path(path)
    with open_npz(path, "stored sequence", MAX_BYTES) as archive:
        if "meta.npy" not in archive.names:
            raise DataError(f"{path}: no stored sequence (no member meta); expected a file of `test.py --records DIR`")
        meta = _meta(path, archive.read("meta", "U"))
        chain_members = _CHAIN if meta["schema"] > 1 else ("offsets",)
        has_shapes = f"{_SHAPES[0]}.npy" in archive.names
        if shapes and not has_shapes:
            raise DataError(f"{path}: an older version wrote this file without collision shapes; write it again with "
                            "`test.py --records DIR`, or leave out --shapes")
        mesh_members = (*_MESHES, *(_SHAPES if has_shapes else ()))
        required = [*_STATES, *(f"label_{name}" for name in _LABEL), *chain_members, *mesh_members]
        lacking = [name for name in required if f"{name}.npy" not in archive.names]
        if lacking:
            raise DataError(f"{path}: lacks {', '.join(lacking)}; write it again with `test.py --records DIR`")
        a = {name: archive.read(name, "biuf") for name in required}
        T_WG = archive.read("target_T_WO", "f") if "target_T_WO.npy" in archive.names else None
    steps = len(a["gc"]) if a["gc"].ndim else 0
    names = _names(path, meta)
    for name, shape in _expected(names, steps, chain_members, mesh_members).items():
        if a[name].shape != shape:
            raise DataError(f"{path}: {name} has shape {a[name].shape}; expected {shape}; write the file again")
    if T_WG is not None and T_WG.shape not in ((4, 4), (steps, 4, 4)):
        raise DataError(f"{path}: target_T_WO has shape {T_WG.shape}; expected (4, 4) or {(steps, 4, 4)}")
    bad = [name for name in (*chain_members, *mesh_members) if not np.isfinite(a[name]).all()]
    if bad:
        raise DataError(f"{path}: {', '.join(bad)} hold NaN or infinity; write the file again")
    chain = _chain(path, a) if meta["schema"] > 1 else mano_kinematics(a["offsets"])
    if not steps:
        raise DataError(f"{path}: the sequence has no steps: its simulation broke at once")
    place = meta["label"]
    label = GraspLabel(
        object_id=str(place["object"]), hand_pose=a["label_hand_pose"], T_WH=a["label_T_WH"], T_WO=a["label_T_WO"],
        joints_W=a["label_joints_W"], goal_contacts=a["label_goal_contacts"] > 0, start=None, hand=str(place["hand"]),
        source=str(place["source"]), index=int(place["index"]), on_table=bool(place["on_table"]),
    )  # fmt: skip
    states: dict[str, Any] = {name: a[name].astype(bool if name == "table_contact" else float) for name in _STATES}
    record = EpisodeRecord(
        label=label, **states, window_start=meta["window_start"], dt=meta["dt"], terminated=meta["terminated"],
        T_WG=None if T_WG is None else np.broadcast_to(T_WG, (steps, 4, 4)).astype(np.float64),
    )  # fmt: skip
    bodies = (*names.parts, "object")
    meshes = _meshes(path, bodies, _MESHES, a)
    collision = _meshes(path, bodies, _SHAPES, a) if has_shapes else []
    about = {key: meta[key] for key in ("method", "engine", "window_s", "timestep_s", "table", "row", "data")}
    drawn = DisplayMeshes(chain, names.parts, tuple(meshes[:-1]), meshes[-1], tuple(collision))
    return StoredSequence(record, drawn, names, {**about, "mano": meta.get("mano")})


def _expected(
    names: HandNames, steps: int, chain_members: Sequence[str], mesh_members: Sequence[str]
) -> dict[str, tuple[int, ...]]:
    """Member -> its expected shape. steps: T."""
    joints, parts, points = len(names.joints), len(names.parts), len(names.keypoints)
    states: dict[str, tuple[int, ...]] = {
        "gc": (N_WRIST + joints,), "T_WH": (4, 4), "T_WO": (4, 4), "joints_W": (points, 3),
        "contact_impulse": (parts,), "contacts": (parts,), "table_contact": (), "reward": (),
    }  # fmt: skip
    chain: dict[str, tuple[int, ...]] = {
        "parents": (parts,), "offsets": (parts, 3), "joint_parts": (joints,), "axes": (joints, 3),
        "joint_frames": (joints, 3, 3), "keypoint_parts": (points,), "keypoint_offsets": (points, 3),
    }  # fmt: skip
    label = {"hand_pose": (joints,), "goal_contacts": (parts,)}
    return {
        **{name: (steps, *states[name]) for name in _STATES},
        **{f"label_{name}": label.get(name, states.get(name, ())) for name in _LABEL},
        **{name: chain[name] for name in chain_members},
        **{name: (parts + 1, 2) for name in mesh_members if name.endswith("sizes")},
    }  # fmt: skip


def _names(path: Path, meta: dict[str, Any]) -> HandNames:
    if meta["schema"] == 1:
        return MANO_NAMES
    told = meta.get("names")
    tables = [told.get(field.name) for field in fields(HandNames)] if isinstance(told, dict) else [None]
    if not all(isinstance(table, list) and table and all(isinstance(name, str) for name in table) for table in tables):
        raise DataError(f"{path}: its description does not name joints, parts and key points; write the file again")
    return HandNames(*(tuple(table or ()) for table in tables))


def _chain(path: Path, a: dict[str, Array]) -> Kinematics:
    parts, index = len(a["parents"]), np.arange(len(a["parents"]))
    whole = all(a[name].dtype.kind in "iu" for name in ("parents", "joint_parts", "keypoint_parts"))
    if not whole or a["parents"][0] != -1 or (a["parents"][1:] >= index[1:]).any() or (a["parents"][1:] < 0).any() or (
        any((a[name] < 0).any() or (a[name] >= parts).any() for name in ("joint_parts", "keypoint_parts"))
    ):
        raise DataError(f"{path}: parents, joint_parts or keypoint_parts name no parts of the hand; write it again")
    return Kinematics(**{name: a[name] for name in _CHAIN})


def _no_constant(text: str) -> float:
    raise ValueError(f"{text} is not a JSON number")


def _meta(path: Path, text: Array) -> dict[str, Any]:
    try:
        meta = json.loads(str(text[()]), parse_constant=_no_constant) if text.shape == () else None
    except (ValueError, RecursionError):
        meta = None
    if not isinstance(meta, dict) or meta.get("format") != FORMAT:
        raise DataError(f"{path}: no stored sequence; expected a file of `test.py --records DIR`")
    if meta.get("schema") not in (1, SCHEMA):
        raise DataError(f"{path}: schema {meta.get('schema')}; this program reads 1 to {SCHEMA}; write the file again "
                        "with `test.py --records DIR`")
    wrong = [key for key, kind in _ABOUT.items() if not isinstance(meta.get(key), kind)]
    if not wrong:
        label, table, mano = meta["label"], meta["table"], meta.get("mano")
        sound = {
            "label": not {"object", "index", "source", "hand", "on_table"} - set(label) and type(label["index"]) is int,
            "table": all(isinstance(table.get(key), int | float) for key in ("top_m", "lowered_m")),
            "dt": meta["dt"] > 0.0,
            "timestep_s": meta["timestep_s"] > 0.0,
            "row": all(isinstance(value, str | int | float) for value in meta["row"].values())
            and all(isinstance(meta["row"].get(key, 0.0), int | float) for key in _NUMBERS)
            and meta["row"].get("failure", KINDS[0]) in KINDS,
            "window_start": meta["window_start"] >= 0,
            "mano": mano is None or (isinstance(mano, dict) and mano.get("side") in ("right", "left")
                                     and isinstance(mano.get("betas"), list)),
        }
        wrong = [key for key, ok in sound.items() if not ok]
    if wrong:
        raise DataError(f"{path}: its description is incomplete or wrong ({', '.join(wrong)}); write it again with "
                        "`test.py --records DIR`")
    return meta


def _meshes(path: Path, bodies: Sequence[str], members: Sequence[str], a: dict[str, Array]) -> list[Mesh]:
    vertices, faces, sizes = (a[member] for member in members)
    if vertices.ndim != 2 or faces.ndim != 2 or vertices.shape[1] != 3 or faces.shape[1] != 3 or (sizes < 0).any() or (
        tuple(sizes.sum(axis=0)) != (len(vertices), len(faces))
    ):
        raise DataError(f"{path}: {members[2]} do not add up to {members[0]} and {members[1]}; write the file again")
    meshes: list[Mesh] = []
    v = f = 0
    for n_vertices, n_faces in sizes.tolist():
        own = faces[f : f + n_faces]
        if n_faces and not 0 <= own.min() <= own.max() < n_vertices:
            raise DataError(f"{path}: a face of {bodies[len(meshes)]} names a vertex that does not exist")
        meshes.append(Mesh(vertices[v : v + n_vertices].astype(np.float64), own.astype(np.int64)))
        v, f = v + n_vertices, f + n_faces
    return meshes


def sequence_files(source: Path) -> list[Path]:
    """The stored sequences of `source`: the file itself, or every .npz of a folder."""
    if os.path.isfile(source):
        return [source]
    found: Sequence[Path] = sorted(source.glob("*.npz")) if os.path.isdir(source) else []
    if not found:
        raise DataError(f"{source}: no stored sequences; expected a file, or a folder of `test.py --records DIR`")
    return list(found)
