"""Damaged label files: each ends in one `DataError` or in sound labels."""

from __future__ import annotations

import bz2
import gzip
import lzma
import os
import pickle
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse

from dgrasp.errors import DataError
from dgrasp.files import sparse
from dgrasp.files.joblib import read_joblib_arrays
from dgrasp.hand.mano.layout import MANO_NAMES
from dgrasp.labels.formats.native import read_native, write_native
from dgrasp.labels.formats.release import read_release
from dgrasp.types import GraspLabel
from tests.labels.files import (
    dexycb_content,
    dump,
    make_labels,
    static_content,
)

pytestmark = pytest.mark.filterwarnings("error")

N = int(os.environ.get("DGRASP_FUZZ", "2000"))
"""Mutated files of each kind; there are 20 kinds."""

EXTREMES = [struct.pack("<d", number) for number in (np.nan, np.inf, 1e300, -1e300, 1e-300)]
"""Numbers that no label holds, as bytes."""


def rewrite(path: Path, raw: bytes) -> None:
    """Write a file anew. Some file systems wait for the disk where a file that is there is truncated."""
    path.unlink(missing_ok=True)
    path.write_bytes(raw)


def mutate(raw: bytes, rng: np.random.Generator) -> bytes:
    """One to four changes: bits, bytes, runs cut out, doubled or moved, the end lost, extreme numbers."""
    data = bytearray(raw)
    # One call draws the numbers of all changes; a call for each takes as long as the readers.
    for where, early, length, kind, value in rng.random((int(rng.integers(1, 5)), 5)).tolist():
        if not data:
            break
        # Half of the changes hit the first kilobyte, where most of the structure is.
        at = int(where * (min(len(data), 1000) if early < 0.5 else len(data)))
        run = 1 + int(63 * length)
        kind = int(7 * kind)
        if kind == 0:
            data[at] ^= 1 << int(8 * value)
        elif kind == 1:
            data[at] = int(256 * value)
        elif kind == 2:
            del data[at : at + run]
        elif kind == 3:
            data[at:at] = data[at : at + run]
        elif kind == 4:
            data[at:at] = rng.bytes(run)
        elif kind == 5:
            data[at : at + 8] = EXTREMES[int(len(EXTREMES) * value)]
        else:
            del data[at:]
    return bytes(data)


def outcome(read: Callable[[Path], list[GraspLabel]], path: Path) -> bool:
    """Whether the file was refused; labels that were read must be sound. Anything but a `DataError` fails."""
    labels, message = None, ""
    try:
        labels = read(path)
    except DataError as error:
        message = str(error)
    if labels is None:
        assert str(path) in message
        assert len(message) < 2000
        return True
    for label in labels:
        for values in (label.hand_pose, label.T_WH, label.T_WO, label.joints_W):
            assert np.isfinite(values).all()
        assert label.goal_contacts.shape == (16,)
        np.testing.assert_allclose(label.T_WO[:3, :3] @ label.T_WO[:3, :3].T, np.eye(3), atol=1e-5)
    return False


@pytest.mark.parametrize("layout", [dexycb_content, static_content])
@pytest.mark.parametrize("aligned", [False, True])
def test_mutated_files_of_the_release(tmp_path: Path, layout: Callable[[], dict[int, Any]], aligned: bool) -> None:
    path = dump(tmp_path / "a.pkl", layout(), aligned)
    raw, rng = path.read_bytes(), np.random.default_rng(11)
    assert not outcome(read_release, path)
    refused = 0
    for _ in range(N):
        rewrite(path, mutate(raw, rng))
        refused += outcome(read_release, path)
    assert refused > N // 2


def test_mutated_native_files(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    write_native(path, make_labels(), "p", "l", MANO_NAMES)
    raw, rng = path.read_bytes(), np.random.default_rng(12)
    refused = 0
    for _ in range(N):
        rewrite(path, mutate(raw, rng))
        refused += outcome(read_native, path)
    assert refused > N // 2


def test_native_files_with_mutated_members(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    write_native(path, make_labels(), "p", "l", MANO_NAMES)
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    rng = np.random.default_rng(13)
    refused = 0
    for _ in range(N):
        victim = str(rng.choice(sorted(members)))
        path.unlink()
        with zipfile.ZipFile(path, "w") as archive:
            for name, raw in members.items():
                archive.writestr(name, mutate(raw, rng) if name == victim else raw)
        refused += outcome(read_native, path)
    assert refused > N // 4


@pytest.mark.parametrize("protocol", range(6))
def test_mutated_plain_pickles(tmp_path: Path, protocol: int) -> None:
    path = tmp_path / "a.pkl"
    raw, rng = pickle.dumps(dexycb_content(objects=(3,)), protocol), np.random.default_rng(14)
    path.write_bytes(raw)
    assert not outcome(read_release, path)
    refused = 0
    for _ in range(N):
        rewrite(path, mutate(raw, rng))
        refused += outcome(read_release, path)
    assert refused > N // 2


@pytest.mark.parametrize("form", [zlib.compress, gzip.compress, bz2.compress, lzma.compress])
def test_mutated_compressed_pickles(tmp_path: Path, form: Callable[[bytes], bytes]) -> None:
    path = tmp_path / "a.pkl"
    raw, rng = form(pickle.dumps(dexycb_content(objects=(3,)), 4)), np.random.default_rng(15)
    path.write_bytes(raw)
    assert not outcome(read_release, path)
    refused = 0
    for _ in range(N):
        rewrite(path, mutate(raw, rng))
        refused += outcome(read_release, path)
    assert refused > 0.9 * N


@pytest.mark.parametrize("form", sparse.FORMS)
def test_mutated_sparse_matrices(tmp_path: Path, form: str) -> None:
    matrix = getattr(scipy.sparse, f"{form}_matrix")(np.diag([1.0, 2.0, 3.0]))
    raw, rng, path = pickle.dumps({"a": matrix}, 4), np.random.default_rng(16), tmp_path / "a.pkl"
    for _ in range(N):
        rewrite(path, mutate(raw, rng))
        try:
            found = read_joblib_arrays(path)
            values = found.values() if isinstance(found, dict) else []
            dense = [sparse.dense(value, 100) for value in values if isinstance(value, sparse.SparseStub)]
        except DataError:
            continue
        assert all(one.dtype == np.float64 for one in dense)


def test_every_truncation_point_is_refused(tmp_path: Path) -> None:
    path = dump(tmp_path / "a.pkl", static_content(objects=(3,), n=1))
    raw = path.read_bytes()
    for end in range(0, len(raw), 23):
        path.write_bytes(raw[:end])
        assert outcome(read_release, path)
