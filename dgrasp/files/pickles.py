"""Read pickles of plain data and arrays without executing anything in them.

The unpickler has two allow-lists: the globals that its kind of file needs, each replaced by a harmless stand-in, and
the opcodes that plain data needs. It refuses everything else. A tampered file can hold wrong data, but it cannot
execute code or make the reader hang or crash. Keys of dictionaries may only be text, numbers and pairs of numbers: a
tuple that holds the same tuple twice, and so on forty levels deep, has a hash that takes practically forever.
"""

from __future__ import annotations

import io
import pickle
import pickletools
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

from dgrasp.errors import DataError
from dgrasp.files import compressed

_OPCODE_NAMES = {ord(op.code): op.name for op in pickletools.opcodes}
PLAIN_OPCODES = (
    "PROTO", "FRAME", "STOP", "MARK", "GLOBAL", "STACK_GLOBAL", "REDUCE", "NEWOBJ",
    "BINPUT", "LONG_BINPUT", "MEMOIZE", "BINGET", "LONG_BINGET",
    "NONE", "NEWTRUE", "NEWFALSE", "BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT",
    "BINUNICODE", "SHORT_BINUNICODE", "SHORT_BINBYTES", "BINBYTES",
    "EMPTY_TUPLE", "TUPLE", "TUPLE1", "TUPLE2", "TUPLE3", "EMPTY_LIST", "APPEND", "APPENDS", "EMPTY_DICT",
    # The text protocol of Python 2 and protocol 0; texts and array bytes of Python 2 are its 8-bit strings.
    "INT", "LONG", "FLOAT", "STRING", "UNICODE", "LIST", "DICT", "PUT", "GET", "SHORT_BINSTRING", "BINSTRING",
    "BYTEARRAY8",
)  # fmt: skip
"""Opcodes of the protocols 0 to 5 that build plain data; most handlers are the standard library's own."""

HEADS = (b"\x80", b"(", b"}", b"]", b"ccollections\n", *compressed.HEADS)
"""The first bytes of the files that are read: pickles of dictionaries and lists, compressed or not."""

Dispatch = dict[int, Callable[[Any], None]]


MAX_STEPS = 1_000_000
"""Most opcodes in one file. One byte may become an object of some ten bytes, so this bounds memory and time."""


class _Opcodes(dict[int, Callable[[Any], None]]):
    """The opcodes that a file may use, and how many more of them. Looking up any other opcode raises `DataError`."""

    left = MAX_STEPS

    def take(self, steps: int) -> None:
        """Count steps; a `DataError` where there are too many."""
        self.left -= steps
        if self.left < 0:
            raise DataError(f"more than {MAX_STEPS} steps to build its content; such a file needs a few thousand")

    def __getitem__(self, code: int) -> Callable[[Any], None]:
        # `take` once per opcode costs a third of the reading.
        self.left -= 1
        if self.left < 0:
            self.take(0)
        return super().__getitem__(code)

    def __missing__(self, code: int) -> Any:
        raise DataError(
            f"the pickle uses the opcode {_OPCODE_NAMES.get(code, code)}, which such a file never needs; "
            "it was refused and nothing was executed"
        )


def _handlers() -> Dispatch:
    """The standard handlers of the plain opcodes, and the checked ones that build objects and fill dictionaries."""
    table: Dispatch = {
        code: pickle._Unpickler.dispatch[code] for code, name in _OPCODE_NAMES.items() if name in PLAIN_OPCODES
    }
    return table | {
        pickle.BUILD[0]: _load_build, pickle.SETITEM[0]: _load_setitem, pickle.SETITEMS[0]: _load_setitems,
        pickle.DICT[0]: _load_dict, pickle.BYTEARRAY8[0]: _load_bytearray,
    }  # fmt: skip


def _load_build(self: RestrictedUnpickler) -> None:
    state = self.stack.pop()
    self.stack[-1] = self.build(self.stack[-1], state)


def _load_setitem(self: RestrictedUnpickler) -> None:
    value = self.stack.pop()
    _set_items(self.stack, [self.stack.pop(), value])


def _load_setitems(self: RestrictedUnpickler) -> None:
    items = self.pop_mark()  # type: ignore[attr-defined]
    _set_items(self.stack, items)


def _load_dict(self: RestrictedUnpickler) -> None:
    items = self.pop_mark()  # type: ignore[attr-defined]
    self.stack.append({})
    _set_items(self.stack, items)


def _load_bytearray(self: RestrictedUnpickler) -> None:
    announced = int.from_bytes(self.read(8), "little")  # type: ignore[attr-defined]
    # The standard handler makes room for all that is announced before it reads.
    raw = self.read(announced) if announced <= self.size else b""  # type: ignore[attr-defined]
    if len(raw) != announced:
        raise DataError(f"truncated file: a buffer of {announced} bytes in a file of {self.size}")
    self.stack.append(bytearray(raw))


def _set_items(stack: list[Any], items: list[Any]) -> None:
    # Python 3 keeps the texts of a Python 2 file as bytes, if it is told to, and writes them so again.
    target, keys = stack[-1], [key.decode("latin1") if type(key) is bytes else key for key in items[::2]]
    if not isinstance(target, dict) or not all(map(_is_key, keys)):
        raise DataError("the pickle sets items of something else than a dictionary with keys of text and numbers")
    target.update(zip(keys, items[1::2], strict=True))


def _is_key(key: Any) -> bool:
    """Whether a key is hashed in one step: a text, a number, or a pair of numbers as sparse matrices have them."""
    pair = type(key) is tuple and len(key) == 2 and all(type(part) is int for part in key)
    return pair or type(key) in (str, int)


def _no_bytes() -> bytes:
    """What `bytes()` stands for in protocols before 3."""
    return b""


Globals = dict[tuple[str, str], Any]


class RestrictedUnpickler(pickle._Unpickler):
    """Pure-Python unpickler with an allow-list of globals and one of opcodes.

    allowed: maps module and name to a stand-in: a function, a class, or the name of a method of this class. A subclass
    adds its own.
    """

    stack: list[Any]
    allowed: ClassVar[Globals] = {
        ("_codecs", "encode"): "latin1",
        ("__builtin__", "bytes"): _no_bytes,
        ("collections", "OrderedDict"): "ordered",
    }
    handlers: ClassVar[Dispatch] = _handlers()

    def __init__(self, stream: io.BytesIO, size: int) -> None:
        super().__init__(stream, encoding="latin1")
        self.stream, self.size = stream, size
        # The standard library's loop looks up every opcode here.
        self.steps = _Opcodes(self.handlers)
        self.dispatch = self.steps  # type: ignore[misc]
        self.unbuilt = {"bytes": size, "arrays": size}

    def find_class(self, module: str, name: str) -> Any:
        try:
            found = self.allowed[(module, name)]
        except KeyError:
            raise DataError(
                f"the pickle asks for {f'{module}.{name}'[:80]!r}, which such a file never needs; "
                "it was refused and nothing was executed; save plain dictionaries, lists, texts, numbers and arrays"
            ) from None
        return getattr(self, found) if isinstance(found, str) else found

    def spend(self, what: str, n_bytes: int) -> None:
        """Count bytes that are made out of the file's; those of "bytes" and of "arrays" are no more than it has."""
        self.unbuilt[what] -= n_bytes
        if self.unbuilt[what] < 0:
            raise DataError(f"the {what} are larger than the file; expected that each byte is used once")

    def latin1(self, text: Any, encoding: Any) -> bytes:
        """The bytes that protocols before 3 write as text."""
        if type(text) is not str or encoding not in ("latin1", "latin-1"):
            raise DataError("malformed bytes")
        self.spend("bytes", len(text))
        return text.encode("latin1")

    def ordered(self, pairs: Any = ()) -> dict[Any, Any]:
        """A dictionary for an `OrderedDict`, of which Python 2 gives the pairs at once."""
        self.steps.take(len(pairs))
        built: list[Any] = [{}]
        for key, value in pairs:
            _set_items(built, [key, value])
        return dict(built[0])

    def build(self, target: Any, state: Any) -> Any:
        """The object that replaces `target` on the stack once `state` is set on it."""
        raise DataError(f"the pickle sets state on a {type(target).__name__}; only arrays are expected")


def read_pickle(path: Path, unpickler: type[RestrictedUnpickler], kind: str, max_bytes: int) -> Any:
    """The object of a pickle file, read by `unpickler`, from a file that may be compressed.

    kind: what the file is, for messages. max_bytes: of the file, and when unpacked. Raises `DataError` naming the file
    for a missing, oversized, truncated or tampered file.
    """
    path = Path(path)
    try:
        size = path.stat().st_size
        if size > max_bytes:
            raise DataError(f"{path}: {size} bytes; a {kind} has at most {max_bytes}")
        raw = path.read_bytes()
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror or error})") from None
    try:
        raw = compressed.unpacked(raw, max_bytes)
        if not raw.startswith(HEADS):
            raise DataError(f"not a pickle of a dictionary, as a {kind} is (it begins with {raw[:8]!r})")
        return load_pickle(raw, unpickler, kind)
    except DataError as error:
        raise DataError(f"{path}: {error}") from None


def load_pickle(raw: bytes, unpickler: type[RestrictedUnpickler], kind: str) -> Any:
    """The object of a pickle's bytes; a `DataError`, without the file's name, for whatever cannot be read."""
    try:
        return unpickler(io.BytesIO(raw), len(raw)).load()
    except DataError:
        raise
    except RecursionError:
        raise DataError(f"damaged {kind} (nested too deeply)") from None
    except Exception as error:
        # A mutated stream can fail in any opcode; whatever it raises, the file cannot be used.
        raise DataError(f"damaged {kind} ({type(error).__name__}: {str(error)[:200]})") from None
