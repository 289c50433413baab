"""The free hand's skin as a file: the shipped one, damaged ones, the command that builds hands of it."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
import pytest

from dgrasp.cli import run_command
from dgrasp.errors import DataError
from dgrasp.geometry import approximate
from dgrasp.geometry.intersection import join
from dgrasp.hand.builder.build import DENSITY
from dgrasp.hand.builder.limits import mirror_limits
from dgrasp.hand.free.flesh import Flesh, field, onto_surface
from dgrasp.hand.free.make_skin import SHAPES, main
from dgrasp.hand.free.skin import MEMBERS, free_skin, read_skin, skin_path
from dgrasp.hand.mano.model import MIRROR
from dgrasp.hand.mano.skeleton import PART_PARENT
from dgrasp.hand.store import open_hand
from dgrasp.hand.surface import SKIN, hand_surface
from tests.scenes import free_hand


def test_the_shipped_file_is_what_the_generator_writes(tmp_path: Path) -> None:
    main([str(tmp_path / "again.npz")])
    with np.load(skin_path(), allow_pickle=False) as shipped, np.load(tmp_path / "again.npz") as made:
        assert set(shipped.files) == {"meta", *MEMBERS} == set(made.files)
        for name in MEMBERS:
            assert shipped[name].dtype == made[name].dtype
            # Both are rounded to nine decimals; the regressor's solution may differ in its last digits.
            assert np.abs(shipped[name] - made[name]).max() <= 1.1e-9, name
        meta = json.loads(str(shipped["meta"]))
    assert meta["licence"] == "MIT" and meta["shapes"] == [name for name, _ in SHAPES]
    assert skin_path().stat().st_size < 200_000


def test_bad_files(tmp_path: Path) -> None:
    with np.load(skin_path(), allow_pickle=False) as shipped:
        content = {name: shipped[name] for name in shipped.files}
    path = tmp_path / "skin.npz"
    cases = (({"weights": None}, "lacks weights"), ({"meta": np.array('{"format": "x"}')}, "not a hand model"),
             ({"v_template": 1000.0 * content["v_template"]}, "expected 0.08 to 0.5 m"),
             ({"f": content["f"] + 700}, "vertices outside"))  # fmt: skip
    for change, message in cases:
        stream = io.BytesIO()
        changed = {k: v for k, v in (content | change).items() if v is not None}
        np.savez_compressed(stream, **changed)
        path.write_bytes(stream.getvalue())
        with pytest.raises(DataError, match=message) as caught:
            read_skin(path)
        assert str(path) in str(caught.value)
    path.write_bytes(b"PK nothing")
    with pytest.raises(DataError, match="damaged hand model"):
        read_skin(path)


def test_the_field_of_one_body_is_known() -> None:
    ball = (Flesh(np.zeros(3), np.array([0.0, 0.0, 0.02]), (0.01, 0.01)),)
    value, slope = field(np.array([[0.015, 0.0, 0.01], [0.0, 0.0, 0.035]]), ball)
    assert value == pytest.approx([0.005, 0.005]) and slope == pytest.approx(np.array([[1.0, 0, 0], [0, 0, 1.0]]))
    cone = (Flesh(np.zeros(3), np.array([0.03, 0.0, 0.0]), (0.01, 0.006), 0.7), ball[0])
    points = np.random.default_rng(0).uniform(-0.03, 0.04, (50, 3))
    step = 1e-6 * np.eye(3)
    exact = np.stack([(field(points + h, cone)[0] - field(points - h, cone)[0]) / 2e-6 for h in step], axis=1)
    assert field(points, cone)[1] == pytest.approx(exact, abs=1e-4)
    there = onto_surface(points, cone, np.ones_like(points), 12)
    assert np.abs(field(there, cone)[0]).max() < 1e-6


def test_a_hand_built_of_the_skin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(approximate, "_FIT_POINTS", 500)
    monkeypatch.setattr(approximate, "_REPORT_POINTS", 1500)
    words = ["--free", "--side", "left", "--betas", "1", "0.5", "--out", str(tmp_path / "left")]
    assert run_command("hand build", words) == 0
    own, left = free_hand(), open_hand(str(tmp_path / "left"))
    assert left.model.id.startswith("free_left-") and left.meta["side"] == "left"
    assert left.meta["licence"].startswith("MIT") and left.meta["model_file"] == "free_skin.npz"
    _, joints = free_skin().shaped(np.array([1.0, 0.5]))
    steps = (joints[1:] - joints[list(PART_PARENT[1:])]) * MIRROR
    assert np.abs(left.model.offsets[1:] - steps).max() < 2e-6
    assert np.abs(left.model.limits[6:] - mirror_limits(own.limits[6:])).max() < 6e-6
    # The skin itself is its surface.
    surface = hand_surface(left.model, None, left.meta)
    assert surface.kind == SKIN
    whole = join(surface.pieces(np.eye(4), np.zeros(45))).solid.volume()
    assert DENSITY * whole == pytest.approx(left.model.urdf.mass, rel=0.01)
