"""Every test that asks for an engine runs on each; `indirect=True` chooses one."""

from __future__ import annotations

import pytest

from raisim_like.engines import ENGINES


@pytest.fixture(params=ENGINES)
def engine(request: pytest.FixtureRequest) -> str:
    """Name of a physics engine."""
    name: str = request.param
    pytest.importorskip(name)
    return name
