"""Pictures of recorded episodes, without a display."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from PIL import Image

from dgrasp.config.sections import PhysicsConfig
from dgrasp.hand.model import HandModel
from dgrasp.objects.model import ObjectModel
from dgrasp.pool.base import PoolSpec
from dgrasp.scene.scene import LOWERED_TOP, TABLE_TOP, Scene
from dgrasp.types import Array, EpisodeRecord, SceneState
from raisim_like.rotations import matrix_from_euler, quaternion_from_matrix, transform
from raisim_like.shapes import Shape

HAND_COLOR = (0.92, 0.76, 0.62, 1.0)
OBJECT_COLOR = (0.25, 0.47, 0.75, 1.0)
TABLE_COLOR = (0.86, 0.84, 0.80, 1.0)


def render_record(
    record: EpisodeRecord,
    hand: HandModel,
    model: ObjectModel,
    engine: str,
    every: int = 4,
    size: tuple[int, int] = (320, 240),
) -> list[Array]:
    """Frames (height, width, 3) uint8 of an episode, one for every `every` control steps."""
    if model.mesh is not None:
        # Nothing is simulated here, and PyBullet, which draws for every engine, takes the object's mesh as it is.
        model, engine = replace(model, shapes=(Shape("mesh", file=model.mesh),)), "pybullet"
    scene = Scene(hand, model, PhysicsConfig(), engine)
    try:
        world = scene.world.engine_world
        for body, color in ((scene.hand, HAND_COLOR), (scene.object, OBJECT_COLOR), (scene.table, TABLE_COLOR)):
            world.set_color(body.id, color)
        frames = []
        first = record.T_WO[0, :3, 3]
        target = np.array([first[0], first[1], first[2] + 0.03])
        eye = target + np.array([0.45, -0.38, 0.28])
        for t in range(0, len(record.gc), every):
            gc = record.gc[t]
            # The hand's base is found from the wrist: T_WH = T_WH0 * (translation, Euler angles of gc).
            R_WH0 = record.T_WH[t, :3, :3] @ matrix_from_euler(gc[3:6]).T
            origin = record.T_WH[t, :3, 3] - R_WH0 @ gc[:3]
            scene.hand.set_base_pose(origin, quaternion_from_matrix(R_WH0))
            scene.hand.set_state(gc)
            scene.object.set_state(record.T_WO[t, :3, 3], quaternion_from_matrix(record.T_WO[t, :3, :3]))
            scene.set_table_top(TABLE_TOP if record.table_stays or t < record.window_start else LOWERED_TOP)
            frames.append(world.render(eye, target, *size).copy())
        return frames
    finally:
        scene.close()


def render_state(state: SceneState, row: int, spec: PoolSpec, size: tuple[int, int] = (320, 240)) -> Array:
    """One picture (height, width, 3) uint8 of the current state of an environment."""
    label = spec.labels[row]
    record = EpisodeRecord(
        label=label,
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
    return render_record(record, spec.hand, spec.objects[label.object_id], spec.config.engine, size=size)[0]


def gif_bytes(frames: Sequence[Array], frame_s: float) -> bytes:
    """An endless GIF of frames (height, width, 3) uint8, shown for `frame_s` seconds each on average.

    GIF counts whole hundredths of a second, and few viewers show a frame for less than two.
    """
    ends = np.rint(np.arange(len(frames) + 1) * max(frame_s, 0.02) * 100.0).astype(int)
    images = [Image.fromarray(frame).quantize(colors=96, dither=Image.Dither.NONE) for frame in frames]
    stream = io.BytesIO()
    images[0].save(
        stream, "GIF", save_all=True, append_images=images[1:], duration=(10 * np.diff(ends)).tolist(), loop=0
    )
    return stream.getvalue()


def tile(clips: Sequence[Sequence[Array]], columns: int) -> list[Array]:
    """Several clips side by side as one; shorter ones wait on their last frame."""
    length = max(len(clip) for clip in clips)
    height, width, _ = clips[0][0].shape
    rows = -(-len(clips) // columns)
    frames = []
    for t in range(length):
        canvas = np.full((rows * height, columns * width, 3), 255, np.uint8)
        for k, clip in enumerate(clips):
            y, x = (k // columns) * height, (k % columns) * width
            canvas[y : y + height, x : x + width] = clip[min(t, len(clip) - 1)]
        frames.append(canvas)
    return frames
