"""Resolve what an evaluation asks for (a baseline, a policy, a config) to the config, the method and the data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dgrasp.config.experiment import Config, find_config, make_config, read_values
from dgrasp.config.sections import SENSES
from dgrasp.config.values import apply_overrides, override
from dgrasp.data import DataChoice, resolve
from dgrasp.errors import ConfigError
from dgrasp.eval.motion import usual_set
from dgrasp.files.paths import data_root
from dgrasp.methods import METHODS, PolicyMethod, method_of
from dgrasp.methods.method import Method
from dgrasp.rl.run.folder import PRETRAINED, PRETRAINED_FILE, WEIGHTS_SUFFIX, latest
from dgrasp.rl.run.whole import check_policy_file
from raisim_like.registry import TOGETHER

if TYPE_CHECKING:
    from dgrasp.rl.run.policies import SavedPolicy



@dataclass(frozen=True)
class Request:
    """An evaluation of a method, with a config, on the chosen labels."""

    config: Config
    method: Method
    choice: DataChoice


@dataclass(frozen=True)
class Asked:
    """The user's specification of an evaluation.

    baseline: a name in `dgrasp.methods.BASELINES`; None tests the policy itself. policy: the file of a policy. run: a
    training run, whose last checkpoint is taken, or `PRETRAINED`. cfg: a config that replaces the run's, the policy's
    or the paper's. values: config values by dotted key. overrides: `key=value` strings, applied after the values.
    """

    baseline: str | None = None
    policy: Path | None = None
    run: Path | None = None
    cfg: Path | None = None
    values: Mapping[str, Any] = field(default_factory=dict)
    overrides: Sequence[str] = ()

    @property
    def given(self) -> bool:
        """Whether a saved policy is specified."""
        return self.run is not None or self.policy is not None

    @property
    def shipped(self) -> bool:
        """Whether the shipped policy is specified: `run` is `PRETRAINED` and there is no directory of that name."""
        return self.run is not None and str(self.run) == PRETRAINED and not self.run.exists()

    @property
    def run_dir(self) -> Path | None:
        """The run directory, if one is specified."""
        return None if self.shipped else self.run

    def find_policy(self) -> Path | None:
        """The file of the policy, if one is specified; `ConfigError` or `DataError` if a run has no such file."""
        if self.run_dir is not None:
            return latest(self.run_dir)
        if not self.shipped:
            return self.policy
        file = data_root() / PRETRAINED_FILE
        if not file.is_file():
            raise ConfigError(f"--run {PRETRAINED}: {file} is not there; expected a run directory, or a file for "
                              "--policy")
        return file


def make_request(asked: Asked) -> Request:
    """The evaluation that `asked` specifies, with its data found. Raises what `method_and_config` and `resolve` raise.

    A method that always moves objects gets the data's usual targets if the config names none.
    """
    method, config = method_and_config(asked)
    choice = resolve(config)
    if method.motion == "always" and config.motion.targets is None:
        config = config.model_copy(update={"motion": config.motion.model_copy(update={"targets": usual_set(choice)})})
    return Request(config, method, choice)


def method_and_config(asked: Asked) -> tuple[Method, Config]:
    """The method and the config that `asked` specifies, before any data is looked for.

    `ConfigError` if no method or more than one is named, if the method cannot take the policy, or if the config has
    another task or other inputs and outputs (`SENSES`) than the policy.
    """
    kind = METHODS[asked.baseline or PolicyMethod.name]
    kind.check_policy(asked.given)
    path = asked.find_policy()
    if asked.cfg is not None or asked.run_dir is not None:
        # What is wrong there shows before the policy is read, which takes seconds.
        config_of(asked)
    saved = None if path is None else read_saved(path)
    method = kind.make(None if saved is None else method_of(saved), str(asked.run or asked.policy))
    config = config_of(asked, path, saved)
    method.check(config)
    return method, config


def read_saved(path: Path) -> SavedPolicy:
    """Read a saved policy. Missing and damaged files are refused before torch, which takes seconds, is loaded."""
    check_policy_file(path)

    from dgrasp.rl.run.policies import read_policy

    return read_policy(path)


def config_of(asked: Asked, path: Path | None = None, saved: SavedPolicy | None = None) -> Config:
    """The config of an evaluation: `cfg`, or the run's, the policy's or the paper's, with values and overrides applied.

    path, saved: the file of the tested policy, and its content.
    """
    where, values = _base(asked, path, saved)
    given = [override(key, value) for key, value in asked.values.items()]
    # A run may train with faster physics; a test uses the most accurate preset.
    own = ["physics.preset=faithful"]
    if asked.values.get("engine") in TOGETHER:
        # The run's pool would divide the worlds that this engine advances together.
        own.append("pool.kind=auto")
    config = make_config(apply_overrides(values, own), where, [*given, *asked.overrides])
    if path is not None and saved is not None:
        _check_senses(saved, config, path)
    return config


def _base(asked: Asked, path: Path | None, saved: SavedPolicy | None) -> tuple[str, dict[str, Any]]:
    """The source of the config, for errors, and its values before any override."""
    cfg = find_config(asked.cfg)
    if cfg is None and asked.run_dir is not None:
        cfg = asked.run_dir / "config.yaml"
        if not cfg.is_file():
            raise ConfigError(f"{asked.run}: not a run directory (no config.yaml); expected one that train.py made")
    if cfg is None and path is not None and saved is not None and saved.config:
        return str(path), published_values(saved) if path.suffix == WEIGHTS_SUFFIX else saved.config
    cfg = cfg or find_config(Path("cfg/dexycb.yaml"))
    assert cfg is not None
    return str(cfg), read_values(cfg)


def published_values(saved: SavedPolicy) -> dict[str, Any]:
    """A published policy's config for a test: its own, but without its engine and inertia, which the test chooses.

    The engine of its training may not be installed here. The shipped policy was trained with the authors' inertia.
    """
    values = {key: value for key, value in saved.config.items() if key != "engine"}
    physics = {key: value for key, value in values.get("physics", {}).items() if key != "official_compat"}
    return values | {"physics": physics}


def _check_senses(saved: SavedPolicy, config: Config, path: Path) -> None:
    """`ConfigError` if inputs or outputs differ from those in training, which array sizes alone would not reveal."""
    trained = make_config({"env": saved.env}, str(path)).env
    differ = [key for key in SENSES if getattr(trained, key) != getattr(config.env, key)]
    if differ:
        own = ", ".join(f"env.{key}={getattr(trained, key)}" for key in differ)
        raise ConfigError(f"{path} was trained with {own}, but the config has other values; leave out --cfg and these "
                          "keys: a policy comes with its own")
