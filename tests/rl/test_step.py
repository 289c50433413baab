"""The arrays of a step: one declaration gives the layout of the memory and the rows that are written."""

from __future__ import annotations

from dataclasses import FrozenInstanceError, fields

import numpy as np
import pytest

from dgrasp.hand.free.hand import URDF_PATH
from dgrasp.hand.load import load_hand
from dgrasp.pool.serial import SerialPool
from dgrasp.pool.worker import Shared
from dgrasp.rl.step import Step
from tests.scenes import make_spec


def test_the_layout_has_every_array_and_no_other() -> None:
    layout = Step.layout(3, 5, 2)
    assert list(layout) == [field.name for field in fields(Step)]
    step = Step.allocate(3, 5, 2)
    assert {name: (array.shape, array.dtype) for name, array in vars(step).items()} == {
        "observation": ((3, 5), np.float32), "final_observation": ((3, 5), np.float32), "reward": ((3,), np.float32),
        "reward_terms": ((3, 2), np.float32), "terminated": ((3,), bool), "truncated": ((3,), bool),
        "broken": ((3,), bool),
    }  # fmt: skip
    assert not any(array.any() for array in vars(step).values())


def test_a_part_is_written_into_its_rows_alone() -> None:
    whole, part = Step.allocate(5, 4, 2), Step.allocate(2, 4, 2)
    for array in vars(part).values():
        array[:] = 1
    whole.write(slice(1, 5, 2), part)
    for array in vars(whole).values():
        assert array.reshape(5, -1).any(axis=1).tolist() == [False, True, False, True, False]


def test_the_arrays_of_a_step_cannot_be_exchanged() -> None:
    """The arrays may lie in shared memory, where other processes read them."""
    with pytest.raises(FrozenInstanceError):
        Step.allocate(1, 1, 1).reward = np.zeros(1)  # type: ignore[misc]


def test_shared_memory_holds_the_same_arrays_for_both_sides() -> None:
    layout = load_hand(URDF_PATH, "free").layout
    ours = Shared(2, layout, 5, 3, 4, workers=1)
    theirs = Shared(2, layout, 5, 3, 4, workers=1, name=ours.memory.name)
    try:
        expected = Step.layout(2, 5, 4)
        for k, (name, array) in enumerate(vars(theirs.out).items()):
            assert (array.shape, array.dtype) == expected[name] and array.flags.aligned
            array[:] = k
            assert np.array_equal(getattr(ours.out, name), array), name
    finally:
        ours.memory.unlink()


def test_a_pool_hands_out_what_the_environment_wrote() -> None:
    pool = SerialPool(make_spec(1, ["physics.substeps=2"]))
    pool.reset(0)
    assert pool.step(np.zeros((1, 51), np.float32)) is pool.env.o
    pool.close()
