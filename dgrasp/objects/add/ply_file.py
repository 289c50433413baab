"""PLY: the vertices and faces of a file, as text or binary in either byte order."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

import numpy as np

from dgrasp.errors import DataError
from dgrasp.geometry.obj_file import check_commas
from dgrasp.geometry.polygons import triangulated
from dgrasp.types import Array

_TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
          "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
          "int64": "i8", "uint64": "u8", "float16": "f2", "float32": "f4", "float64": "f8"}  # fmt: skip
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_CORNERS = ("vertex_indices", "vertex_index")


@dataclass(eq=False)
class _Element:
    """An element of the header. properties: name, type of a list's length or "", type of a value."""

    name: str
    count: int
    properties: list[tuple[str, str, str]] = field(default_factory=list)


def read_ply(raw: bytes, most: int) -> tuple[Array, Array]:
    """Vertices (V, 3) in the file's units and triangles (F, 3) of a file's bytes.

    Faces may be polygons of any mixture, or strips of triangles. most: rows that the header may announce. Raises
    `DataError` for a header that is wrong or announces more than there is, and for a damaged body.
    """
    order, elements, body = _header(raw)
    rows = sum(element.count for element in elements)
    # The shortest row of any element is one byte in binary, and a digit with its line's end in text.
    if rows > len(raw):
        raise DataError(f"its header announces {rows} rows, more than {len(raw)} bytes hold; the file is damaged or "
                        "cut off")
    if rows > most:
        raise DataError(f"its header announces {rows} rows; at most {most} are taken; decimate the mesh first")
    columns: dict[str, dict[str, tuple[Array, Array | None]]] = {}
    source = _Binary(body, order) if order else _Text(body, raw.count(b"\n", 0, len(raw) - len(body)))
    for element in elements:
        columns[element.name] = source.read(element)
    source.check_end()
    vertex = columns.get("vertex", {})
    if any(axis not in vertex for axis in "xyz"):
        raise DataError("its header has no element 'vertex' with x, y and z; expected a mesh; export it again")
    vertices = np.stack([vertex[axis][0].astype(float) for axis in "xyz"], axis=1)
    face = columns.get("face", {})
    corners, counts = next((face[name] for name in _CORNERS if name in face), (np.zeros(0), np.zeros(0)))
    faces = [triangulated(vertices, corners.astype(np.int64), np.asarray(counts, dtype=np.int64))]
    for strip in columns.get("tristrips", {}).values():
        faces.append(_strips(strip[0].astype(np.int64)))
    return vertices, np.concatenate(faces)


def _header(raw: bytes) -> tuple[str, list[_Element], bytes]:
    """The byte order ("" for text), the elements and the rest of the file."""
    raw = raw.removeprefix(b"\xef\xbb\xbf")
    head = re.match(rb"ply\s.*?^[ \t]*end_header[ \t]*(\r\n|\n|\r)", raw, re.DOTALL | re.MULTILINE)
    if head is None and b"\r" in raw:  # Lines that end in \r alone.
        head = re.match(rb"ply\r.*?\rend_header[ \t]*\r", raw, re.DOTALL)
    if head is None:
        raise DataError("it has no header from 'ply' to 'end_header'; it cannot be read as PLY; export it again")
    order: str | None = None
    elements: list[_Element] = []
    for line in head.group().splitlines():
        words = line.decode("latin-1").split()
        match words:
            case ["format", name, *_] if name in _ORDERS:
                order = _ORDERS[name]
            case ["element", name, count] if count.isdigit():
                elements.append(_Element(name, int(count)))
            case ["property", "list", length, kind, name] if elements and length in _TYPES and kind in _TYPES:
                elements[-1].properties.append((name, _TYPES[length], _TYPES[kind]))
            case ["property", kind, name] if elements and kind in _TYPES:
                elements[-1].properties.append((name, "", _TYPES[kind]))
            case ["format" | "element" | "property", *_]:
                raise DataError(f"its header has the line {' '.join(words)[:60]!r}, which no PLY file has; export it "
                                "again")
    if order is None:
        raise DataError(f"its header states no format; expected one of {', '.join(_ORDERS)}; export it again")
    return order, elements, raw[head.end() :]


class _Binary:
    """The body of a binary file, element by element. order: "<" or ">"."""

    def __init__(self, body: bytes, order: str) -> None:
        self._body, self._order, self._at = body, order, 0

    def read(self, element: _Element) -> dict[str, tuple[Array, Array | None]]:
        """Values of each property in a row, and of a list the number of values of each row."""
        lengths = self._lengths(element)
        dtype = np.dtype([part for (name, length, kind), n in zip(element.properties, lengths, strict=True)
                          for part in self._fields(name, length, kind, n)])
        end = self._at + element.count * dtype.itemsize
        if end <= len(self._body):
            rows = np.frombuffer(self._body, dtype, element.count, self._at)
            lists = [(name, n) for (name, length, _), n in zip(element.properties, lengths, strict=True) if length]
            if all((rows[f"{name} length"] == n).all() for name, n in lists):
                self._at = end
                counts = {name: np.full(element.count, n) for name, n in lists}
                return {name: (rows[name].reshape(-1), counts.get(name)) for name, _, _ in element.properties}
        return self._row_by_row(element)

    def _fields(self, name: str, length: str, kind: str, n: int) -> list[tuple[str, str, tuple[int, ...]]]:
        if not length:
            return [(name, self._order + kind, ())]
        return [(f"{name} length", self._order + length, ()), (name, self._order + kind, (n,))]

    def _lengths(self, element: _Element) -> list[int]:
        """Of each list the number of values in the first row."""
        at, lengths = self._at, []
        for _, length, kind in element.properties:
            n = 1
            if length:
                n = self._one(length, at) if element.count else 0
                at += np.dtype(length).itemsize
            lengths.append(n)
            at += n * np.dtype(kind).itemsize
        return lengths

    def _one(self, kind: str, at: int) -> int:
        size = np.dtype(kind).itemsize
        if at + size > len(self._body):
            raise _cut_off()
        n = int(np.frombuffer(self._body, self._order + kind, 1, at)[0])
        if n < 0 or n > len(self._body):
            raise DataError(f"a list announces {n} values; the file is damaged")
        return n

    def _row_by_row(self, element: _Element) -> dict[str, tuple[Array, Array | None]]:
        values: list[list[Array]] = [[] for _ in element.properties]
        for _ in range(element.count):
            for (_, length, kind), column in zip(element.properties, values, strict=True):
                n = 1
                if length:
                    n = self._one(length, self._at)
                    self._at += np.dtype(length).itemsize
                size = n * np.dtype(kind).itemsize
                if self._at + size > len(self._body):
                    raise _cut_off()
                column.append(np.frombuffer(self._body, self._order + kind, n, self._at))
                self._at += size
        return _joined(element, values)

    def check_end(self) -> None:
        """Refuse bytes that the header does not announce."""
        if self._at != len(self._body):
            raise DataError(f"{len(self._body) - self._at} bytes follow what its header announces; the file is damaged")


class _Text:
    """The body of a text file, element by element. line: number of the header's lines."""

    def __init__(self, body: bytes, line: int) -> None:
        words = body.split()
        try:
            self._values = np.array(words, dtype="S").astype(float)
        except ValueError:
            for number, text in enumerate(body.splitlines(), start=line + 1):
                check_commas(text, number)
            raise DataError("its body has words that are no numbers; it cannot be read as PLY; export it "
                            "again") from None
        self._at = 0

    def read(self, element: _Element) -> dict[str, tuple[Array, Array | None]]:
        """Values of each property in a row, and of a list the number of values of each row."""
        if not any(length for _, length, _ in element.properties):
            width = len(element.properties)
            rows = self._take(element.count * width).reshape(element.count, width)
            return {name: (rows[:, i], None) for i, (name, _, _) in enumerate(element.properties)}
        values: list[list[Array]] = [[] for _ in element.properties]
        for _ in range(element.count):
            for (_, length, _), column in zip(element.properties, values, strict=True):
                column.append(self._take(int(self._take(1)[0]) if length else 1))
        return _joined(element, values)

    def _take(self, count: int) -> Array:
        taken = self._values[self._at : self._at + count]
        if count < 0 or len(taken) < count:
            raise _cut_off()
        self._at += count
        return taken

    def check_end(self) -> None:
        """Refuse numbers that the header does not announce."""
        if self._at != len(self._values):
            raise DataError(f"{len(self._values) - self._at} numbers follow what its header announces; the file is "
                            "damaged")


def _joined(element: _Element, values: list[list[Array]]) -> dict[str, tuple[Array, Array | None]]:
    """As `read` gives them: the values of each property row by row (`values`), in one array."""
    columns = {}
    for (name, length, _), rows in zip(element.properties, values, strict=True):
        counts = np.array([len(row) for row in rows]) if length else None
        columns[name] = (np.concatenate([np.zeros(0), *rows]), counts)
    return columns


def _strips(corners: Array) -> Array:
    """(F, 3) triangles of strips (C,) that a -1 ends; every second triangle is wound the other way round."""
    faces: list[Array] = [np.zeros((0, 3), dtype=np.int64)]
    for strip in np.split(corners, np.flatnonzero(corners == -1)):
        strip = strip[strip >= 0]
        triangles = np.stack([strip[:-2], strip[1:-1], strip[2:]], axis=1)
        triangles[1::2] = triangles[1::2, ::-1]
        faces.append(triangles)
    return np.concatenate(faces)


def _cut_off() -> DataError:
    return DataError("its body is shorter than its header announces; the file is damaged or cut off")
