"""Whether an evaluation can be compared with the paper's numbers, and if not, why."""

from __future__ import annotations

from typing import Any

from dgrasp.config.experiment import Config, make_config
from dgrasp.config.values import flat_keys
from dgrasp.data import DataChoice
from dgrasp.methods.method import Method

WINDOWS = (5.0, 3.87)
"""s. Windows of the stability test: the paper's text, and the authors' code, with which the tables were made."""
TARGETS = "easy"
"""The paper's targets of motions."""
_KEYS = ("physics.", "env.grasp_steps", "env.action.k")
_FREE = ("physics.concave", "physics.preset", "physics.official_compat")
"""Prefixes of the keys that must be the paper's, whose values are the defaults, and those among them that need not be:
they set how an engine simulates the paper's world, or are among the choice's differences."""


def differences(method: Method, config: Config, choice: DataChoice) -> list[str]:
    """What makes an evaluation incomparable with the paper's tables; empty if it is comparable.

    The differences are in the hand, the labels, what a policy was trained on, the window, the physics and the targets.
    """
    found = [*choice.differences, *method.differences(choice.stamp(), choice.labels.objects)]
    if config.eval.window_s not in WINDOWS:
        found.append(f"the window is {config.eval.window_s:g} s, not {' or '.join(f'{w:g}' for w in WINDOWS)} s")
    limit = config.labels.limit_per_object
    if limit is not None:
        found.append(f"labels were left out (labels.limit_per_object={limit})")
    there, here = (flat_keys(one.model_dump(mode="json")) for one in (make_config({}), config))
    found += [f"{key} is {here[key]}, not {there[key]}" for key in here
              if key.startswith(_KEYS) and key not in _FREE and here[key] != there[key]]
    if config.motion.targets not in (None, TARGETS):
        found.append(f"the targets are {config.motion.targets}, not {TARGETS}")
    return found


def data_stamp(method: Method, config: Config, choice: DataChoice) -> dict[str, Any]:
    """The record of the data for a result: `DataChoice.stamp()`, with the differences from the paper if there are any.

    not_comparable: the differences. comparable_with_paper: whether there is none. unseen_objects: objects that the
    method's training left out, if there are any.
    """
    found, unseen = differences(method, config, choice), method.unseen(choice.labels.objects)
    lists = {"not_comparable": found, "unseen_objects": unseen}
    return choice.stamp() | {"comparable_with_paper": not found} | {key: some for key, some in lists.items() if some}
