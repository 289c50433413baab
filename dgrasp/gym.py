"""The Gymnasium API: `gymnasium.make("dgrasp/Grasp-v0")` and `gymnasium.make_vec("dgrasp/Grasp-v0", num_envs=8)`.

Importing this module registers the ids. An environment has one grasp label. The vector environment has one label per
sub-environment and steps them together, in this process or in workers. docs/gymnasium.md shows a training.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode

from dgrasp.build import build_spec
from dgrasp.config.experiment import Config, find_config, load_config, make_config
from dgrasp.data import DataChoice, resolve
from dgrasp.errors import ConfigError
from dgrasp.pool import PoolSpec, make_pool
from dgrasp.pool.serial import SerialPool
from dgrasp.request import Asked, config_of, read_saved
from dgrasp.rl.run.folder import PRETRAINED
from dgrasp.types import Array, SceneState
from dgrasp.view.frames import state_picture
from dgrasp.view.meshes import DisplayMeshes, scene_meshes

if TYPE_CHECKING:
    from dgrasp.rl.networks import Policy

ENV_ID = "dgrasp/Grasp-v0"
OBSERVATION_BOUND = 1e4
"""Above every feature: the fastest are joint speeds (100 rad/s) and the object spins below 1000 rad/s."""
ACTION_SCALE = 4.0
"""Residual action of an action of 1. A trained policy's residual actions are around 1, and 99% of the shipped policy's
are below 4. Actions beyond the space are applied as they are. A power of two keeps the bits of a policy's actions."""


def _config(cfg: Config | str | Path | None, overrides: list[str] | None, kind: str) -> Config:
    if isinstance(cfg, Config):
        config = make_config(cfg.model_dump(), overrides=overrides or [], typed="overrides")
    else:
        config = load_config(None if cfg is None else find_config(Path(cfg)), overrides, "overrides")
    # Every sub-environment takes part in every episode, and all episodes have the same length.
    labels = config.labels.model_copy(update={"per_epoch": None, "doubles_every": None})
    values = config.model_copy(update={"labels": labels}).model_dump()
    return make_config(values, overrides=[f"pool.kind={kind}"], typed="pool")


def _spaces(observation_size: int, action_size: int) -> tuple[gymnasium.spaces.Box, gymnasium.spaces.Box]:
    observation = gymnasium.spaces.Box(-OBSERVATION_BOUND, OBSERVATION_BOUND, (observation_size,), np.float32)
    action = gymnasium.spaces.Box(-1.0, 1.0, (action_size,), np.float32)
    return observation, action


def _residual(action: Any, space: gymnasium.Space[Array]) -> Array:
    """The residual action as float32. Raises `ValueError` for a wrong shape, which NumPy might broadcast silently."""
    given = np.asarray(action, np.float32)
    if given.shape != space.shape:
        raise ValueError(f"actions of shape {given.shape}; expected {space.shape}")
    return given * np.float32(ACTION_SCALE)


def _spec(config: Config) -> tuple[PoolSpec, DataChoice]:
    choice = resolve(config)
    return build_spec(choice, config), choice


class GraspGymEnv(gymnasium.Env[Array, Array]):
    """One grasp label as a Gymnasium environment.

    cfg: a `Config`, a YAML file, or None for the defaults; overrides: laid over it, such as
    ["labels.objects=[004_sugar_box]"].
    label: index into the chosen labels. None leaves the choice to `reset`: its seed modulo the number of labels, so
    that the environments of Gymnasium's own vectors have different ones; without a seed the label stays, or, at first,
    is drawn. Observations are the feature layer's (float32), actions (D,), of task motion (6,), the residual over
    `ACTION_SCALE`. info: "object" and "label", their names; "inertia", the object's: "true", or "official", the
    authors' 1 kg m^2; "reward_terms", the weighted terms by name; where training episodes have a hold (`env.hold`),
    "is_success" at their end: whether the object was held until then.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 35}  # noqa: RUF012

    def __init__(
        self,
        cfg: Config | str | Path | None = None,
        overrides: list[str] | None = None,
        label: int | None = None,
        render_mode: str | None = None,
    ) -> None:
        self._all, self._choice = _spec(_config(cfg, overrides, "serial"))
        count = len(self._all.labels)
        if label is not None and not 0 <= label < count:
            raise ConfigError(f"label {label}: there are {count} labels, 0 to {count - 1}")
        self._fixed, self._drawn = label is not None, False
        self.render_mode = render_mode
        self._take(label or 0)
        self.observation_space, self.action_space = _spaces(self._pool.observation_size, self._pool.action_size)

    def _take(self, label: int) -> None:
        """Simulate a label."""
        self._label = label
        self._spec = replace(self._all, labels=[self._all.labels[label]])
        self._pool = SerialPool(self._spec)
        self._meshes: DisplayMeshes | None = None
        # The state of an ended episode is kept, so that it can still be rendered and measured.
        self._pool.env.restarts = False

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        super().reset(seed=seed)
        if not self._fixed and (seed is not None or not self._drawn):
            count = len(self._all.labels)
            label = int(self.np_random.integers(count)) if seed is None else seed % count
            if label != self._label:
                self._pool.close()
                self._take(label)
            self._drawn = True
        return self._pool.reset(int(self.np_random.integers(2**31)))[0].copy(), self._names()

    def _names(self) -> dict[str, Any]:
        label = self._spec.labels[0]
        return {"object": label.object_id, "label": label.name, "inertia": self._choice.inertia_of(label.object_id)}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        result = self._pool.step(_residual(action, self.action_space)[None])
        # What broke is already placed anew; its episode ends with the last sound observation.
        observation = (result.final_observation if result.broken[0] else result.observation)[0].copy()
        info = self._names()
        info["reward_terms"] = dict(zip(self._pool.reward_terms, result.reward_terms[0].tolist(), strict=True))
        terminated, truncated = bool(result.terminated[0]), bool(result.truncated[0])
        if self._pool.env.hold.exists and (terminated or truncated):
            info["is_success"] = truncated
        return observation, float(result.reward[0]), terminated, truncated, info

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
    """The first `num_envs` labels as a Gymnasium vector environment; the labels repeat where there are fewer.

    All of them take part in every episode: `labels.per_epoch` and `doubles_every` are for the learner of this package.
    Environments of the same label start with different noise. info holds what `GraspGymEnv` has, as arrays (N,), in
    "reward_terms" by name; "_is_success" says where "is_success" counts.

    autoreset_mode: SAME_STEP restarts ended episodes in the step that ends them, with "final_obs" in info. NEXT_STEP
    returns their last observation, and restarts them in the next step; that one passes over the given action, makes
    the new episode's first control step with a residual action of zeros, and returns what is seen after it.
    """

    metadata = {"autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012

    def __init__(
        self,
        num_envs: int = 1,
        cfg: Config | str | Path | None = None,
        overrides: list[str] | None = None,
        pool: str = "serial",
        autoreset_mode: AutoresetMode = AutoresetMode.SAME_STEP,
    ) -> None:
        if num_envs < 1:
            raise ConfigError(f"num_envs {num_envs}: expected 1 or more")
        if autoreset_mode not in (AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP):
            raise ConfigError(f"autoreset_mode {autoreset_mode}: expected AutoresetMode.SAME_STEP or NEXT_STEP")
        spec, choice = _spec(_config(cfg, overrides, pool))
        labels = [spec.labels[i % len(spec.labels)] for i in range(num_envs)]
        self._pool = make_pool(replace(spec, labels=labels))
        self._holds = spec.config.env.hold.first_step is not None
        objects = [label.object_id for label in labels]
        self._names = {"object": np.array(objects, dtype=object),
                       "label": np.array([label.name for label in labels], dtype=object),
                       "inertia": np.array([choice.inertia_of(name) for name in objects], dtype=object)}
        self.num_envs = num_envs
        self._mode, self._ended = autoreset_mode, np.zeros(num_envs, bool)
        self.metadata = {**self.metadata, "autoreset_mode": autoreset_mode}
        sizes = self._pool.observation_size, self._pool.action_size
        self.single_observation_space, self.single_action_space = _spaces(*sizes)
        self.observation_space = gymnasium.vector.utils.batch_space(self.single_observation_space, num_envs)
        self.action_space = gymnasium.vector.utils.batch_space(self.single_action_space, num_envs)
        self.render_mode = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        super().reset(seed=seed)
        self._ended[:] = False
        return self._pool.reset(int(self.np_random.integers(2**31))).copy(), dict(self._names)

    def step(self, actions: Array) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        residual = _residual(actions, self.action_space)
        # Of NEXT_STEP alone: these have ended before, and their new episodes begin with this step.
        begun = self._ended.copy()
        residual[begun] = 0.0
        result = self._pool.step(residual)
        reward = np.where(begun, 0.0, result.reward.astype(np.float64))
        terminated, truncated = result.terminated & ~begun, result.truncated & ~begun
        terms = {name: np.where(begun, 0.0, result.reward_terms[:, i])
                 for i, name in enumerate(self._pool.reward_terms)}
        info: dict[str, Any] = {**self._names, "reward_terms": terms}
        observation, ended = result.observation.copy(), terminated | truncated
        if ended.any():
            if self._holds:
                info |= {"is_success": truncated, "_is_success": ended}
            if self._mode is AutoresetMode.NEXT_STEP:
                observation[ended] = result.final_observation[ended]
            else:
                info |= {"final_obs": result.final_observation.copy(), "_final_obs": ended}
        if self._mode is AutoresetMode.NEXT_STEP:
            self._ended = ended
        return observation, reward, terminated, truncated, info

    def close_extras(self, **kwargs: Any) -> None:
        self._pool.close()


class GymPolicy:
    """A trained policy between observations and actions of these environments. config: what it was trained with."""

    def __init__(self, policy: Policy, config: Config) -> None:
        self._policy, self.config = policy, config

    def __call__(self, observation: Array) -> Array:
        """Actions (A,) or (N, A) float32 for observations (O,) or (N, O); a few may lie beyond the space."""
        rows = np.atleast_2d(np.asarray(observation, np.float32))
        actions = self._policy.act(rows) / np.float32(ACTION_SCALE)
        return actions if np.ndim(observation) == 2 else actions[0]


def load_policy(source: str | Path) -> GymPolicy:
    """A policy from a run directory (its last checkpoint), a checkpoint, a file of `dgrasp publish`, or "pretrained".

    `DataError` for a file that is none. Its `config` makes environments that show what it was trained on:
    `gymnasium.make(ENV_ID, cfg=policy.config)`.
    """
    path = Path(source)
    named = str(source) == PRETRAINED or path.is_dir()
    asked = Asked(run=path) if named else Asked(policy=path)
    file = asked.find_policy()
    assert file is not None
    saved = read_saved(file)
    return GymPolicy(saved.policy, config_of(asked, file, saved))


gymnasium.register(
    id=ENV_ID,
    entry_point="dgrasp.gym:GraspGymEnv",
    vector_entry_point="dgrasp.gym:GraspVectorEnv",
)
