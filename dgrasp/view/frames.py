"""Pictures of recorded episodes, rendered without a display."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence

import numpy as np
from PIL import Image

from dgrasp.geometry.raster import Camera, Floor, draw, shaded
from dgrasp.pool.base import PoolSpec
from dgrasp.scene.scene import LOWERED_TOP, TABLE_SIZE, TABLE_TOP, TABLE_XY
from dgrasp.types import Array, EpisodeRecord, SceneState
from dgrasp.view.camera import viewpoint
from dgrasp.view.meshes import DisplayMeshes, body_poses, table_tops
from raisim_like.rotations import matrix_from_quaternion, transform

SIZE = (640, 480)
"""Width and height in pixels; mp4 needs even numbers."""
HAND_COLOR = (0.92, 0.76, 0.62)
OBJECT_COLOR = (0.25, 0.47, 0.75)
TABLE_COLOR = np.array([0.87, 0.855, 0.83])


class Stage:
    """A hand and an object over a table."""

    def __init__(self, meshes: DisplayMeshes) -> None:
        self._bodies = [shaded(*mesh, HAND_COLOR) for mesh in meshes.hand] + [shaded(*meshes.object, OBJECT_COLOR)]

    def picture(self, R: Array, t: Array, table_top: float | None, camera: Camera) -> Array:
        """(height, width, 3) uint8. R (B, 3, 3), t (B, 3) m: the bodies in the world. table_top: m; None for none."""
        bodies = [body.placed(R[i], t[i]) for i, body in enumerate(self._bodies) if len(body.faces)]
        return draw(bodies, camera, None if table_top is None else table(table_top))


def table(top: float) -> Floor:
    """The table with its top at a height, m, world."""
    half = np.array(TABLE_SIZE[:2]) / 2.0
    return Floor(np.stack([TABLE_XY - half, TABLE_XY + half]), top, TABLE_COLOR)


def record_pictures(
    record: EpisodeRecord, meshes: DisplayMeshes, table_m: tuple[float, float] = (TABLE_TOP, LOWERED_TOP),
    every: int = 1, size: tuple[int, int] = SIZE,
) -> Iterator[Array]:  # fmt: skip
    """Frames (height, width, 3) uint8 of an episode, one every `every` control steps.

    table_m: heights of the table's top, and of it once it is taken away.
    """
    q, t = body_poses(meshes, record)
    R = matrix_from_quaternion(q)
    tops = table_tops(record, *table_m)
    view = viewpoint(record)
    camera, stage = Camera(view.eye, view.target, size), Stage(meshes)
    for step in range(0, len(t), every):
        yield stage.picture(R[step], t[step], tops[step], camera)


def state_picture(
    state: SceneState, row: int, spec: PoolSpec, meshes: DisplayMeshes, size: tuple[int, int] = (320, 240)
) -> Array:
    """One picture (height, width, 3) uint8 of the current state of an environment."""
    record = EpisodeRecord(
        label=spec.labels[row],
        gc=state.gc[row : row + 1],
        T_WH=transform(state.R_WH[row], state.joints_W[row, 0])[None],
        joints_W=state.joints_W[row : row + 1],
        T_WO=transform(state.R_WO[row], state.object_pos_W[row])[None],
        contacts=state.contacts[row : row + 1],
        contact_impulse=state.contact_impulse[row : row + 1],
        table_contact=state.table_contact[row : row + 1] > 0,
        reward=np.zeros(1),
        window_start=1,
        dt=spec.config.control_period,
    )
    return next(record_pictures(record, meshes, size=size))


def gif_bytes(frames: Sequence[Array], frame_s: float) -> bytes:
    """An endless GIF of frames (height, width, 3) uint8, each shown for `frame_s` seconds on average.

    `frame_s` is raised to 0.02 s, because few viewers show a frame for a shorter time. GIF stores durations in
    hundredths of a second, so they are rounded.
    """
    ends = np.rint(np.arange(len(frames) + 1) * max(frame_s, 0.02) * 100.0).astype(int)
    images = [Image.fromarray(frame).quantize(colors=96, dither=Image.Dither.NONE) for frame in frames]
    stream = io.BytesIO()
    images[0].save(
        stream, "GIF", save_all=True, append_images=images[1:], duration=(10 * np.diff(ends)).tolist(), loop=0
    )
    return stream.getvalue()


def tile(clips: Sequence[Sequence[Array]], columns: int) -> list[Array]:
    """One clip with several clips side by side; shorter clips stay on their last frame."""
    length = max(len(clip) for clip in clips)
    height, width, _ = clips[0][0].shape
    rows = -(-len(clips) // columns)
    frames: list[Array] = []
    for t in range(length):
        canvas = np.full((rows * height, columns * width, 3), 255, np.uint8)
        for k, clip in enumerate(clips):
            y, x = (k // columns) * height, (k % columns) * width
            canvas[y : y + height, x : x + width] = clip[min(t, len(clip) - 1)]
        frames.append(canvas)
    return frames
