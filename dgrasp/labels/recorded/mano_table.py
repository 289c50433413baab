"""Tables of MANO parameters and object poses: a .npz with one array per quantity, or a .csv with one column per number.

Arrays and columns are named alike: `transl` (n, 3) is `transl_0`, `transl_1`, `transl_2` in a .csv. Where data sets
differ, `dgrasp.labels.recorded.conventions` asks for the meaning of a column or finds it.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dgrasp.errors import DataError
from dgrasp.files import csv_text
from dgrasp.files.arrays import plain_text
from dgrasp.files.npz import open_npz
from dgrasp.labels.recorded.table_sources import TableSource, rotation_vectors
from dgrasp.objects.names import resolve_object
from dgrasp.types import Array

MAX_BYTES = 16 * 2**20
MAX_ROWS = 20_000
WIDTHS: dict[str, tuple[int, ...]] = {
    "params": (61,), "global_orient": (3, 6, 9), "hand_pose": (*range(1, 46), 90, 135), "transl": (3,),
    "betas": tuple(range(1, 11)), "object_rotation": (3, 4, 9), "object_translation": (3,), "hand_transform": (16,),
    "joints": tuple(range(48, 301, 3)),
}
"""The quantities and how many numbers each may have per row; matrices are row by row.

Rotations of the wrist and the 15 finger joints may be matrices (9 numbers) or 6D (6), as image estimators give them.

`params` stands for betas 10, global_orient 3, hand_pose 45 and transl 3 in this order.
"""
_WHOLE = (48, 96, 144)
"""Numbers per row of all 16 rotations of a hand as vectors, 6D or matrices."""
_SAID = {"hand_pose": "1 to 45, 90 or 135; or, with the wrist's rotation first and no global_orient, 48, 96 or 144"}
"""What is said of the widths of a quantity, where it is no plain range."""
_COLUMN = re.compile(r"([a-z_]+)_(\d{1,3})")
_FORM = "expected arrays or columns object, betas, global_orient, hand_pose, transl, object_rotation, " \
        "object_translation (docs/labels.md)"


@dataclass(frozen=True, eq=False)
class ManoTable:
    """A table as it was read. values: quantity to (n, width) float64. objects (n,): names. n: rows.

    matrices: the finger pose was given as rotations, which are read as rotation vectors. scale: of the objects' meshes.
    """

    path: Path
    values: dict[str, Array]
    objects: list[str]
    matrices: bool = False
    scale: float | None = None

    def __len__(self) -> int:
        return len(self.objects)

    def need(self, name: str, remedy: str) -> Array:
        """The quantity `name`. Raises `DataError` with a remedy if the table lacks it."""
        if name not in self.values:
            raise DataError(f"{self.path}: no {name}; it has {', '.join(self.values) or 'nothing'}; {remedy}")
        return self.values[name]


def read_mano_table(
    path: Path, object_name: str | None = None, known: Callable[[str], str] = resolve_object,
    source: TableSource | None = None, rows_of_6d: bool = False, scale: float | None = None,
) -> ManoTable:
    """The table of a .npz or .csv file. object_name: of all rows where the file has no `object`.

    known: the full name of an object, or a `DataError`. source: the source that wrote the file, which may have a
    form of its own. rows_of_6d: 6D rotations are rows, not columns, of a matrix. scale: take the rows of this scale.
    Raises `DataError` naming the file and the quantity or line for anything that does not fit.
    """
    path = Path(path)
    try:
        with path.open("rb") as stream:
            head = stream.read(6)
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror or error})") from None
    columns = None if source is None else source.read(path)
    if columns is None and head == b"\x93NUMPY":
        raise DataError(f"{path}: a .npy file, whose array has no name; {_FORM} in a .npz (numpy.savez), or the option "
                        "--from that reads the file (DexGraspNet's: --from dexgraspnet)")
    if columns is None:
        columns = _read_npz(path, source) if head.startswith(b"PK") else _read_csv(path)
    if source is not None:
        try:
            columns = source.adapt(columns)
        except DataError as error:
            raise DataError(f"{path}: {error}") from None
    scales = np.asarray(columns.pop("scale", np.zeros(0)))
    if scales.size:
        columns, scale = _of_scale(path, columns, scales, scale)
    names = columns.pop("object", None)
    if rows_of_6d and any(np.ndim(array) > 2 and array.shape[-2:] == (3, 2) for array in columns.values()):
        raise DataError(f"{path}: matrices of shape (3, 2) are first two columns; expected no --rotation6d rows then")
    columns |= _wrist_apart(path, columns)
    matrices = np.asarray(columns.get("hand_pose", [])).size > 45 * len(columns.get("hand_pose", []))
    values = {name: _checked(path, name, array, rows_of_6d) for name, array in columns.items()}
    rows = {name: len(array) for name, array in values.items()}
    n = max(rows.values(), default=0)
    if n == 0 or set(rows.values()) != {n}:
        raise DataError(f"{path}: rows per quantity {rows}; expected the same number in each, at least 1; {_FORM}")
    if "params" in values:
        params = values.pop("params")
        parts = {"betas": params[:, :10], "global_orient": params[:, 10:13], "hand_pose": params[:, 13:58],
                 "transl": params[:, 58:]}
        twice = sorted(set(parts) & set(values))
        if twice:
            raise DataError(f"{path}: has params and also {', '.join(twice)}; expected each quantity once")
        values |= parts
    if names is None:
        if object_name is None:
            raise DataError(f"{path}: no object; expected its names in a column `object`, or one for all with --object")
        names = [object_name] * n
    elif object_name is not None:
        raise DataError(f"{path}: has a column `object`; expected no --object then")
    if len(names) != n:
        raise DataError(f"{path}: {len(names)} names of objects for {n} rows; expected one per row")
    full: dict[str, str] = {}
    for row, name in enumerate(names):
        if name not in full:
            try:
                full[name] = known(name)
            except DataError as error:
                raise DataError(f"{path}: row {row}: {str(error)[:400]}") from None
    return ManoTable(path, values, [full[name] for name in names], matrices, scale)


def _of_scale(path: Path, columns: dict[str, Any], scales: Array, scale: float | None) -> tuple[dict[str, Any], float]:
    """The rows of one scale, as an object has one size."""
    there = sorted(set(scales.round(6).tolist()))
    if scale is None and len(there) > 1:
        raise DataError(f"{path}: grasps at the scales {', '.join(f'{s:g}' for s in there)[:200]}; an object has one "
                        "size: choose one with --scale")
    chosen = there[0] if scale is None else scale
    mine = np.abs(scales - chosen) < 1e-6
    if not mine.any():
        raise DataError(f"{path}: no grasp at the scale {chosen:g}; it has {', '.join(f'{s:g}' for s in there)[:200]}")
    return {name: np.asarray(values)[mine] for name, values in columns.items()}, chosen


def _wrist_apart(path: Path, columns: dict[str, Any]) -> dict[str, Array]:
    """global_orient and hand_pose, where hand_pose holds the rotations of all 16 joints, the wrist's first."""
    pose = columns.get("hand_pose")
    if not isinstance(pose, np.ndarray) or not 2 <= pose.ndim <= 4 or pose.size not in (n * len(pose) for n in _WHOLE):
        return {}
    if "global_orient" in columns:
        raise DataError(f"{path}: hand_pose has 16 rotations, the first of them the wrist's, and there is also "
                        "global_orient; expected the wrist's rotation once; leave one of them out")
    flat = _flat(pose)
    width = flat.shape[1] // 16
    return {"global_orient": flat[:, :width], "hand_pose": flat[:, width:]}


def _flat(array: Array) -> Array:
    """(n, width) of (n, ...). A matrix's first two columns (..., 3, 2) follow each other, as 6D numbers do."""
    if array.ndim > 2 and array.shape[-2:] == (3, 2):
        array = array.swapaxes(-1, -2)
    return array.reshape(len(array), -1)


def _checked(path: Path, name: str, array: Any, rows_of_6d: bool) -> Array:
    """(n, width) float64 of one quantity; rotations of the hand as rotation vectors."""
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "biuf":
        raise DataError(f"{path}: {name} is no array of numbers; {_FORM}")
    if array.ndim < 2 or array.ndim > 4 or len(array) > MAX_ROWS:
        raise DataError(f"{path}: {name} has shape {array.shape}; expected (rows, numbers), at most {MAX_ROWS} rows")
    if not len(array):
        return np.zeros((0, 1))
    flat = _flat(array)
    if flat.shape[1] not in WIDTHS[name]:
        widths = WIDTHS[name]
        wanted = " or ".join(map(str, widths)) if len(widths) < 4 else f"{widths[0]} to {widths[-1]}"
        wanted = _SAID.get(name, wanted)
        raise DataError(f"{path}: {name} has {flat.shape[1]} numbers per row; expected {wanted}")
    flat = flat.astype(np.float64)
    bad = np.flatnonzero(~(np.abs(flat) <= 1e4).all(axis=1))
    if bad.size:
        raise DataError(f"{path}: row {bad[0]}: {name} holds NaN, infinity or a number beyond 1e4; remove the row")
    if (name == "global_orient" and flat.shape[1] > 3) or (name == "hand_pose" and flat.shape[1] > 45):
        try:
            return rotation_vectors(flat, rows_of_6d)
        except ValueError as error:
            raise DataError(f"{path}: {error}: {name} holds a matrix that is no rotation; expected orthonormal "
                            "matrices with determinant 1, or 6D rotations") from None
    return flat


def _read_npz(path: Path, source: TableSource | None) -> dict[str, Any]:
    """Quantity to array, and `object` to a list of names. The file of a source may hold more, which is not read."""
    values: dict[str, Any] = {}
    with open_npz(path, "table", MAX_BYTES) as archive:
        own = [*WIDTHS, "object"]
        order = own if source is None else [*own, *source.names]
        # A quantity under its own name goes before others of it, and these in the order of the source.
        for file in sorted(archive.names, key=lambda file: (*order, file).index(file.removesuffix(".npy"))
                           if file.removesuffix(".npy") in order else len(order)):
            inside = file.removesuffix(".npy")
            name = inside if source is None else source.names.get(inside, inside)
            if source is not None and name in ("right", "is_right", "scale"):
                values[name] = archive.read(inside, "biuf")
                continue
            if source is not None and inside == source.inner:
                found = archive.read(inside, "O").item()
                values = {key: found[key] for key in WIDTHS if isinstance(found, dict) and key in found} | values
                continue
            if source is not None and (name in values or name not in (*WIDTHS, "object")):
                continue
            if archive.names.count(file) > 1 or (name not in WIDTHS and name != "object") or inside == file:
                raise DataError(f"{path}: unknown or duplicate member {file[:60]!r}; {_FORM}")
            if name == "object":
                array = archive.read(inside, "USOiu")
                if array.ndim != 1 or len(array) > MAX_ROWS or array.dtype.itemsize > 800:
                    raise DataError(f"{path}: object has shape {array.shape} of {array.dtype.str[:20]}; expected one "
                                    "name per row")
                found = [str(v) if isinstance(v, (int, np.integer)) else plain_text(v) for v in array]
                values[name] = [v for v in found if v is not None]
                if len(values[name]) < len(found):
                    raise DataError(f"{path}: row {found.index(None)}: object is no text; expected one name per row")
            else:
                values[name] = archive.read(inside, "biuf")
    return values


def _read_csv(path: Path) -> dict[str, Any]:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise DataError(f"{path}: {path.stat().st_size} bytes; a table has at most {MAX_BYTES}; split it")
        header, rows = csv_text.cells(csv_text.decoded(path.read_bytes()))
        where = _columns(path, header)
        cells: list[list[float]] = []
        names: list[str] = []
        for line, row in rows:
            if len(row) != len(header) or len(cells) >= MAX_ROWS:
                raise DataError(f"{path}: line {line}: {len(row)} cells; expected {len(header)} in each of at "
                                f"most {MAX_ROWS} lines")
            names.append(row[header.index("object")] if "object" in header else "")
            try:
                cells.append([float(row[i]) for columns in where.values() for i in columns])
            except ValueError as error:
                raise DataError(f"{path}: line {line}: {str(error)[:100]}; expected numbers") from None
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror or error})") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise DataError(f"{path}: neither .npz nor .csv ({str(error)[:100]}); {_FORM}") from None
    table = np.array(cells, dtype=np.float64).reshape(len(cells), sum(map(len, where.values())))
    values: dict[str, Any] = {}
    at = 0
    for name, columns in where.items():
        values[name] = table[:, at : at + len(columns)]
        at += len(columns)
    return values | ({"object": names} if "object" in header else {})


def _columns(path: Path, header: list[str]) -> dict[str, list[int]]:
    """The indices of each quantity's columns, in the order of their numbers."""
    found: dict[str, dict[int, int]] = {}
    for place, cell in enumerate(header):
        match = _COLUMN.fullmatch(cell)
        if cell == "object" and header.count(cell) == 1:
            continue
        if match is None or match[1] not in WIDTHS or int(match[2]) in found.get(match[1], {}):
            raise DataError(f"{path}: unknown or duplicate column {cell[:60]!r}; {_FORM}, with numbers from 0, such as "
                            "transl_0, transl_1, transl_2")
        found.setdefault(match[1], {})[int(match[2])] = place
    for name, places in found.items():
        if sorted(places) != list(range(len(places))):
            raise DataError(f"{path}: the columns of {name} are not numbered from 0 to {len(places) - 1}")
    return {name: [places[i] for i in range(len(places))] for name, places in found.items()}
