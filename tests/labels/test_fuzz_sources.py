"""Damaged and hostile files of DexYCB, HO3D and tables: one `DataError` each or sound data, and nothing is executed."""

from __future__ import annotations

import io
import os
import pickle
import re
import resource
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from dgrasp.errors import DataError
from dgrasp.files.yaml import read_yaml
from dgrasp.hand.mano.file import read_mano
from dgrasp.labels.recorded.cache import LabelCache
from dgrasp.labels.recorded.dexycb import Calibration, Sequence, read_sequence, read_track
from dgrasp.labels.recorded.ho3d import read_annotation
from dgrasp.labels.recorded.mano_table import read_mano_table
from dgrasp.labels.recorded.skips import Skip
from tests.hand.mano_file import pickled
from tests.labels.files import make_labels
from tests.labels.mini_dexycb import make_mini, mano_files, standard
from tests.labels.test_fuzz import mutate, rewrite
from tests.labels.test_ho3d import annotation, text_protocol
from tests.labels.test_hostile import hostile_streams, in_extension_registry  # noqa: F401
from tests.labels.test_mano_tables import GIVEN, table, write_csv

N = int(os.environ.get("DGRASP_FUZZ", "2000"))
"""Mutated files of each kind; there are 14 kinds."""
GIGABYTE = 2**20
"""In the unit of `ru_maxrss`, kilobytes."""


@pytest.fixture(autouse=True)
def bounded() -> Iterator[None]:
    """Nothing takes a gigabyte."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    yield
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < GIGABYTE


def refused(read: Callable[[], Any], path: Path) -> bool:
    """Whether the file was refused, by an error of ours that names it; what was read instead is finite."""
    try:
        value = read()
    except DataError as error:
        assert str(path) in str(error) and len(str(error)) < 2000
        return True
    except Skip:
        return False
    for array in vars(value).values() if hasattr(value, "__dict__") else [value]:
        if isinstance(array, np.ndarray) and array.dtype.kind == "f":
            assert np.isfinite(array).all()
    return False


def fuzz(path: Path, read: Callable[[], Any], seed: int, least: float, raw: bytes | None = None) -> None:
    """N mutations of a file; at least the share `least` of them is refused, and the file itself is not."""
    raw, rng = path.read_bytes() if raw is None else raw, np.random.default_rng(seed)
    path.write_bytes(raw)
    assert not refused(read, path)
    count = 0
    for _ in range(N):
        rewrite(path, mutate(raw, rng))
        count += refused(read, path)
    assert count >= least * N


@pytest.fixture
def recording(tmp_path: Path) -> Sequence:
    return read_sequence(make_mini(tmp_path / "dex")[0].add("s1", "a", standard()))


def test_sequences(recording: Sequence) -> None:
    fuzz(recording.folder / "meta.yml", lambda: read_sequence(recording.folder), 1, 0.3)


def test_poses(recording: Sequence) -> None:
    fuzz(recording.folder / "pose.npz", lambda: read_track(recording), 2, 0.7)


def test_poses_with_mutated_members(recording: Sequence) -> None:
    """The archive stays whole, so that what is damaged reaches the readers of arrays and numbers."""
    path = recording.folder / "pose.npz"
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    rng, count = np.random.default_rng(3), 0
    for _ in range(N):
        victim = str(rng.choice(sorted(members)))
        path.unlink()
        with zipfile.ZipFile(path, "w") as archive:
            for name, raw in members.items():
                archive.writestr(name, mutate(raw, rng) if name == victim else raw)
        count += refused(lambda: read_track(recording), path)
    assert count > 0.3 * N


def test_calibrations(recording: Sequence, tmp_path: Path) -> None:
    root = tmp_path / "dex"
    camera = root / "calibration" / f"extrinsics_{recording.extrinsics}" / "extrinsics.yml"
    hand = root / "calibration" / f"mano_{recording.mano}" / "mano.yml"
    fuzz(camera, lambda: Calibration(root).world(recording.extrinsics), 4, 0.3)
    fuzz(hand, lambda: Calibration(root).betas(recording.mano), 5, 0.3)


@pytest.mark.parametrize("form", [pickled, text_protocol, lambda content: pickle.dumps(content, 4),
                                  lambda content: pickle.dumps(content, 0), lambda content: pickle.dumps(content, 5)],
                         ids=["python 2", "text", "python 3", "protocol 0", "protocol 5"])
def test_annotations(tmp_path: Path, form: Callable[[Any], bytes]) -> None:
    mini, _, _ = make_mini(tmp_path / "dex")
    path = tmp_path / "0.pkl"
    fuzz(path, lambda: read_annotation(path), 6, 0.3, form(annotation(mini)))


@pytest.mark.parametrize("kind", ["npz", "csv"])
def test_tables(tmp_path: Path, kind: str) -> None:
    mini, _, _ = make_mini(tmp_path / "dex")
    arrays, path = table(mini, GIVEN), tmp_path / f"a.{kind}"
    if kind == "csv":
        write_csv(path, arrays)
    else:
        np.savez(path, **arrays)
    fuzz(path, lambda: read_mano_table(path), 7, 0.3)


def test_mano_files(tmp_path: Path) -> None:
    raw, rng, path = mano_files()[0][0], np.random.default_rng(8), tmp_path / "m.pkl"
    count = 0
    # They are large, so fewer; and only the structure in front is worth much.
    for _ in range(N // 10):
        rewrite(path, mutate(raw, rng))
        count += refused(lambda: read_mano(path), path)
    assert count > 0


def test_cached_labels(tmp_path: Path) -> None:
    cache, key = LabelCache(tmp_path), {"a": 1}
    cache.put(key, make_labels()[1])
    (path,) = tmp_path.iterdir()
    raw, rng = path.read_bytes(), np.random.default_rng(9)
    for _ in range(N):
        rewrite(path, mutate(raw, rng))
        found = cache.get(key)
        assert found is None or isinstance(found, Skip) or np.isfinite(found.T_WH).all()


def test_nothing_is_executed(
    tmp_path: Path, in_extension_registry: None, monkeypatch: pytest.MonkeyPatch  # noqa: F811
) -> None:
    marker, called, path = tmp_path / "executed", [], tmp_path / "a.pkl"
    streams = list(hostile_streams(f"touch {marker}", f"open({str(marker)!r}, 'w')"))
    command = f"touch {marker}".encode()
    streams += [("text", b"cos\nsystem\n(S'" + command + b"'\ntR."),
                ("text INST", b"(S'" + command + b"'\nios\nsystem\n."),
                ("in a text dictionary", b"(dS'handPose'\ncos\nsystem\n(S'" + command + b"'\ntRs.")]
    monkeypatch.setattr(os, "system", called.append)
    for name, raw in streams:
        rewrite(path, raw)
        assert refused(lambda: read_annotation(path), path), name
        assert not marker.exists() and not called, name
    evil = tmp_path / "a.yml"
    for tag in ("object/apply:os.system", "object/new:os.system", "name:os.system", "module:os", "object:os.system"):
        evil.write_text(f"a: !!python/{tag} ['touch {marker}']\n")
        assert refused(lambda: read_yaml(evil), evil)
        assert not marker.exists() and not called
    for file, array in (("pose.npz", "pose_m"), ("a.npz", "transl")):
        np.savez(tmp_path / file, **{array: np.array([Path(marker)], dtype=object)})
    assert refused(lambda: read_mano_table(tmp_path / "a.npz"), tmp_path / "a.npz")


def _aliases(levels: int, form: str) -> str:
    """Lines that each hold the line before twice."""
    lines = [f"a0: &a0 {form.format('1', '2')}"]
    lines += [f"a{i}: &a{i} {form.format(f'*a{i - 1}', f'*a{i - 1}')}" for i in range(1, levels)]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    ("text", "bad"),
    [
        (_aliases(60, "[{}, {}]"), False),
        (_aliases(60, "!!python/tuple [{}, {}]"), False),
        (_aliases(60, "!!python/tuple [{}, {}]") + "? *a59\n: 1\n", True),
        ("a: &a {x: 1}\n" + "\n".join(f"b{i}: &b{i} {{<<: [{'*a' if i == 0 else f'*b{i - 1}'}, *a]}}"
                                      for i in range(60)), True),
        ("a: &a !!python/tuple [*a]\n", True),
        ("a: " + "[" * 5_000, True),
        ("a: " + "1" * 40_000, True),
        ("a: " + ":".join(["1"] * 20_000), False),
        ("a: !!binary '" + "A" * 1001 + "'\n", True),
        ("a: 2020-99-99\n", True),
        ("a: !!python/tuple 3\n", True),
        ("a: 1\na: 2\n", True),
        ("- 1\n", True),
        ("\0", True),
        ("a: 1\n" * 60_000, True),
    ],
    ids=range(15),
)  # fmt: skip
def test_yaml_made_to_hang_or_fill_the_memory(tmp_path: Path, text: str, bad: bool) -> None:
    path = tmp_path / "a.yml"
    path.write_text(text)
    try:
        read_yaml(path)
        assert not bad
    except DataError as error:
        assert bad or "plain YAML" in str(error)


def _bomb(path: Path, name: str, announced: int | None = None) -> None:
    """An archive of a few kilobytes whose member unpacks to 40 MB of zeros; or announces just so many bytes of them."""
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": "<f8", "fortran_order": False, "shape": (5_000_000, 1)})
    raw = stream.getvalue() + bytes(40_000_000)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(f"{name}.npy", raw)
    if announced is not None:
        content = path.read_bytes()
        assert content.count(len(raw).to_bytes(4, "little")) == 2
        path.write_bytes(content.replace(len(raw).to_bytes(4, "little"), announced.to_bytes(4, "little")))


def test_zip_bombs(tmp_path: Path, recording: Sequence) -> None:
    path = tmp_path / "a.npz"
    for announced in (None, 1000):
        _bomb(path, "transl", announced)
        assert refused(lambda: read_mano_table(path), path)
        _bomb(recording.folder / "pose.npz", "pose_m", announced)
        assert refused(lambda: read_track(recording), recording.folder / "pose.npz")
    # A header that announces more than any memory holds, with nothing behind it.
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": "<f8", "fortran_order": False, "shape": (2**60, 3)})
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("transl.npy", stream.getvalue())
    assert refused(lambda: read_mano_table(path), path)
    with zipfile.ZipFile(path, "w") as archive:
        for i in range(1500):
            archive.writestr(f"{i}.npy", b"")
    assert refused(lambda: read_mano_table(path), path)


def test_wrong_shapes(tmp_path: Path, recording: Sequence) -> None:
    rng, path = np.random.default_rng(10), tmp_path / "a.npz"
    kinds = (np.float32, np.float64, np.int16, np.bool_, np.complex64, "U3", "S4")
    for _ in range(100):
        shape = tuple(int(n) for n in rng.integers(0, 5, rng.integers(0, 5)))
        array = rng.uniform(-3, 3, shape).astype(kinds[rng.integers(len(kinds))])
        np.savez(path, object=np.array(["004"] * 2), transl=array)
        refused(lambda: read_mano_table(path), path)
        np.savez(recording.folder / "pose.npz", pose_m=array, pose_y=array)
        assert refused(lambda: read_track(recording), recording.folder / "pose.npz")


def test_missing_and_unreadable(tmp_path: Path) -> None:
    for read in (read_yaml, read_annotation, read_mano_table):
        for path in (tmp_path / "none", tmp_path):
            with pytest.raises(DataError, match=re.escape(str(path))):
                read(path)
    (tmp_path / "a.yml").write_bytes(yaml.dump({"a": "é"}, allow_unicode=True).encode("latin1"))
    with pytest.raises(DataError, match="not plain YAML"):
        read_yaml(tmp_path / "a.yml")
