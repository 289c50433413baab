"""Which synthesised grasps become labels, and how far grasps are apart."""

from __future__ import annotations

import numpy as np
import pytest

from dgrasp.synthesis.report import joint_distances
from dgrasp.synthesis.synthesiser import order_of_both
from tests.scenes import free_hand, make_label


@pytest.mark.parametrize(
    ("held", "count", "expected"),
    [
        ([1, 1, 1, 0, 0, 0, 0, 0, 0, 0], 5, [0, 1, 3, 4, 5]),  # two of five hold
        ([1, 1, 1, 1, 0], 4, [0, 1, 2, 4]),  # there is just one other
        ([0, 0, 0], 2, [0, 1]),
    ],
)
def test_some_that_hold_and_more_that_do_not(held: list[int], count: int, expected: list[int]) -> None:
    assert order_of_both(np.array(held, bool), count).tolist() == expected


def test_distances_between_grasps() -> None:
    hand = free_hand()
    one, other = make_label(hand, flexion=0.5), make_label(hand, flexion=0.8)
    # 0.3 rad in a third of the angles: 0.3 / sqrt(3).
    assert joint_distances([one, other])[0] == pytest.approx(np.degrees(0.3 / 3**0.5))
    moved = make_label(hand, index=1)
    assert joint_distances([one, moved]) == pytest.approx((0.0, 10.0))
    assert joint_distances([one]) == (0.0, 0.0)
