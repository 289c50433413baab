"""Unpack compressed files in memory, at most to a stated size."""

from __future__ import annotations

import bz2
import lzma
import zlib
from typing import Any

from dgrasp.errors import DataError

HEADS = (
    b"\x78\x01", b"\x78\x5e", b"\x78\x9c", b"\x78\xda", b"\x1f\x8b", b"BZh", b"\x5d\x00\x00", b"\xfd7zXZ\x00",
)  # fmt: skip
"""The first bytes of zlib, gzip, bz2, lzma and xz, the forms in which joblib compresses."""
_REFUSED = {b"\x04\x22\x4d\x18": "LZ4", b"\x28\xb5\x2f\xfd": "Zstandard", b"ZF0x": "joblib 0.9's compression"}
_DICTIONARY = 128 * 2**20
"""Bytes. The most that an lzma file may ask for; its highest preset takes 65 MB."""
_STREAMS = 1000
"""Most streams of one file, which gzip and the others allow to follow each other."""


def _decompressor(raw: bytes) -> Any:
    if raw.startswith((b"\x1f\x8b", b"\x78")):
        return zlib.decompressobj(wbits=zlib.MAX_WBITS | 32)  # Either of zlib's and gzip's headers.
    return bz2.BZ2Decompressor() if raw.startswith(b"BZh") else lzma.LZMADecompressor(memlimit=_DICTIONARY)


def unpacked(raw: bytes, max_bytes: int) -> bytes:
    """The bytes of a file, unpacked where it is compressed.

    Raises `DataError` for more than `max_bytes` when unpacked, for a truncated or damaged file, and for LZ4 and
    Zstandard, by name.
    """
    for head, name in _REFUSED.items():
        if raw.startswith(head):
            raise DataError(f"compressed with {name}, which is not read; save the file with compress=\"zlib\" or "
                            "without compression")
    if not raw.startswith(HEADS):
        return raw
    parts, left = [], max_bytes
    try:
        for _ in range(_STREAMS):
            stream = _decompressor(raw)
            # One byte more than allowed, so that a file that is too large shows itself.
            part = stream.decompress(raw, left + 1)
            parts.append(part)
            left -= len(part)
            if left < 0:
                raise DataError(f"more than {max_bytes} bytes when unpacked; such a file has at most that many")
            if not stream.eof:
                raise DataError("its compression is truncated; get the file again")
            raw = stream.unused_data
            if not raw.startswith(HEADS):
                return b"".join(parts)
    except (zlib.error, OSError, ValueError, EOFError, lzma.LZMAError) as error:
        raise DataError(f"its compression is damaged ({str(error)[:200]}); get the file again") from None
    raise DataError(f"more than {_STREAMS} compressed streams; expected one; save the file again")
