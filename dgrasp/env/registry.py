"""The environment of each task."""

from __future__ import annotations

from dgrasp.env.grasp_env import GraspEnv
from dgrasp.env.target_env import FlatEnv, MotionEnv

ENVS: dict[str, type[GraspEnv]] = {"grasp": GraspEnv, "flat": FlatEnv, "motion": MotionEnv}
"""The kind of environment, by `env.task` (`dgrasp.config.tasks`)."""
