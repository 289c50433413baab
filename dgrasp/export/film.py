"""Export a sequence as a video, drawn by PyBullet's software renderer: GIF, or mp4 with imageio-ffmpeg."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from dgrasp.errors import ConfigError, DataError
from dgrasp.export.sequence import StoredSequence
from dgrasp.geometry.part_mesh import PartMesh
from dgrasp.hand.build.build import write_obj
from dgrasp.scene.scene import LOWERED_TOP, TABLE_SIZE, TABLE_TOP, TABLE_XY
from dgrasp.types import Array, EpisodeRecord
from dgrasp.view.camera import eye, viewpoint
from dgrasp.view.frames import HAND_COLOR, OBJECT_COLOR, TABLE_COLOR, gif_bytes
from dgrasp.view.meshes import DisplayMeshes, body_poses, table_tops
from raisim_like.shapes import Shape
from raisim_like.world import World

SIZE = (640, 480)
"""Width and height in pixels; mp4 needs even numbers."""
GIF_EVERY = 2
"""A GIF shows every second control step, because its frames last at least 20 ms."""


def pictures(sequence: StoredSequence, every: int = 1, size: tuple[int, int] = SIZE) -> Iterator[Array]:
    """Frames (height, width, 3) uint8, one every `every` control steps."""
    table = sequence.about["table"]
    yield from record_pictures(sequence.record, sequence.meshes, (table["top_m"], table["lowered_m"]), every, size)


def record_pictures(
    record: EpisodeRecord, meshes: DisplayMeshes, table_m: tuple[float, float] = (TABLE_TOP, LOWERED_TOP),
    every: int = 1, size: tuple[int, int] = SIZE,
) -> Iterator[Array]:  # fmt: skip
    """`pictures` of a record. table_m: height of the table's top before and after the table is taken away, m."""
    q, t = body_poses(meshes, record)
    tops = table_tops(record, *table_m)
    target, yaw = viewpoint(record)
    world = World("pybullet")
    try:
        with tempfile.TemporaryDirectory() as folder:
            bodies = {}
            for body, name in enumerate(meshes.bodies):
                shape = meshes.object if name == "object" else meshes.hand[body]
                if len(shape.faces):
                    file = Path(folder) / f"{name}.obj"
                    write_obj(file, PartMesh(name, shape.vertices, shape.faces))
                    bodies[body] = world.add_body([Shape("mesh", file=file)], 0.0, np.eye(3))
                    bodies[body].set_color(OBJECT_COLOR if name == "object" else HAND_COLOR)
        table = world.add_body([Shape("box", TABLE_SIZE)], 0.0, np.eye(3))
        table.set_color(TABLE_COLOR)
        for step in range(0, len(t), every):
            for body, solid in bodies.items():
                solid.set_state(t[step, body], q[step, body])
            table.set_state((*TABLE_XY, tops[step] - TABLE_SIZE[2] / 2))
            yield world.render(eye(target, yaw), target, *size).copy()
    finally:
        world.close()


def gif(sequence: StoredSequence) -> bytes:
    """The bytes of an endless GIF at the sequence's own speed."""
    return gif_bytes(list(pictures(sequence, GIF_EVERY)), GIF_EVERY * sequence.record.dt)


def write_mp4(path: Path, sequence: StoredSequence) -> None:
    """Write an mp4 (H.264) at the sequence's own speed, atomically.

    Raises `ConfigError` if imageio-ffmpeg is not installed, `DataError` if the file cannot be written.
    """
    try:
        import imageio_ffmpeg
    except ImportError:
        raise ConfigError("mp4 needs imageio-ffmpeg, which is not installed; pip install 'dgrasp[video]', or export gif"
                          ) from None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as folder:
            part = Path(folder) / "film.mp4"
            writer = imageio_ffmpeg.write_frames(str(part), SIZE, fps=1.0 / sequence.record.dt, quality=7,
                                                 macro_block_size=2, ffmpeg_log_level="error")
            writer.send(None)
            try:
                for picture in pictures(sequence):
                    writer.send(np.ascontiguousarray(picture))
            finally:
                writer.close()
            os.replace(part, path)
    except OSError as error:
        raise DataError(f"{path}: cannot be written ({error.strerror or error})") from None
