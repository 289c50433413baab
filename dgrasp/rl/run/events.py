"""A TensorBoard event file, written in the calling thread.

`SummaryWriter` is not used because it writes from its own thread, which cannot report a full disk to the caller and
does not survive a fork.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from tensorboard.compat.proto.event_pb2 import Event, SessionLog
from tensorboard.compat.proto.summary_pb2 import Summary
from tensorboard.summary.writer.record_writer import RecordWriter
from torch.utils.tensorboard.summary import custom_scalars, scalar, text


class EventFile:
    """A new event file in a run directory. All methods raise OSError if a write fails.

    purge_step: TensorBoard hides the data from this step on in earlier files of the directory.
    """

    def __init__(self, run_dir: Path, purge_step: int) -> None:
        # TensorBoard reads the files of a directory in the order of their names.
        self._stream = open(run_dir / f"events.out.tfevents.{time.time_ns()}", "wb")  # noqa: SIM115
        self._records = RecordWriter(self._stream)
        self._write(file_version="brain.Event:2", step=purge_step)
        self._write(session_log=SessionLog(status=SessionLog.START), step=purge_step)

    def scalar(self, tag: str, value: float, step: int) -> None:
        """Add a number."""
        self._write(summary=scalar(tag, value), step=step)

    def text(self, tag: str, content: str, step: int) -> None:
        """Add text, shown verbatim."""
        code_block = "\n".join(f"    {line}" for line in content.splitlines())
        self._write(summary=text(tag, code_block), step=step)

    def image(self, tag: str, encoded: bytes, height: int, width: int, step: int) -> None:
        """Add an image that is already encoded, such as the bytes of a GIF."""
        image = Summary.Image(height=height, width=width, colorspace=3, encoded_image_string=encoded)
        self._write(summary=Summary(value=[Summary.Value(tag=tag, image=image)]), step=step)

    def layout(self, layout: dict[str, dict[str, list[Any]]]) -> None:
        """Set the layout of the custom scalars page: {category: {chart: ["Multiline", [tag, ...]]}}."""
        self._write(summary=custom_scalars(layout))

    def flush(self) -> None:
        """Pass all buffered data to the operating system."""
        self._stream.flush()

    def close(self) -> None:
        """Flush and close."""
        self._stream.close()

    def _write(self, **content: Any) -> None:
        self._records.write(Event(wall_time=time.time(), **content).SerializeToString())
