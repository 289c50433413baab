"""Try grasps in physics: whether a hand that keeps the label's pose holds the object."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np

from dgrasp.config.experiment import Config
from dgrasp.env.grasp_env import GraspEnv
from dgrasp.eval.metrics import has_fallen
from dgrasp.hand.model import HandModel
from dgrasp.objects.model import ObjectModel
from dgrasp.types import Array, GraspLabel
from raisim_like.registry import in_parts

AT_ONCE = 576
"""Largest number of worlds at once on any engine, to limit memory."""


def gt_pd_holds(
    labels: list[GraspLabel], hand: HandModel, model: ObjectModel, config: Config,
    report: Callable[[float], None] = lambda share: None,
) -> Array:
    """(N,) bool: whether the baseline gt_pd succeeds, that is, the object stays in the hand for the test's window.

    report: called with the share that is done.
    """
    parts = in_parts(len(labels), config.engine, AT_ONCE)
    steps = len(parts) * config.window_steps
    made = itertools.count(1)
    return np.concatenate([
        _some_hold(labels[part], hand, model, config, lambda: report(next(made) / steps)) for part in parts
    ])  # fmt: skip


def _some_hold(
    labels: list[GraspLabel], hand: HandModel, model: ObjectModel, config: Config, stepped: Callable[[], None]
) -> Array:
    env = GraspEnv(labels, hand, {model.name: model}, config)
    env.reset(mode="label")
    still = np.zeros((len(labels), hand.layout.n_dof))

    def actions() -> Array:
        stepped()
        return still

    holds = outlasts_window(env, actions)
    env.close()
    return holds


def outlasts_window(env: GraspEnv, actions: Callable[[], Array]) -> Array:
    """(N,) bool: success of the test (`eval.metrics.success`), from the environments' current state without tables.

    actions: returns the actions (N, A) of each step. An environment that drops its object is not simulated further.
    """
    held = np.ones(env.num_envs, bool)
    for _ in range(env.config.window_steps):
        env.step(actions())
        fallen = has_fallen(env.s.table_contact, env.s.object_pos_W[:, 2])
        env.rest(fallen)
        held &= ~fallen
    # A broken simulation ends its episode early.
    return held & env.alive
