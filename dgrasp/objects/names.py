"""Names of the objects: the 20 YCB objects of the paper and the numbers that label files use for them."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

from dgrasp.errors import DataError

YCB_NAMES: dict[int, str] = {
    1: "002_master_chef_can",
    2: "003_cracker_box",
    3: "004_sugar_box",
    4: "005_tomato_soup_can",
    5: "006_mustard_bottle",
    6: "007_tuna_fish_can",
    7: "008_pudding_box",
    8: "009_gelatin_box",
    9: "010_potted_meat_can",
    10: "011_banana",
    11: "019_pitcher_base",
    12: "021_bleach_cleanser",
    13: "024_bowl",
    14: "025_mug",
    15: "035_power_drill",
    16: "036_wood_block",
    17: "037_scissors",
    18: "040_large_marker",
    20: "052_extra_large_clamp",
    21: "061_foam_brick",
}
"""DexYCB's object ids. 19, the large clamp, is in none of its grasps."""
LARGE_CLAMP = "051_large_clamp"
_LARGE_CLAMP_WORDS = (LARGE_CLAMP, "051", "19", "large_clamp")


def nearest(word: str, choices: Iterable[str]) -> str:
    """`"; did you mean 'X'?"` for the choice nearest to `word`, or an empty text if nothing is near."""
    options = list(choices)
    parts = {part: option for option in options for part in (option.partition("_")[2], option) if part}
    close = difflib.get_close_matches(word.lower(), list(parts), n=1, cutoff=0.5)
    return f"; did you mean {parts[close[0]]!r}?" if close else ""


def resolve_object(name: str | int) -> str:
    """The full name of an object given as "004_sugar_box", by its number "004", or by its DexYCB id 3.

    Text of three digits is the YCB number and shorter digits are the DexYCB id: "003" is the cracker box,
    "3" and 3 are the sugar box. Raises a `DataError` for an unknown object, which names the nearest one.
    """
    text = str(name).strip()
    if text in YCB_NAMES.values():
        return text
    if text in _LARGE_CLAMP_WORDS:
        raise DataError(f"unknown object {text!r}: {LARGE_CLAMP} is object 19 of DexYCB, which has no grasps of it, "
                        f"and none of the 20 objects of the paper ({', '.join(YCB_NAMES.values())}); choose one of "
                        f"these, or add its mesh with `dgrasp object add MESH --name {LARGE_CLAMP}` and make labels")
    if text.isascii() and text.isdigit():
        if len(text) == 3:
            for full in YCB_NAMES.values():
                if full.startswith(f"{text}_"):
                    return full
        elif len(text) < 3 and int(text) in YCB_NAMES:
            return YCB_NAMES[int(text)]
        ids = ", ".join(f"{number}" for number in YCB_NAMES)
        numbers = ", ".join(full[:3] for full in YCB_NAMES.values())
        raise DataError(f"unknown object {text!r}; expected a YCB number ({numbers}), a DexYCB id ({ids}) or a name")
    close = nearest(text, YCB_NAMES.values())
    raise DataError(f"unknown object {text!r}{close or '; known: ' + ', '.join(YCB_NAMES.values())}")
