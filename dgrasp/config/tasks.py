"""The tasks that a policy can be trained for: what `env.task` chooses in the environment, the config and the log."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Task:
    """One value of `env.task`. Its environment is registered under the same name in `dgrasp.env.registry`.

    features: layers that the actor sees, in this order, each feature once: names in `dgrasp.env.features.LAYERS`, or
    "env.features" for the layer that this key names. rewards: groups of reward terms, in this order: names in
    `dgrasp.env.rewards.GROUPS`. evaluated: values of the periodic evaluation that summarise it in the log, the most
    important first. table_stays: whether training episodes never lose their table (`env.hold`). given_grasp: whether
    a frozen policy makes the first `env.grasp_steps` control steps of a training episode, which the learner then does
    not see.
    """

    name: str
    features: tuple[str, ...]
    rewards: tuple[str, ...]
    evaluated: tuple[str, ...]
    table_stays: bool = False
    given_grasp: bool = False


_AT_TARGET = ("mpe_m", "geodesic_rad", "carried")

GRASP = Task("grasp", ("env.features",), ("grasp",), ("success", "contact_ratio"))
FLAT = Task("flat", ("env.features", "psi"), ("grasp", "target"), _AT_TARGET, table_stays=True)
MOTION = Task("motion", ("psi",), ("target",), _AT_TARGET, table_stays=True, given_grasp=True)

TASKS: dict[str, Task] = {task.name: task for task in (GRASP, MOTION, FLAT)}
"""All tasks, by name."""
