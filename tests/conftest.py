"""Every test that asks for an engine runs on each; `indirect=True` chooses one. Long files come first."""

from __future__ import annotations

from pathlib import Path

import pytest

from raisim_like.engines import ENGINES
from raisim_like.registry import BATCHES

LONG = (
    "raisim_like/test_warp.py", "raisim_like/test_warp_batch.py", "pool/test_pools.py", "raisim_like/test_rest.py",
    "commands/test_runs.py", "labels/test_fuzz.py", "labels/test_fuzz_sources.py", "commands/test_grasp.py",
    "labels/test_synthesis.py", "commands/test_commands.py", "rl/test_pretrained.py", "tables/test_tables.py",
    "objects/test_release.py", "commands/test_surroundings.py", "commands/test_demo.py", "test_any_hand.py",
    "test_examples.py", "rl/test_runner.py", "objects/test_add.py",
)  # fmt: skip
"""Files of more than five seconds, longest first. Were one of them the last, the other workers would wait for it."""
_PLACES = {Path(__file__).parent / name: place for place, name in enumerate(LONG)}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Long files first; the others keep their order."""
    items.sort(key=lambda item: _PLACES.get(item.path, len(LONG)))


@pytest.fixture(params=BATCHES)
def any_engine(request: pytest.FixtureRequest) -> str:
    """Name of a physics engine, engines that only know batches included."""
    name: str = request.param
    pytest.importorskip({"warp": "mujoco_warp"}.get(name, name))
    return name


@pytest.fixture(params=ENGINES)
def engine(request: pytest.FixtureRequest) -> str:
    """Name of a physics engine of single worlds."""
    name: str = request.param
    pytest.importorskip(name)
    return name
