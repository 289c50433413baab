"""Pictures of recorded episodes, rendered without a display."""

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
from dgrasp.scene.scene import LOWERED_TOP, TABLE_TOP, scene_spec, table_state
from dgrasp.types import Array, EpisodeRecord, SceneState
from raisim_like.articulated_system import ArticulatedSystem
from raisim_like.rigid_body import RigidBody
from raisim_like.rotations import matrix_from_euler, quaternion_from_matrix, transform
from raisim_like.shapes import Shape
from raisim_like.world import World

HAND_COLOR = (0.92, 0.76, 0.62, 1.0)
OBJECT_COLOR = (0.25, 0.47, 0.75, 1.0)
TABLE_COLOR = (0.86, 0.84, 0.80, 1.0)


class Stage:
    """A hand, an object and a table that are placed and drawn but never simulated."""

    def __init__(self, hand: HandModel, model: ObjectModel, engine: str) -> None:
        self._world = World.from_spec(scene_spec(hand, model, PhysicsConfig()), engine)
        system, thing, table = self._world.objects
        assert isinstance(system, ArticulatedSystem) and isinstance(thing, RigidBody) and isinstance(table, RigidBody)
        self._hand, self._object, self._table = system, thing, table
        for item, color in ((system, HAND_COLOR), (thing, OBJECT_COLOR), (table, TABLE_COLOR)):
            item.set_color(color)

    def close(self) -> None:
        """Free the world."""
        self._world.close()

    def place(self, T_WH0: Array, gc: Array, T_WO: Array, table_top: float) -> None:
        """Place the hand's base (4, 4), its coordinates (dof,), the object (4, 4) and the table's top (m, world)."""
        self._hand.set_base_pose(T_WH0[:3, 3], quaternion_from_matrix(T_WH0[:3, :3]))
        self._hand.set_state(gc)
        self._object.set_state(T_WO[:3, 3], quaternion_from_matrix(T_WO[:3, :3]))
        self._table.set_state(table_state(table_top)[:3])

    def picture(self, eye: Array, target: Array, size: tuple[int, int]) -> Array:
        """Picture (height, width, 3) uint8 from `eye` (3,) towards `target` (3,), m, world; size: (width, height)."""
        return self._world.render(eye, target, *size).copy()


def render_record(
    record: EpisodeRecord,
    hand: HandModel,
    model: ObjectModel,
    engine: str,
    every: int = 4,
    size: tuple[int, int] = (320, 240),
) -> list[Array]:
    """Frames (height, width, 3) uint8 of an episode, one every `every` control steps."""
    if model.mesh is not None:
        # Nothing is simulated here, so the object's mesh replaces its collision shapes. PyBullet draws any mesh.
        model, engine = replace(model, shapes=(Shape("mesh", file=model.mesh),)), "pybullet"
    stage = Stage(hand, model, engine)
    try:
        frames = []
        first = record.T_WO[0, :3, 3]
        target = np.array([first[0], first[1], first[2] + 0.03])
        eye = target + np.array([0.45, -0.38, 0.28])
        for t in range(0, len(record.gc), every):
            gc = record.gc[t]
            # The hand's base follows from the wrist: T_WH = T_WH0 * (translation, Euler angles of gc).
            R_WH0 = record.T_WH[t, :3, :3] @ matrix_from_euler(gc[3:6]).T
            origin = record.T_WH[t, :3, 3] - R_WH0 @ gc[:3]
            top = TABLE_TOP if record.table_stays or t < record.window_start else LOWERED_TOP
            stage.place(transform(R_WH0, origin), gc, record.T_WO[t], top)
            frames.append(stage.picture(eye, target, size))
        return frames
    finally:
        stage.close()


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
    frames = []
    for t in range(length):
        canvas = np.full((rows * height, columns * width, 3), 255, np.uint8)
        for k, clip in enumerate(clips):
            y, x = (k // columns) * height, (k % columns) * width
            canvas[y : y + height, x : x + width] = clip[min(t, len(clip) - 1)]
        frames.append(canvas)
    return frames
