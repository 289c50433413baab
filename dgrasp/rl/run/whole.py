"""Whether the file of a policy is whole. Imports no torch, which takes seconds: damaged files are refused at once."""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from pathlib import Path
from typing import Any

from dgrasp.errors import DataError
from dgrasp.rl.run.folder import WEIGHTS_SUFFIX

_MAX_BYTES = 2**30
_SEAL = b"dgrasp sha256 "
_SEAL_SIZE = len(_SEAL) + 64

FORMAT, SCHEMA = "dgrasp-policy", "1"
"""What the metadata of a weights file names."""
MAX_WEIGHTS_BYTES = 64 * 2**20


def sealed(archive: bytes) -> bytes:
    """The zip archive with the SHA-256 of its bytes as the archive comment, at the end of the file."""
    # The two bytes before the comment hold its length; the digest covers them.
    body = archive[:-2] + _SEAL_SIZE.to_bytes(2, "little")
    return body + _SEAL + hashlib.sha256(body).hexdigest().encode()


def _is_whole(content: bytes) -> bool:
    """Whether the checksums of a torch file match: its seal, or the zip archive's own checksums if it has no seal.

    torch itself checks neither. The seal exists because the archive's own checksums do not cover its directory.
    """
    if not (content[-22:].startswith(b"PK\5\6") and content.endswith(b"\0\0")):  # an archive with a comment
        return sealed(content[:-_SEAL_SIZE]) == content
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        stored = all(item.compress_type == zipfile.ZIP_STORED for item in archive.infolist())
        return stored and archive.testzip() is None


def read_whole(path: Path, what: str) -> bytes:
    """The bytes of a file written by torch.save; `DataError` if its checksums do not match. what: its content."""
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise DataError(f"{path}: over {_MAX_BYTES >> 20} MiB; expected {what}")
        content = path.read_bytes()
    except OSError as error:
        raise DataError(f"{path}: cannot read {what} ({error.strerror or error})") from None
    try:
        if not _is_whole(content):
            raise ValueError("a checksum does not match")
    except Exception as error:  # hostile bytes can raise anything, and every error means the same to the user
        raise damaged(path, what, error) from None
    return content


def damaged(path: Path, what: str, error: Exception) -> DataError:
    """The error for a damaged file of torch.save."""
    reason = str(error).strip().splitlines()
    return DataError(
        f"{path}: damaged or not {what} ({reason[0][:120] if reason else type(error).__name__}). "
        "Take another file; in a run directory, delete this one to fall back on the checkpoint before it"
    )


def read_description(path: Path) -> Any:
    """What a weights file says about itself. Raises `DataError` for a file that is missing, too large, or other.

    The arrays are not read.
    """
    from safetensors import SafetensorError, safe_open

    try:
        size = path.stat().st_size
    except OSError as error:
        raise DataError(f"{path}: cannot read a policy ({error.strerror or error})") from None
    if size > MAX_WEIGHTS_BYTES:
        raise DataError(f"{path}: {size} bytes; a policy has at most {MAX_WEIGHTS_BYTES}")
    try:
        with safe_open(path, "np") as file:
            meta = file.metadata() or {}
            if (meta.get("format"), meta.get("schema")) != (FORMAT, SCHEMA):
                raise DataError(f"{path}: not a policy of this project (format {FORMAT!r}, schema {SCHEMA}); expected "
                                "a file that `dgrasp publish` wrote with this version of the code")
            return json.loads(meta.get("about", ""))
    except (SafetensorError, ValueError, RecursionError, OSError) as error:
        raise damaged_weights(path, error) from None


def damaged_weights(path: Path, error: Exception) -> DataError:
    """The error for a damaged file of weights."""
    return DataError(f"{path}: damaged or not a policy ({' '.join(str(error).split())[:120]}); take another file")


def check_policy_file(path: Path) -> None:
    """Raise `DataError` for the file of a policy that is missing or damaged."""
    if not path.is_file():
        raise DataError(f"{path}: no such file; expected a checkpoint (.pt) or a file of `dgrasp publish` "
                        f"({WEIGHTS_SUFFIX})")
    if path.suffix == WEIGHTS_SUFFIX:
        read_description(path)
    else:
        read_whole(path, "a checkpoint")
