"""Wavefront OBJ: the vertices and faces of a file, whatever its separators, encoding and way of counting."""

from __future__ import annotations

import codecs
import re

import numpy as np

from dgrasp.errors import DataError
from dgrasp.geometry.polygons import triangulated
from dgrasp.types import Array

_WIDE = (codecs.BOM_UTF32_LE, codecs.BOM_UTF32_BE, codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def plain_text(raw: bytes) -> bytes:
    """The text of a file without its byte order mark, in an encoding whose numbers are ASCII."""
    for mark, name in zip(_WIDE, ("utf-32", "utf-32", "utf-16", "utf-16"), strict=True):
        if raw.startswith(mark):
            return raw.decode(name, "replace").encode()
    return raw.removeprefix(codecs.BOM_UTF8)


def check_commas(line: bytes, number: int) -> None:
    """Refuse a line that has a comma in or after a number; the message names the comma. number: of the line."""
    if re.search(rb"\d,|,\d", line):
        shown = line.strip()[:60].decode("ascii", "replace")
        raise DataError(f"line {number} has a comma: {shown!r}; expected numbers with a decimal point and spaces "
                        "between them; export it again with decimal points")


def read_obj(raw: bytes) -> tuple[Array, Array]:
    """Vertices (V, 3) in the file's units and triangles (F, 3) of a file's bytes.

    A negative number of a face counts back from the last vertex before that face. Of `v/vt/vn` the first is taken, of
    vertices with a weight or colour the position. Raises `DataError`, with the line, for what cannot be read.
    """
    text = plain_text(raw)
    if b"\\" in text:
        text = re.sub(rb"\\[ \t]*(\r\n|\n|\r)", b" ", text)
    vertices: list[float] = []
    corners: list[int] = []
    counts: list[int] = []
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.partition(b"#")[0].split()
        if not words or words[0] not in (b"v", b"f"):
            continue
        try:
            if words[0] == b"v":
                x, y, z, *_ = words[1:]
                vertices += float(x), float(y), float(z)
            else:
                indices = [int(word.partition(b"/")[0]) for word in words[1:]]
                if 0 in indices:
                    raise ValueError
                seen = len(vertices) // 3
                corners += [index - 1 if index > 0 else seen + index for index in indices]
                counts.append(len(indices))
        except ValueError:
            check_commas(line, number)
            expected = "v and three numbers" if words[0] == b"v" else "f and vertex numbers, from 1 or, backwards, -1"
            shown = line.strip()[:60].decode("ascii", "replace")
            raise DataError(f"line {number} is {shown!r}; expected {expected}; export it again") from None
    points = np.array(vertices, dtype=float).reshape(-1, 3)
    return points, triangulated(points, np.array(corners, dtype=np.int64), np.array(counts, dtype=np.int64))
