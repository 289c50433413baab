"""Marks of tests that need one engine."""

from __future__ import annotations

from importlib.util import find_spec

import pytest

needs_pybullet = pytest.mark.skipif(find_spec("pybullet") is None, reason="PyBullet is not installed")
