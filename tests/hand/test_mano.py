"""MANO's files: read to the bit, refused where they are not what they should be, never executed."""

from __future__ import annotations

import dataclasses
import os
import pickle
import pickletools
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import sparse

from dgrasp.errors import DataError
from dgrasp.hand.free.skin import skin_path
from dgrasp.hand.mano.file import MAX_FILE_BYTES, read_mano
from dgrasp.hand.mano.model import PART_TO_MANO, ManoModel, tip_vertices
from dgrasp.hand.mano.skeleton import PARTS
from dgrasp.types import Array
from tests.hand.mano_file import Ch, Csc, Select, mano_arrays, mano_content, pickled, write_mano
from tests.labels.test_fuzz import mutate

N_MUTATED = 2000
FIELDS = {
    "v_template": "template", "shapedirs": "shape_basis", "posedirs": "pose_basis", "J_regressor": "J_regressor",
    "weights": "weights", "f": "faces", "hands_mean": "hands_mean", "hands_components": "hands_components",
}  # fmt: skip


def tiny_arrays() -> dict[str, Array]:
    """A hand of 16 vertices, one at each joint: small, to be read thousands of times."""
    whole = mano_arrays()
    joints = whole["J"]
    n = len(joints)
    return {
        **whole, "v_template": joints, "f": np.array([[0, 1, 2], [2, 1, 3]], np.uint32), "weights": np.eye(n),
        "J_regressor": np.eye(n), "shapedirs": whole["shapedirs"][:n, :, :2], "posedirs": whole["posedirs"][:n],
        "hands_coeffs": np.zeros((2, 45)), "J": joints,
    }  # fmt: skip


def write(path: Path, content: Any) -> Path:
    path.write_bytes(pickled(content))
    return path


@pytest.mark.parametrize("side", ["right", "left"])
def test_arrays_come_back_to_the_bit(tmp_path: Path, side: str) -> None:
    arrays = mano_arrays(side=side)
    assert len(arrays["v_template"]) <= 778
    model = read_mano(write_mano(tmp_path / "MANO.pkl", arrays))
    for key, field in FIELDS.items():
        assert np.array_equal(getattr(model, field), arrays[key]), key
    assert model.side == side
    assert model.kintree[0].tolist() == [-1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14]


def test_the_made_up_file_asks_for_what_manos_asks_for(tmp_path: Path) -> None:
    raw = write_mano(tmp_path / "MANO.pkl").read_bytes()
    asked = {arg for op, arg, _ in pickletools.genops(raw) if op.name == "GLOBAL"}
    assert asked == {
        "chumpy.ch Ch", "chumpy.reordering Select", "scipy.sparse.csc csc_matrix", "__builtin__ set", "numpy ndarray",
        "numpy dtype", "numpy.core.multiarray _reconstruct",
    }  # fmt: skip
    assert "chumpy" not in sys.modules


def test_plain_arrays_of_python_3_are_read(tmp_path: Path) -> None:
    arrays = mano_arrays()
    for protocol in (3, 4):
        (tmp_path / "a.pkl").write_bytes(pickle.dumps(arrays, protocol))
        assert np.array_equal(read_mano(tmp_path / "a.pkl").pose_basis, arrays["posedirs"])


@pytest.mark.parametrize("protocol", range(6))
def test_every_protocol_with_a_sparse_regressor(tmp_path: Path, protocol: int) -> None:
    arrays = mano_arrays()
    content = {**arrays, "J_regressor": sparse.coo_matrix(arrays["J_regressor"])}
    (tmp_path / "a.pkl").write_bytes(pickle.dumps(content, protocol))
    assert np.array_equal(read_mano(tmp_path / "a.pkl").J_regressor, arrays["J_regressor"])


def test_npz_archives(tmp_path: Path) -> None:
    arrays = mano_arrays()
    np.savez(tmp_path / "plain.npz", **arrays, more=np.array(["not read"]))
    np.savez_compressed(tmp_path / "objects.npz", **{
        **arrays, "J_regressor": np.array(sparse.csc_matrix(arrays["J_regressor"]), dtype=object), "bs_style": "lbs",
    })  # fmt: skip
    for name in ("plain.npz", "objects.npz"):
        model = read_mano(tmp_path / name)
        for key, field in FIELDS.items():
            assert np.array_equal(getattr(model, field), arrays[key]), key
    # The free hand's own file.
    assert read_mano(skin_path()).side == "right"
    np.savez(tmp_path / "evil.npz", **{**arrays, "J_regressor": np.array(Path("x"), dtype=object)})
    with pytest.raises(DataError, match=r"evil\.npz: .*asks for 'pathlib"):
        read_mano(tmp_path / "evil.npz")
    np.savez(tmp_path / "text.npz", **{**arrays, "J_regressor": np.array(["a"])})
    with pytest.raises(DataError, match="J_regressor is a ndarray; expected an array of numbers"):
        read_mano(tmp_path / "text.npz")


def test_other_forms_of_the_same_numbers(tmp_path: Path) -> None:
    arrays = mano_arrays()
    content = mano_content(arrays)
    content["posedirs"], content["shapedirs"] = Ch(arrays["posedirs"]), Ch(arrays["shapedirs"])
    content["J_regressor"] = arrays["J_regressor"]
    content["v_template"] = Select(Ch(arrays["v_template"]), np.arange(arrays["v_template"].size), (-1, 3))
    # A shape with a free length is left as it is: one row of numbers, which no template is.
    with pytest.raises(DataError, match=r"v_template has shape"):
        read_mano(write(tmp_path / "a.pkl", content))
    content["v_template"] = arrays["v_template"].astype(">f8")
    model = read_mano(write(tmp_path / "b.pkl", content))
    assert np.array_equal(model.template, arrays["v_template"]) and model.template.dtype == np.float64


def test_fingers_change_places(tmp_path: Path) -> None:
    assert [PARTS[PART_TO_MANO.index(j)] for j in (1, 4, 7, 10, 13)] == [
        "index_proximal", "middle_proximal", "little_proximal", "ring_proximal", "thumb_proximal",
    ]  # fmt: skip
    model = read_mano(write_mano(tmp_path / "MANO.pkl"))
    _, joints = model.shaped(np.zeros(0))
    # From the thumb's side to the little finger's: index, middle, ring, little.
    assert (np.diff(joints[[1, 4, 7, 10], 2]) < -0.01).all()
    owner = model.part_weights().argmax(axis=1)
    assert [PARTS[owner[v]] for v in model.tip_vertices] == [f"{f}_distal" for f in
                                                             ("index", "middle", "ring", "little", "thumb")]


def test_mean_shape_and_betas(tmp_path: Path) -> None:
    arrays = mano_arrays()
    model = read_mano(write_mano(tmp_path / "MANO.pkl", arrays))
    vertices, joints = model.shaped(np.zeros(10))
    assert np.array_equal(vertices, arrays["v_template"])
    vertices, joints = model.shaped(np.array([0.5, -1.0]))
    by_hand = arrays["v_template"] + 0.5 * arrays["shapedirs"][..., 0] - arrays["shapedirs"][..., 1]
    assert np.abs(vertices - by_hand).max() < 1e-15
    assert np.abs(joints[7] - arrays["J_regressor"][10] @ by_hand).max() < 1e-15
    for betas, message in ((np.zeros(11), "at most 10"), (np.array([np.nan]), "finite"),
                           (np.array([30.0]), "few units"), (np.zeros((1, 2)), "at most 10")):
        with pytest.raises(DataError, match=message):
            model.shaped(betas)
    # The mean shape may be written with more zeros than the file has shapes.
    assert model.own_betas(np.zeros((2, 11))).shape == (2, 10) and model.own_betas(np.ones((2, 3))).shape == (2, 3)
    with pytest.raises(DataError, match=r"at most 10\), because the MANO file has 10"):
        model.own_betas(np.eye(11))
    with pytest.raises(DataError, match="long"):
        dataclasses.replace(model, shape_basis=1e3 * model.shape_basis).shaped(np.ones(1))


def test_tips_of_manos_own_mesh_are_the_known_ones() -> None:
    known = {"index": 317, "middle": 444, "ring": 556, "little": 673, "thumb": 745}
    weights = np.zeros((778, 16))
    weights[:, 0] = 1.0
    joints, template = np.zeros((16, 3)), np.random.default_rng(0).normal(size=(778, 3))
    for finger, vertex in known.items():
        joint = PART_TO_MANO[PARTS.index(f"{finger}_distal")]
        weights[[vertex, vertex + 1]] = np.eye(16)[joint]
        template[vertex + 1] = 9.0
    assert tip_vertices(template, joints, weights, "right").tolist() == list(known.values())
    # Another mesh of as many vertices: the farthest vertex of each distal part.
    weights[745] = np.eye(16)[0]
    assert tip_vertices(template, joints, weights, "right").tolist() == [v + 1 for v in known.values()]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"v_template": None}, "v_template is a NoneType"),
        ({"v_template": "drop"}, "lacks v_template"),
        ({"v_template": lambda a: a["v_template"] * 1000.0}, "expected 0.08 to 0.5 m"),
        ({"v_template": lambda a: a["v_template"] * np.nan}, "NaN"),
        ({"v_template": lambda a: a["v_template"][:, [1, 0, 2]]}, "MANO's frame"),
        ({"v_template": lambda a: a["v_template"] * [1, 1, -1]}, "MANO's frame"),
        ({"weights": lambda a: a["weights"] * 0.5}, "do not sum to 1"),
        ({"weights": lambda a: a["weights"][:, :15]}, r"weights has shape \(16, 15\); expected \(16, 16\)"),
        ({"f": lambda a: a["f"] + 15}, "vertices outside"),
        ({"f": lambda a: a["f"].astype(float)}, "whole"),
        ({"f": lambda a: a["f"][:0]}, "0 faces"),
        ({"posedirs": lambda a: a["posedirs"][:, :, :134]}, r"posedirs has shape"),
        ({"posedirs": lambda a: a["posedirs"] * 1e12}, "beyond 1e6"),
        ({"kintree_table": lambda a: a["kintree_table"][:, ::-1]}, "kintree_table"),
        ({"J_regressor": lambda a: a["J_regressor"] * 9.0}, "outside the hand"),
        ({"J_regressor": lambda a: a["J_regressor"][[*range(7), 10, 11, 12, 7, 8, 9, 13, 14, 15]]}, "order index"),
        ({"hands_components": lambda a: a["hands_components"][:6]}, "hands_components"),
        ({"bs_style": lambda a: "dqs"}, "bs_style is 'dqs'"),
    ],
)
def test_a_file_that_does_not_fit(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    arrays = tiny_arrays()
    content = mano_content(arrays)
    for key, value in change.items():
        if value == "drop":
            del content[key]
        else:
            content[key] = value(arrays) if callable(value) else value
    with pytest.raises(DataError, match=message) as caught:
        read_mano(write(tmp_path / "bad.pkl", content))
    assert str(tmp_path / "bad.pkl") in str(caught.value)


def test_damaged_expressions_and_matrices(tmp_path: Path) -> None:
    arrays = tiny_arrays()
    cases: list[tuple[str, Any]] = []
    for indices in (np.array([10**6]), np.array([-1]), np.array([0.5])):
        cases.append(("shapedirs", Select(Ch(arrays["shapedirs"]), indices, (1,))))
    cases.append(("shapedirs", Select(Ch("no array"), np.arange(3), (3,))))  # type: ignore[arg-type]
    itself = Select(Ch(arrays["shapedirs"]), np.arange(3), (3,))
    vars(itself)["a"] = itself
    cases.append(("shapedirs", itself))
    for change in ({"indices": np.array([99] * 16)}, {"indptr": np.arange(16)}, {"_shape": (10**5, 10**5)},
                   {"_shape": "x"}, {"data": np.arange(3.0)}, {"indptr": np.arange(17)[::-1].copy()}):
        matrix = Csc(arrays["J_regressor"])
        vars(matrix).update(change)
        cases.append(("J_regressor", matrix))
    for key, value in cases:
        with pytest.raises(DataError, match=key):
            read_mano(write(tmp_path / "a.pkl", {**mano_content(arrays), key: value}))


def test_files_that_are_none(tmp_path: Path) -> None:
    path = tmp_path / "a.pkl"
    for raw, message in ((b"", "not a pickle"), (b"PK\x03\x04", "not a pickle"), (b"\x80\x02.", "damaged"),
                         (b"\x80\x02K\x01.", "holds a int"), (pickled([]), "holds a list")):
        path.write_bytes(raw)
        with pytest.raises(DataError, match=message):
            read_mano(path)
    with pytest.raises(DataError, match="cannot be read"):
        read_mano(tmp_path / "none.pkl")
    with path.open("wb") as stream:
        stream.truncate(MAX_FILE_BYTES + 1)
    with pytest.raises(DataError, match="at most"):
        read_mano(path)


def sound(model: ManoModel) -> bool:
    return all(np.isfinite(getattr(model, field)).all() for field in FIELDS.values())


def test_mutated_files(tmp_path: Path) -> None:
    path = write_mano(tmp_path / "a.pkl", tiny_arrays())
    raw, rng = path.read_bytes(), np.random.default_rng(14)
    assert sound(read_mano(path))
    refused = 0
    for _ in range(N_MUTATED):
        path.write_bytes(mutate(raw, rng))
        try:
            assert sound(read_mano(path))
        except DataError as error:
            refused += 1
            assert str(path) in str(error) and len(str(error)) < 2000
    assert refused > N_MUTATED // 2


def test_every_truncation_is_refused(tmp_path: Path) -> None:
    raw = pickled(mano_content(tiny_arrays()))
    for end in range(0, len(raw), 499):
        (tmp_path / "a.pkl").write_bytes(raw[:end])
        with pytest.raises(DataError, match=r"a\.pkl"):
            read_mano(tmp_path / "a.pkl")


def hostile(command: str) -> Iterator[bytes]:
    """Streams that would run a shell's command, or fill the memory."""
    word = b"X" + len(command).to_bytes(4, "little") + command.encode()
    yield b"\x80\x02cos\nsystem\n" + word + b"\x85R."
    yield b"\x80\x02}U\x0av_templatecos\nsystem\n" + word + b"\x85Rs."
    yield b"\x80\x02(cos\nsystem\n" + word + b"o."
    yield b"\x80\x02(" + word + b"ios\nsystem\n."
    yield b"\x80\x02cchumpy.ch\nCh\n)\x81}U\x0c__setstate__cos\nsystem\nsb."
    yield b"\x80\x02cchumpy.ch\n__builtins__\n."
    yield b"\x80\x02cscipy.sparse\ncsc_matrix\n."
    yield b"\x80\x02cchumpy.ch\nCh\n)\x81cos\nsystem\nb."
    yield b"\x80\x02c__builtin__\neval\n" + word + b"\x85R."
    yield b"\x80\x02" + b"]" * 2_000_000 + b"."
    yield b"\x80\x02" + b"}" * 2_000_000 + b"."
    # One text of a megabyte as the bytes of a thousand arrays.
    array = b"cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85U\x01b\x87R(K\x01J\x00\x00\x10\x00\x85"
    array += b"cnumpy\ndtype\nU\x02u1K\x00K\x01\x87R(K\x03U\x01|NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb\x89h\x00tb"
    yield b"\x80\x02T\x00\x00\x10\x00" + b"\x00" * 2**20 + b"q\x00]" + (array + b"a") * 1000 + b"."


def test_nothing_is_executed_and_the_memory_not_filled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    called: list[Any] = []
    monkeypatch.setattr(os, "system", called.append)
    for raw in hostile(f"touch {tmp_path / 'executed'}"):
        (tmp_path / "a.pkl").write_bytes(raw)
        with pytest.raises(DataError, match=r"a\.pkl"):
            read_mano(tmp_path / "a.pkl")
    assert not called and not (tmp_path / "executed").exists()
