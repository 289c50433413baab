"""The worlds of an environment: what their batch says goes into the state, row by row."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pytest

from dgrasp.scene.scene import LOWERED_TOP, OBJECT, TABLE, TABLE_SIZE, TABLE_TOP
from dgrasp.scene.state import state_views
from dgrasp.scene.worlds import Worlds
from dgrasp.types import Array
from tests.scenes import LAYOUT, make_spec

KP = 500.0


@pytest.fixture
def worlds(engine: str) -> Iterator[Worlds]:
    spec = make_spec(2, [f"engine={engine}", "physics.substeps=2"])
    made = Worlds(spec.labels, spec.hand, spec.objects, spec.config, state_views(2, LAYOUT))
    for i, label in enumerate(spec.labels):
        assert label.start is not None
        made.place(i, label.start, TABLE_TOP, KP, carries=False)
    yield made
    made.close()


def say(worlds: Worlds, impulses: Array) -> None:
    """Let the batch report these impulses of the links (N, dof)."""

    def link_impulses(rows: Sequence[int], body: int, out: Array) -> None:
        assert body == OBJECT
        out[rows] = impulses[rows]

    worlds.batch.link_impulses = link_impulses  # type: ignore[method-assign]


def test_impulses_are_those_of_the_parts_of_the_worlds_that_advanced(worlds: Worlds) -> None:
    dof, links = worlds.hand.urdf.dof, worlds.hand.part_links
    first, second = 1.0 + np.arange(2.0 * dof).reshape(2, dof), 500.0 + np.arange(2.0 * dof).reshape(2, dof)
    targets = np.zeros((2, dof))
    say(worlds, first)
    worlds.advance([0, 1], targets, watch_table=False)
    assert worlds.s.contact_impulse.tolist() == first[:, links].tolist()
    say(worlds, second)
    worlds.advance([1], targets, watch_table=False)
    assert worlds.s.contact_impulse[0].tolist() == first[0, links].tolist()
    assert worlds.s.contact_impulse[1].tolist() == second[1, links].tolist()
    label = make_spec(2).labels[1]
    assert label.start is not None
    worlds.place(1, label.start, TABLE_TOP, KP, carries=False)
    worlds.advance([], targets, watch_table=True)
    assert worlds.s.contact_impulse[0].tolist() == first[0, links].tolist()
    assert not worlds.s.contact_impulse[1].any()


def test_the_state_is_written_in_place_from_the_batch(worlds: Worlds) -> None:
    s, state = worlds.s, worlds.batch.state
    assert state.gc is s.gc and state.gv is s.gv and state.bodies.shape == (2, 2, 13)
    before = s.gc.copy()
    targets = before + 0.1
    worlds.advance([1], targets, watch_table=False)
    assert np.array_equal(s.gc[0], before[0]) and (s.gc[1] != before[1]).all()
    worlds.derive(slice(None))
    assert s.object_pos_W.tolist() == state.bodies[:, OBJECT, :3].tolist()
    assert s.object_linvel_W.tolist() == state.bodies[:, OBJECT, 7:10].tolist()


def test_a_released_world_has_its_table_down_and_carries_the_object(worlds: Worlds) -> None:
    asked = []
    set_gains = worlds.batch.set_gains

    def record(rows: Sequence[int], kp: Array, kd: Array, feed_forward: Array) -> None:
        asked.append((list(rows), kp[0, :4].tolist(), feed_forward[0]))
        set_gains(rows, kp, kd, feed_forward)

    worlds.batch.set_gains = record  # type: ignore[method-assign]
    worlds.release(1, 123.0)
    tops = worlds.batch.state.bodies[:, TABLE, 2] + TABLE_SIZE[2] / 2
    assert tops.tolist() == [TABLE_TOP, LOWERED_TOP]
    ((rows, kp, force),) = asked
    assert rows == [1] and kp == [123.0, 123.0, 123.0, worlds.config.env.action.kp_rotation]
    lift = worlds.s.R_WH0[1] @ force[:3]
    weight = 9.81 * worlds.hand.carried_mass + 10.0 * worlds.s.object_mass[1]
    assert lift == pytest.approx([0.0, 0.0, weight]) and not force[3:].any()


def test_a_world_is_made_anew_and_keeps_its_seconds(worlds: Worlds) -> None:
    targets = worlds.s.gc.copy()
    targets[1] = np.nan
    with np.errstate(all="ignore"):
        worlds.advance([0, 1], targets, watch_table=True)
    assert worlds.exploded().tolist() == [False, True]
    seconds = worlds.seconds
    worlds.rebuild(1)
    label = make_spec(2).labels[1]
    assert label.start is not None
    worlds.place(1, label.start, TABLE_TOP, KP, carries=False)
    assert not worlds.exploded().any() and np.array_equal(worlds.seconds, seconds)
