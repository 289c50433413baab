"""The typed configuration of an experiment, read from YAML with dotted overrides.

Its sections are in `dgrasp.config.sections`; `cfg/` holds named experiments.
"""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import AfterValidator, BaseModel, Field, ValidationError, model_validator

from dgrasp.config.sections import (
    MAX_STEPS,
    CheckpointConfig,
    EnvConfig,
    EvalConfig,
    LabelsConfig,
    MotionConfig,
    PhysicsConfig,
    PoolConfig,
    PpoConfig,
    Section,
)
from dgrasp.config.tasks import TASKS
from dgrasp.config.values import apply_overrides, parse_yaml
from dgrasp.errors import ConfigError
from dgrasp.files.paths import cfg_root
from raisim_like.engines import default_engine
from raisim_like.registry import BATCHES, CONCAVE_MESHES


def _known_engine(name: str) -> str:
    if name not in BATCHES:
        raise ValueError(f"expected one of {', '.join(BATCHES)}")
    return name


class Config(Section):
    """One experiment.

    engine: default pybullet, or mujoco where PyBullet is not installed; warp needs the extra dgrasp[warp].
    objects: the folder of added objects (`dgrasp object add`) that labels name; null searches the data's objects/, then
    data/objects.
    """

    name: Annotated[str, Field(pattern=r"^[^/\\\x00]{1,100}$")] = "dexycb"
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1
    engine: Annotated[str, AfterValidator(_known_engine)] = Field(default_factory=default_engine)
    device: Literal["auto", "cpu", "cuda"] = "auto"
    data: str | None = None
    hand: str | None = None
    objects: str | None = None
    fallback: Literal["free", "error"] = "free"
    labels: LabelsConfig = LabelsConfig()
    physics: PhysicsConfig = PhysicsConfig()
    env: EnvConfig = EnvConfig()
    motion: MotionConfig = MotionConfig()
    ppo: PpoConfig = PpoConfig()
    pool: PoolConfig = PoolConfig()
    checkpoint: CheckpointConfig = CheckpointConfig()
    eval: EvalConfig = EvalConfig()

    @property
    def control_period(self) -> float:
        """Seconds per control step."""
        return self.physics.timestep * self.physics.substeps

    @property
    def window_steps(self) -> int:
        """Control steps of the stability test's window; at least 1."""
        return max(1, control_steps(self.eval.window_s, self.control_period))

    def episode_steps(self, epoch: int) -> int:
        """Control steps of a training episode in an epoch; epochs count from 1."""
        return self.env.episode_steps + self.env.lengthens_by * self.labels.doublings(epoch)

    def learned_steps(self, epoch: int) -> int:
        """Control steps of a training episode that the learner sees: without those of a grasp that is given."""
        return self.episode_steps(epoch) - (self.env.grasp_steps if TASKS[self.env.task].given_grasp else 0)

    def steps_in(self, epoch: int, environments: int) -> int:
        """Control steps of all environments together in a training epoch."""
        return self.learned_steps(epoch) * self.labels.in_epoch(epoch, environments)

    def last_epoch(self, environments: int, epoch: int = 0, steps: int = 0) -> int:
        """The last epoch that `ppo.epochs` and `ppo.max_steps` allow; at least 1.

        epoch, steps: how many epochs are complete already, and the control steps of all environments in them.
        """
        ppo = self.ppo
        if ppo.max_steps is None:
            return ppo.epochs
        while epoch < ppo.epochs and (steps := steps + self.steps_in(epoch + 1, environments)) <= ppo.max_steps:
            epoch += 1
        return min(ppo.epochs, max(1, epoch))

    @model_validator(mode="after")
    def _consistent(self) -> Config:
        if self.env.grasp_steps >= self.env.episode_steps:
            raise ValueError("env.grasp_steps must be below env.episode_steps")
        window = self.eval.window_s / self.control_period
        if window > MAX_STEPS:
            raise ValueError(f"eval.window_s: {self.eval.window_s:g} s are {window:.3g} control steps of "
                             f"{self.control_period:g} s; expected at most {MAX_STEPS}")
        hold = self.env.hold
        if hold.first_step is not None and not hold.first_step <= hold.last_step < self.env.episode_steps:
            raise ValueError("env.hold: expected first_step <= last_step < env.episode_steps")
        if hold.first_step is not None and TASKS[self.env.task].table_stays:
            raise ValueError(f"env.hold.first_step: the table stays in task {self.env.task}; expected null")
        if self.physics.concave == "mesh" and self.engine not in CONCAVE_MESHES:
            raise ValueError(f"physics.concave: {self.engine} does not support concave meshes; expected auto or parts, "
                             f"or the engine {' or '.join(CONCAVE_MESHES)}")
        if self.ppo.min_learning_rate > self.ppo.max_learning_rate:
            raise ValueError("ppo.min_learning_rate must not exceed ppo.max_learning_rate")
        return self


def control_steps(seconds: float, control_period: float) -> int:
    """Control steps in `seconds`, rounded to a whole number."""
    return round(seconds / control_period)


def config_keys(model: type[BaseModel] = Config, prefix: str = "") -> list[str]:
    """All dotted keys of the configuration."""
    keys = []
    for name, info in model.model_fields.items():
        annotation = info.annotation
        if isinstance(annotation, type) and issubclass(annotation, BaseModel):
            keys += config_keys(annotation, f"{prefix}{name}.")
        else:
            keys.append(f"{prefix}{name}")
    return keys


def _nearest(path: str) -> str:
    keys = config_keys()
    sections = sorted({key.rsplit(".", 1)[0] for key in keys if "." in key})
    candidates = keys + sections
    close = difflib.get_close_matches(path, candidates, n=1, cutoff=0.5)
    if not close:
        tail = path.rsplit(".", 1)[-1]
        close = [k for k in candidates if k.rsplit(".", 1)[-1] in difflib.get_close_matches(
            tail, [c.rsplit(".", 1)[-1] for c in candidates], n=1, cutoff=0.5)][:1]
    return f"; did you mean {close[0]!r}?" if close else ""


def make_config(
    values: dict[str, Any], where: str = "config", overrides: Sequence[str] = (), typed: str = "command line"
) -> Config:
    """The validated config of plain values with `key=value` overrides applied.

    where, typed: the sources of values and overrides. A `ConfigError` lists every problem at once, each with its path
    and under the source that causes it.
    """
    try:
        return Config.model_validate(apply_overrides(values, list(overrides)))
    except ValidationError as error:
        places: dict[str, list[str]] = {}
        keys = [item.partition("=")[0] for item in overrides]
        for issue in error.errors():
            path = ".".join(str(part) for part in issue["loc"])
            if issue["type"] == "extra_forbidden":
                line = f"{path}: unknown key{_nearest(path)}"
            else:
                got = "" if isinstance(issue.get("input"), (dict, Config)) else f" (got {issue.get('input')!r})"
                line = f"{path + ': ' if path else ''}{issue['msg'].removeprefix('Value error, ')}{got}"
            # A rule about several keys has no path. Overrides break it if the values alone keep it.
            by_hand = any(_is_at(key, path) for key in keys) if path else bool(keys) and _is_valid(values)
            places.setdefault(typed if by_hand else where, []).append(line)
        raise ConfigError("\n".join(f"{place}:\n  " + "\n  ".join(lines) for place, lines in places.items())) from None


def _is_valid(values: dict[str, Any]) -> bool:
    try:
        Config.model_validate(values)
    except ValidationError:
        return False
    return True


def _is_at(key: str, path: str) -> bool:
    """Whether a key is at a path, above it or below it."""
    return f"{key}.".startswith(f"{path}.") or f"{path}.".startswith(f"{key}.")


def read_values(path: Path) -> dict[str, Any]:
    """The plain values of a YAML config."""
    try:
        text = Path(path).read_text(encoding="utf-8")
    except OSError as error:
        folders = {path.parent, *([cfg_root()] if path.parent == Path("cfg") else [])}
        there = [file.name for folder in folders for file in folder.glob("*.yaml")]
        near = difflib.get_close_matches(path.name, there, 1)
        hint = f"; did you mean {str(path.parent / near[0])!r}?" if near else ""
        raise ConfigError(f"{path}: cannot read the config ({error.strerror}){hint}") from None
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: cannot read the config ({error})") from None
    values = parse_yaml(text, str(path))
    values = {} if values is None else values
    if not isinstance(values, dict):
        raise ConfigError(f"{path}: expected a mapping of config keys, got {type(values).__name__}")
    return values


def load_config(path: Path | None, overrides: list[str] | None = None, typed: str = "command line") -> Config:
    """The config of a YAML file (or the defaults) with overrides such as `["ppo.epochs=6", "seed=3"]`.

    typed: where the overrides are from, for errors.
    """
    values = {} if path is None else read_values(path)
    return make_config(values, str(path) if path else "config", overrides or [], typed)


def dump_config(config: Config) -> str:
    """The complete config as YAML, so that a run can be repeated."""
    return yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False)


def find_config(path: Path | None) -> Path | None:
    """Find a config file: if `cfg/NAME.yaml` does not exist, take the file of that name from the package."""
    if path is None or path.is_file() or path.parent != Path("cfg"):
        return path
    shipped = cfg_root() / path.name
    return shipped if shipped.is_file() else path
