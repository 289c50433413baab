"""A sequence as moving pictures: GIF, or mp4 with imageio-ffmpeg."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from dgrasp.errors import ConfigError, DataError
from dgrasp.export.sequence import StoredSequence
from dgrasp.files.atomic import write_atomic
from dgrasp.types import Array
from dgrasp.view.frames import SIZE, gif_bytes, record_pictures

GIF_EVERY = 2
"""A GIF shows every second control step, because its frames last at least 20 ms."""


def pictures(sequence: StoredSequence, every: int = 1, size: tuple[int, int] = SIZE) -> Iterator[Array]:
    """Frames (height, width, 3) uint8, one every `every` control steps."""
    table = sequence.about["table"]
    return record_pictures(sequence.record, sequence.meshes, (table["top_m"], table["lowered_m"]), every, size)


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
        with tempfile.TemporaryDirectory(prefix="dgrasp-") as folder:
            film = Path(folder) / "film.mp4"
            writer = imageio_ffmpeg.write_frames(str(film), SIZE, fps=1.0 / sequence.record.dt, quality=7,
                                                 macro_block_size=2, ffmpeg_log_level="error")
            writer.send(None)
            try:
                for picture in pictures(sequence):
                    writer.send(np.ascontiguousarray(picture))
            finally:
                writer.close()
            content = film.read_bytes()
    except OSError as error:
        raise DataError(f"{path}: the film cannot be made ({error.strerror or error})") from None
    write_atomic(path, content)
