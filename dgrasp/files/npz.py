"""Read .npz archives of plain numbers and text. Sizes are checked before anything is unpacked.

Arrays of objects are pickles; `dgrasp.files.pickles` reads them if the caller asks for them (kind "O").
"""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from dgrasp.errors import DataError
from dgrasp.files.joblib import PlainUnpickler
from dgrasp.files.pickles import RestrictedUnpickler, load_pickle
from dgrasp.types import Array

_KINDS = {"U": "text", "biuf": "plain numbers"}
MAX_MEMBERS = 1000


class NpzArchive:
    """An open archive. names: its members' file names, such as "T_WO.npy", in the archive's order."""

    def __init__(self, path: Path, archive: zipfile.ZipFile) -> None:
        self._path, self._archive = path, archive
        self._entries = archive.infolist()
        self.names = [entry.filename for entry in self._entries]

    def read(self, name: str, kinds: str, unpickler: type[RestrictedUnpickler] = PlainUnpickler) -> Array:
        """The array of `name` (without .npy), of a dtype of these kinds; its header must announce its exact size.

        unpickler: reads an array of objects, if `kinds` has O.
        """
        entry = self._entries[self.names.index(f"{name}.npy")]
        with self._archive.open(entry) as stream:
            # Read at most one byte more than announced: a read without a limit unpacks everything first and cuts later.
            raw = stream.read(entry.file_size + 1)
        content = io.BytesIO(raw)
        if np.lib.format.read_magic(content) != (1, 0):
            raise DataError(f"{self._path}: {name} is of another .npy version; expected 1.0, as numpy writes it")
        shape, fortran, dtype = np.lib.format.read_array_header_1_0(content)
        left = len(raw) - content.tell()
        if dtype.kind == "O" and "O" in kinds:
            try:
                objects = load_pickle(raw[content.tell() :], unpickler, "array of objects")
            except DataError as error:
                raise DataError(f"{self._path}: {name}: {error}") from None
            if not isinstance(objects, np.ndarray) or objects.shape != shape:
                raise DataError(f"{self._path}: {name} announces {str(shape)[:100]} objects; expected an array of them")
            return objects
        if dtype.kind not in kinds or math.prod(shape) * dtype.itemsize != left:
            wanted = _KINDS.get(kinds, f"numbers of kind {kinds!r}")
            raise DataError(f"{self._path}: {name} announces {str(shape)[:100]} of {dtype.str[:100]}, with {left} "
                            f"bytes; expected {wanted} of exactly that size")
        view: Array = np.ndarray(shape, dtype, raw, content.tell(), order="F" if fortran else "C")
        return view.copy(order="A")


@contextmanager
def open_npz(path: Path, kind: str, max_bytes: int) -> Iterator[NpzArchive]:
    """Open an archive of at most `max_bytes`, on disk and unpacked. kind: what the file is, for messages.

    Any error here or in the `with` block becomes a `DataError` that names the file.
    """
    path = Path(path)
    try:
        if path.stat().st_size > max_bytes:
            raise DataError(f"{path}: {path.stat().st_size} bytes; a {kind} has at most {max_bytes}; split it")
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
            total = sum(entry.file_size for entry in entries)
            if total > max_bytes or len(entries) > MAX_MEMBERS:
                raise DataError(f"{path}: {total} bytes in {len(entries)} members when unpacked; a {kind} has at most "
                                f"{max_bytes} in {MAX_MEMBERS}; split it")
            if any(entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) for entry in entries):
                raise DataError(f"{path}: a member is compressed in an unusual way; expected what numpy writes")
            yield NpzArchive(path, archive)
    except DataError:
        raise
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror or error})") from None
    except Exception as error:
        # A damaged archive fails in zipfile, zlib or numpy, each with exceptions of its own.
        raise DataError(f"{path}: damaged {kind} ({type(error).__name__}: {str(error)[:200]}); "
                        "get it or write it again") from None
