"""What is tested: from the names of a baseline, a policy and a config to the config, the method and the data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dgrasp.config.experiment import Config, find_config, make_config, read_values
from dgrasp.config.sections import SENSES
from dgrasp.config.values import apply_overrides, override
from dgrasp.data import DataChoice, resolve
from dgrasp.errors import ConfigError, DataError
from dgrasp.eval.motion import usual_set
from dgrasp.files.paths import data_root
from dgrasp.methods import METHODS, PolicyMethod, method_of
from dgrasp.methods.method import Method
from dgrasp.rl.run.folder import PRETRAINED, PRETRAINED_FILE, WEIGHTS_SUFFIX, latest

if TYPE_CHECKING:
    from dgrasp.rl.run.policies import SavedPolicy



@dataclass(frozen=True)
class Request:
    """An evaluation: of a method, with a config, on the chosen labels."""

    config: Config
    method: Method
    choice: DataChoice


@dataclass(frozen=True)
class Asked:
    """What an evaluation is asked for by.

    baseline: a name of `dgrasp.methods.BASELINES`; None tests the policy itself. policy: the file of a policy. run: a
    training run, whose last checkpoint is taken, or `PRETRAINED`. cfg: a config in place of the run's, the policy's or
    the paper's. values: config values by dotted key. overrides: `key=value`, laid over the values.
    """

    baseline: str | None = None
    policy: Path | None = None
    run: Path | None = None
    cfg: Path | None = None
    values: Mapping[str, Any] = field(default_factory=dict)
    overrides: Sequence[str] = ()

    @property
    def given(self) -> bool:
        """Whether a saved policy is asked for."""
        return self.run is not None or self.policy is not None

    @property
    def shipped(self) -> bool:
        """Whether the policy that ships is asked for."""
        return self.run is not None and str(self.run) == PRETRAINED and not self.run.exists()

    @property
    def run_dir(self) -> Path | None:
        """The run directory that is asked for."""
        return None if self.shipped else self.run

    def find_policy(self) -> Path | None:
        """The file of the policy that is asked for; `ConfigError` or `DataError` where it is not there."""
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
    """The evaluation that is asked for; a method that always moves objects moves them to the data's usual targets.

    `ConfigError` where no method is named, or two, for a policy that the method cannot take, and for a config of
    another task, or with other senses, than the policy's.
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
    choice = resolve(config)
    if method.motion == "always" and config.motion.targets is None:
        config = config.model_copy(update={"motion": config.motion.model_copy(update={"targets": usual_set(choice)})})
    return Request(config, method, choice)


def read_saved(path: Path) -> SavedPolicy:
    """A saved policy; torch, which takes seconds to import, is not for what can be refused without it."""
    if not path.is_file():
        raise DataError(f"{path}: no such file; expected a checkpoint (.pt) or published weights ({WEIGHTS_SUFFIX})")

    from dgrasp.rl.run.policies import read_policy

    return read_policy(path)


def config_of(asked: Asked, path: Path | None = None, saved: SavedPolicy | None = None) -> Config:
    """The config that is asked for: `cfg`, or the run's, the policy's or the paper's, with what is laid over it.

    path, saved: the file of the policy that is tested, and what it holds.
    """
    where, values = _base(asked, path, saved)
    given = [override(key, value) for key, value in asked.values.items()]
    # A run may train with faster physics; a test has the best there is.
    given += asked.overrides
    config = make_config(apply_overrides(values, ["physics.preset=faithful", *given]), where, given)
    if path is not None and saved is not None:
        _check_senses(saved, config, path)
    return config


def _base(asked: Asked, path: Path | None, saved: SavedPolicy | None) -> tuple[str, dict[str, Any]]:
    """What the overrides are laid over, and where it is from."""
    cfg = find_config(asked.cfg)
    if cfg is None and asked.run_dir is not None:
        cfg = asked.run_dir / "config.yaml"
        if not cfg.is_file():
            raise ConfigError(f"{asked.run}: not a run directory (no config.yaml); expected one that train.py made")
    if cfg is None and path is not None and saved is not None and saved.config:
        # The engine that a shared policy was trained on may not be installed here.
        told = ("engine",) if path.suffix == WEIGHTS_SUFFIX else ()
        return str(path), {key: value for key, value in saved.config.items() if key not in told}
    cfg = cfg or find_config(Path("cfg/dexycb.yaml"))
    assert cfg is not None
    return str(cfg), read_values(cfg)


def _check_senses(saved: SavedPolicy, config: Config, path: Path) -> None:
    """A policy must see and move what it did in training; other features may have the same number of entries."""
    trained = make_config({"env": saved.env}, str(path)).env
    differ = [key for key in SENSES if getattr(trained, key) != getattr(config.env, key)]
    if differ:
        own = ", ".join(f"env.{key}={getattr(trained, key)}" for key in differ)
        raise ConfigError(f"{path} was trained with {own}, and the config says otherwise; leave --cfg and these keys "
                          "away: a policy brings its own")
