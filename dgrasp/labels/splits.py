"""Sets of objects by name: the paper's six splits into seen and unseen objects (supplement, "Generalization to Unseen
Objects").

Three objects are left out of training, and the policy is tested on all labels of these three.
"""

from __future__ import annotations

import re
from collections.abc import Collection

from dgrasp.errors import DataError
from dgrasp.objects.names import YCB_NAMES, resolve_object

UNSEEN: dict[int, tuple[str, str, str]] = {
    1: ("004_sugar_box", "005_tomato_soup_can", "006_mustard_bottle"),
    2: ("061_foam_brick", "010_potted_meat_can", "052_extra_large_clamp"),
    3: ("003_cracker_box", "007_tuna_fish_can", "011_banana"),
    4: ("002_master_chef_can", "036_wood_block", "052_extra_large_clamp"),
    5: ("008_pudding_box", "019_pitcher_base", "035_power_drill"),
    6: ("005_tomato_soup_can", "037_scissors", "040_large_marker"),
}
"""The paper's test sets by number."""

_SET = re.compile(r"(seen|unseen)_(\d+)")


def object_set(name: str) -> set[str] | None:
    """The objects of "unseen_1" to "unseen_6", or of "seen_1" to "seen_6", which are all others; None for other names.

    Raises `DataError` for a number that the paper does not have.
    """
    match = _SET.fullmatch(name)
    if match is None:
        return None
    if int(match[2][:3]) not in UNSEEN:
        raise DataError(f"no set of objects {name[:40]!r}; expected seen_1 to seen_{len(UNSEEN)} or unseen_1 to "
                        f"unseen_{len(UNSEEN)}, the paper's sets")
    left_out = set(UNSEEN[int(match[2][:3])])
    return left_out if match[1] == "unseen" else set(YCB_NAMES.values()) - left_out


def named_objects(names: Collection[str]) -> set[str]:
    """The objects that a list such as `labels.objects` names; names of other objects, such as added ones, stay."""
    found: set[str] = set()
    for name in names:
        try:
            found |= object_set(name) or {resolve_object(name)}
        except DataError:
            found.add(name)
    return found


def is_papers_split(trained: Collection[str], tested: Collection[str]) -> bool:
    """Whether a policy for the objects `trained` and a test on the objects `tested` are those of a set of the paper."""
    everything = set(YCB_NAMES.values())
    return any(set(trained) == everything - set(unseen) and set(tested) <= set(unseen) for unseen in UNSEEN.values())
