"""Batches on MuJoCo Warp: agreement with MuJoCo, rows, groups, broken worlds, graphs, room for contacts."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dgrasp.pool import make_pool
from raisim_like import EngineError, Shape, UrdfModel
from raisim_like.registry import find_engine
from tests.raisim_like.warp_worlds import (
    GROUND,
    HIGH,
    LOW,
    Start,
    advance,
    begin,
    busy,
    everything,
    make,
    read_machine,
    world_spec,
)  # fmt: skip
from tests.scenes import make_spec

pytest.importorskip("mujoco_warp", reason="MuJoCo Warp is not installed: pip install 'dgrasp[warp]'")


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> UrdfModel:
    return read_machine(tmp_path_factory.mktemp("warp"))


def test_it_agrees_with_mujoco(machine: UrdfModel) -> None:
    """The same worlds in double precision, with the same model and the same law."""
    starts = [busy(k) for k in range(2)]
    here, there = (make([world_spec(machine)] * 2, starts, engine) for engine in ("warp", "mujoco"))
    for batch in (here, there):
        advance(batch, 6, 13)
    assert everything(here) == pytest.approx(everything(there), abs=2e-3)
    assert np.abs(everything(here) - everything(there))[:, :4].max() < 1e-4
    for batch in (here, there):
        batch.close()


def test_rows_that_do_not_advance_keep_their_state_to_the_bit(machine: UrdfModel) -> None:
    starts = [busy(k) for k in range(4)]
    parted, whole = (make([world_spec(machine)] * 4, starts) for _ in range(2))
    impulse = np.zeros((4, 2))
    advance(parted, 5, 13)
    parted.link_impulses(range(4), HIGH, impulse)
    before, pressed = everything(parted), impulse.copy()
    advance(parted, 5, 13, rows=[3, 1])
    assert np.array_equal(everything(parted, [0, 2]), before[[0, 2]])
    assert (everything(parted, [1, 3]) != before[[1, 3]]).sum() > 20
    parted.link_impulses(range(4), HIGH, impulse)
    assert np.array_equal(impulse[[0, 2]], pressed[[0, 2]]) and pressed.any()
    # Later they go on as if the others had not been advanced in between.
    advance(parted, 5, 13, rows=[0, 2])
    advance(whole, 10, 13)
    assert np.array_equal(everything(parted), everything(whole))
    for batch in (parted, whole):
        batch.close()


def test_a_row_that_breaks_harms_no_other_row_of_its_group(machine: UrdfModel) -> None:
    starts = [busy(k) for k in range(3)]
    batch, sound = (make([world_spec(machine)] * 3, starts) for _ in range(2))
    for one, value in ((batch, np.nan), (sound, 0.0)):
        advance(one, 2, 13)
        targets = np.zeros((3, 2))
        targets[1] = value
        with np.errstate(invalid="ignore"):
            one.advance(range(3), targets, 13)
    assert batch.broken().tolist() == [False, True, False] and not sound.broken().any()
    advance(batch, 3, 13)
    advance(sound, 3, 13)
    assert batch.broken().tolist() == [False, True, False]
    assert np.array_equal(everything(batch, [0, 2]), everything(sound, [0, 2]))
    batch.rebuild([1])
    for one in (batch, sound):
        begin(one, [1], [busy(7)])
        assert not one.broken().any()
        advance(one, 4, 13)
    assert np.array_equal(everything(batch), everything(sound))
    for one in (batch, sound):
        one.close()


def test_a_row_placed_twice_does_the_same_twice(machine: UrdfModel) -> None:
    batch, ends = make([world_spec(machine)] * 2, [busy(0), busy(3)]), []
    for _ in range(2):
        begin(batch, [0], [busy(5)])
        assert batch.state.bodies[0].tolist() == busy(5).bodies.tolist() and not batch.state.gv[0].any()
        touching = np.full(2, np.nan)
        batch.touching([0], LOW, GROUND, touching)
        assert touching[0] == 0.0
        advance(batch, 8, 13)
        ends.append(everything(batch)[0].tolist())
    assert ends[0] == ends[1]
    batch.close()


def test_worlds_with_other_shapes_are_another_group(machine: UrdfModel) -> None:
    specs = [world_spec(machine, height=height) for height in (0.06, 0.1, 0.06)]
    starts = [Start({LOW: [0, 0, spec.bodies[LOW].shapes[0].size[2] / 2, 1]}) for spec in specs]
    batch = make(specs, starts)
    assert [len(group.qpos) for group in batch.groups] == [2, 1]  # type: ignore[attr-defined]
    advance(batch, 2, 13)
    assert batch.state.bodies[:, LOW, 2] == pytest.approx([0.03, 0.05, 0.03], abs=1e-4)
    assert (batch.seconds > 0.0).all()
    batch.close()


def test_graphs_do_what_single_launches_do(machine: UrdfModel, monkeypatch: pytest.MonkeyPatch) -> None:
    graphs, launches = (make([world_spec(machine)], [busy(0)]) for _ in range(2))
    advance(graphs, 6, 13)
    group = launches.groups[0]  # type: ignore[attr-defined]
    monkeypatch.setattr(group, "_run", group._launch)
    advance(launches, 6, 13)
    assert np.array_equal(everything(graphs), everything(launches))
    for batch in (graphs, launches):
        batch.close()


def test_room_for_contacts_grows(machine: UrdfModel, monkeypatch: pytest.MonkeyPatch) -> None:
    from raisim_like.engines.mujoco_warp import group

    usual = make([world_spec(machine)] * 2, [busy(0), busy(1)])
    advance(usual, 6, 13)
    monkeypatch.setattr(group, "CONTACTS", 2)
    narrow = make([world_spec(machine)] * 2, [busy(0), busy(1)])
    advance(narrow, 6, 13)
    assert narrow.groups[0].contacts > 2  # type: ignore[attr-defined]
    assert np.array_equal(everything(narrow), everything(usual))
    monkeypatch.setattr(group, "MOST_CONTACTS", 2)
    with pytest.raises(EngineError, match="a world has more than 2 contacts; use fewer collision parts"):
        advance(make([world_spec(machine)], [busy(0)]), 6, 13)
    for batch in (usual, narrow):
        batch.close()


def test_concave_meshes_are_refused_as_on_mujoco(machine: UrdfModel) -> None:
    spec = world_spec(machine)
    body = replace(spec.bodies[LOW], shapes=(Shape("mesh", file=Path("bowl.obj")),))
    with pytest.raises(EngineError, match=r"bowl\.obj: MuJoCo has no concave meshes"):
        make([replace(spec, bodies=(spec.bodies[GROUND], body, *spec.bodies[2:]))], [Start()])


def test_environments_of_the_hand_run_in_one_pool() -> None:
    """With the actions of the label's own pose, hand and object do what they do on MuJoCo."""
    seen = []
    for engine in ("warp", "mujoco"):
        pool = make_pool(make_spec(2, [f"engine={engine}", "env.grasp_steps=3"]))
        pool.reset(0, "test")
        for _ in range(6):
            step = pool.step(np.zeros((2, pool.action_size), np.float32))
        seen.append(step.observation.copy())
        pool.close()
    assert seen[0] == pytest.approx(seen[1], abs=2e-2) and np.isfinite(seen[0]).all()


def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("mujoco_warp", "warp"):
        with monkeypatch.context() as patch:
            patch.setitem(sys.modules, name, None)
            with pytest.raises(EngineError, match=r"needs the packages mujoco-warp and warp-lang.*'dgrasp\[warp\]'"):
                find_engine("warp")
