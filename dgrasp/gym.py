"""The Gymnasium API: `gymnasium.make("dgrasp/Grasp-v0")` and `gymnasium.make_vec("dgrasp/Grasp-v0", num_envs=8)`.

Importing this module registers the id. An environment has one grasp label. The vector environment has one label per
sub-environment and steps them together, in this process or in workers.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode

from dgrasp.build import build_spec
from dgrasp.config.experiment import Config, find_config, load_config, make_config
from dgrasp.config.values import apply_overrides
from dgrasp.data import resolve
from dgrasp.errors import ConfigError
from dgrasp.pool import PoolSpec, make_pool
from dgrasp.pool.serial import SerialPool
from dgrasp.types import Array, SceneState
from dgrasp.view.frames import state_picture
from dgrasp.view.meshes import DisplayMeshes, scene_meshes

ENV_ID = "dgrasp/Grasp-v0"
OBSERVATION_BOUND = 1e4
"""Larger than every feature: joint speeds reach 100 rad/s, and the object spins slower than 1000 rad/s."""
ACTION_BOUND = 100.0
"""Larger than every action: residual actions are dimensionless and about 1; those of a published policy reach tens."""


def _config(cfg: Config | str | Path | None, overrides: list[str] | None, kind: str) -> Config:
    if isinstance(cfg, Config):
        given = overrides or []
        config = make_config(apply_overrides(cfg.model_dump(), given), overrides=given, typed="overrides")
    else:
        config = load_config(None if cfg is None else find_config(Path(cfg)), overrides, "overrides")
    # Every sub-environment takes part in every episode, and all episodes have the same length.
    labels = config.labels.model_copy(update={"per_epoch": None, "doubles_every": None})
    values = config.model_copy(update={"labels": labels}).model_dump()
    return make_config(apply_overrides(values, [f"pool.kind={kind}"]))


def _spaces(observation_size: int, action_size: int) -> tuple[gymnasium.spaces.Box, gymnasium.spaces.Box]:
    observation = gymnasium.spaces.Box(-OBSERVATION_BOUND, OBSERVATION_BOUND, (observation_size,), np.float32)
    action = gymnasium.spaces.Box(-ACTION_BOUND, ACTION_BOUND, (action_size,), np.float32)
    return observation, action


def _checked(action: Any, space: gymnasium.Space[Array]) -> Array:
    """The action as float32. Raises `ValueError` for a wrong shape, which NumPy might otherwise broadcast silently."""
    given = np.asarray(action, np.float32)
    if given.shape != space.shape:
        raise ValueError(f"actions of shape {given.shape}; expected {space.shape}")
    return given


def _spec(config: Config) -> PoolSpec:
    return build_spec(resolve(config), config)


class GraspGymEnv(gymnasium.Env[Array, Array]):
    """One grasp label as a Gymnasium environment.

    cfg: a `Config`, a YAML file, or None for the defaults.
    overrides: config keys that replace those of cfg, such as ["labels.objects=[004_sugar_box]"].
    label: index into the chosen labels.
    Observations are the features (float32). Actions are the residuals (D,), or (6,) for task motion, dimensionless.
    `info["reward_terms"]` holds the weighted reward terms by name.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 35}  # noqa: RUF012

    def __init__(
        self,
        cfg: Config | str | Path | None = None,
        overrides: list[str] | None = None,
        label: int = 0,
        render_mode: str | None = None,
    ) -> None:
        spec = _spec(_config(cfg, overrides, "serial"))
        if not 0 <= label < len(spec.labels):
            raise ConfigError(f"label {label}: there are {len(spec.labels)} labels, 0 to {len(spec.labels) - 1}")
        self._spec = replace(spec, labels=[spec.labels[label]])
        self.render_mode = render_mode
        self._pool = SerialPool(self._spec)
        # The state of an ended episode is kept, so that it can still be rendered and measured.
        self._pool.env.restarts = False
        self.observation_space, self.action_space = _spaces(self._pool.observation_size, self._pool.action_size)
        self._episode = 0
        self._meshes: DisplayMeshes | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        super().reset(seed=seed)
        self._episode = int(self.np_random.integers(2**31))
        return self._pool.reset(self._episode)[0].copy(), {}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        result = self._pool.step(_checked(action, self.action_space)[None])
        # A broken simulation has already been reset; its episode ends with the last valid observation.
        observation = (result.final_observation if result.broken[0] else result.observation)[0].copy()
        terms = dict(zip(self._pool.reward_terms, result.reward_terms[0].tolist(), strict=True))
        return (
            observation, float(result.reward[0]), bool(result.terminated[0]), bool(result.truncated[0]),
            {"reward_terms": terms},
        )  # fmt: skip

    @property
    def state(self) -> SceneState:
        """The physical state behind the observation, one row."""
        return self._pool.state

    def render(self) -> Array | None:
        if self.render_mode is None:
            return None
        if self._meshes is None:
            self._meshes = scene_meshes(self._spec.hand, self._spec.objects[self._spec.labels[0].object_id])
        return state_picture(self._pool.state, 0, self._spec, self._meshes)

    def close(self) -> None:
        self._pool.close()


class GraspVectorEnv(gymnasium.vector.VectorEnv[Array, Array, Array]):
    """The first `num_envs` labels as a Gymnasium vector environment; ended episodes restart in the same step.

    All labels take part in every episode: `labels.per_epoch` and `doubles_every`, meant for this package's trainer, are
    ignored.
    """

    metadata = {"autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012

    def __init__(
        self,
        num_envs: int = 1,
        cfg: Config | str | Path | None = None,
        overrides: list[str] | None = None,
        pool: str = "serial",
    ) -> None:
        spec = _spec(_config(cfg, overrides, pool))
        if not 1 <= num_envs <= len(spec.labels):
            raise ConfigError(f"num_envs {num_envs}: there is one environment per label, 1 to {len(spec.labels)}")
        self._pool = make_pool(replace(spec, labels=spec.labels[:num_envs]))
        self.num_envs = num_envs
        sizes = self._pool.observation_size, self._pool.action_size
        self.single_observation_space, self.single_action_space = _spaces(*sizes)
        self.observation_space = gymnasium.vector.utils.batch_space(self.single_observation_space, num_envs)
        self.action_space = gymnasium.vector.utils.batch_space(self.single_action_space, num_envs)
        self.render_mode = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        super().reset(seed=seed)
        return self._pool.reset(int(self.np_random.integers(2**31))).copy(), {}

    def step(self, actions: Array) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        result = self._pool.step(_checked(actions, self.action_space))
        info: dict[str, Any] = {
            f"reward_{name}": result.reward_terms[:, i].copy() for i, name in enumerate(self._pool.reward_terms)
        }
        ended = result.terminated | result.truncated
        if ended.any():
            info["final_obs"] = result.final_observation.copy()
            info["_final_obs"] = ended.copy()
        return (
            result.observation.copy(), result.reward.astype(np.float64), result.terminated.copy(),
            result.truncated.copy(), info,
        )  # fmt: skip

    def close_extras(self, **kwargs: Any) -> None:
        self._pool.close()


gymnasium.register(
    id=ENV_ID,
    entry_point="dgrasp.gym:GraspGymEnv",
    vector_entry_point="dgrasp.gym:GraspVectorEnv",
)
