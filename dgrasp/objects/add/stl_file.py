"""STL: the triangles of a file, as text or binary."""

from __future__ import annotations

import re
import struct

import numpy as np

from dgrasp.errors import DataError
from dgrasp.geometry.obj_file import check_commas, plain_text
from dgrasp.types import Array

_ROW = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_VERTEX = re.compile(rb"^[ \t]*vertex[ \t]+(\S+)[ \t]+(\S+)[ \t]+(\S+)", re.IGNORECASE | re.MULTILINE)


def read_stl(raw: bytes) -> tuple[Array, Array]:
    """Vertices (3 F, 3) in the file's units and triangles (F, 3) of a file's bytes, three vertices a triangle.

    A file is binary if its length is what its header announces, if it does not begin with `solid`, or if it holds a
    zero byte. Raises `DataError` for a file that is cut off or damaged.
    """
    text = plain_text(raw).lstrip()
    count = struct.unpack_from("<I", raw, 80)[0] if len(raw) >= 84 else -1
    if len(raw) == 84 + 50 * count:
        corners: Array = np.frombuffer(raw, _ROW, count, 84)["corners"].astype(float).reshape(-1, 3)
    elif text[:5].lower() == b"solid" and b"\0" not in text:
        corners = _text_corners(text.replace(b"\r", b"\n"))
    elif count < 0:
        raise DataError(f"{len(raw)} bytes, less than the header of a binary STL; the file is cut off")
    else:
        raise DataError(f"its header announces {count} faces, but there are bytes for {(len(raw) - 84) / 50:g}; "
                        "the file is damaged or cut off")
    return corners, np.arange(len(corners)).reshape(-1, 3)


def _text_corners(text: bytes) -> Array:
    """(3 F, 3) the vertices of a text file."""
    found = _VERTEX.findall(text)
    announced = len(re.findall(rb"^[ \t]*facet\b", text, re.IGNORECASE | re.MULTILINE))
    try:
        corners = np.array(found, dtype="S").astype(float).reshape(-1, 3)
    except ValueError:
        for number, line in enumerate(text.splitlines(), start=1):
            if _VERTEX.match(line):
                check_commas(line, number)
        raise DataError("a vertex is no three numbers; it cannot be read as STL; export it again") from None
    if len(corners) != 3 * announced:
        raise DataError(f"{announced} facets with {len(corners)} vertices; expected three each; it cannot be read as "
                        "STL: it is damaged or cut off")
    return corners
