from __future__ import annotations

import pytest

from dgrasp.errors import DataError
from dgrasp.objects.names import YCB_NAMES, resolve_object


def test_twenty_objects_without_the_large_clamp() -> None:
    assert list(YCB_NAMES) == [*range(1, 19), 20, 21]
    assert len(set(YCB_NAMES.values())) == 20
    assert YCB_NAMES[12] == "021_bleach_cleanser"
    # DexYCB numbers the objects in the order of their YCB numbers.
    assert list(YCB_NAMES.values()) == sorted(YCB_NAMES.values())


@pytest.mark.parametrize(
    ("name", "full"),
    [("004_sugar_box", "004_sugar_box"), ("004", "004_sugar_box"), ("3", "004_sugar_box"), (3, "004_sugar_box"),
     ("003", "003_cracker_box"), ("21", "061_foam_brick"), ("021", "021_bleach_cleanser"), (" 025_mug ", "025_mug")],
)
def test_resolve(name: str | int, full: str) -> None:
    assert resolve_object(name) == full


@pytest.mark.parametrize(
    ("name", "hint"),
    [("sugar_box", "004_sugar_box"), ("004_suger_box", "004_sugar_box"), ("mugg", "025_mug"), ("Banana", "011_banana")],
)
def test_unknown_name_gets_the_nearest(name: str, hint: str) -> None:
    with pytest.raises(DataError, match=f"unknown object {name!r}; did you mean '{hint}'"):
        resolve_object(name)


@pytest.mark.parametrize("name", ["051_large_clamp", "051", "19", 19])
def test_the_large_clamp_has_no_grasps(name: str | int) -> None:
    with pytest.raises(DataError, match="051_large_clamp is object 19 of DexYCB, which has no grasps of it"):
        resolve_object(name)


@pytest.mark.parametrize("name", ["19", "0", "999", "051", "", "1234567890", "\u0663", "zzzz", -1])
def test_unknown_name_lists_what_is_known(name: str | int) -> None:
    with pytest.raises(DataError, match="061"):
        resolve_object(name)
