"""What is asked for, by typed values, and the evaluation that it makes."""

from __future__ import annotations

import argparse
import re
import shlex
from collections.abc import Sequence
from pathlib import Path

import pytest
import torch

from dgrasp.commands.test import add_arguments, asked_by
from dgrasp.config.experiment import load_config
from dgrasp.errors import ConfigError, DataError
from dgrasp.methods import FlatRl, PdBaseline, PolicyMethod, StaticGrasp
from dgrasp.request import PRETRAINED, Asked, Request, config_of, make_request
from dgrasp.rl.networks import ActorCritic
from dgrasp.rl.run.checkpoint import Checkpoint, save
from dgrasp.tables.fill import _command
from raisim_like.engines import default_engine
from tests.imports import ROOT, modules, within

SHORT = ["data=free", "labels.objects=[004_sugar_box]", "labels.limit_per_object=1"]


def parsed(words: Sequence[str]) -> Asked:
    """What a command line of test.py asks for."""
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    return asked_by(parser.parse_intermixed_args(list(words)))


def trained(run_dir: Path, *overrides: str) -> Path:
    """A run directory with one checkpoint."""
    config = load_config(None, [*SHORT, *overrides])
    model = ActorCritic(4, 51, [4], 1.0, torch.Generator().manual_seed(0))
    made = Checkpoint(1, model.state_dict(), {}, 1e-3, model.architecture(), config.model_dump(mode="json"), {}, "0",
                      None)  # fmt: skip
    file = save(run_dir, made)
    (run_dir / "config.yaml").write_text("seed: 9\ndata: free\n")
    return file


def test_a_baseline_alone_takes_the_papers_config_and_the_best_physics() -> None:
    request = make_request(Asked("gt_pd", overrides=SHORT))
    assert isinstance(request, Request) and isinstance(request.method, PdBaseline)
    assert request.config.name == "dexycb" and request.config.physics.preset == "faithful"
    assert request.config.motion.targets is None and len(request.choice.labels.labels) == 1


def test_overrides_stand_above_values_and_values_above_the_config(tmp_path: Path) -> None:
    cfg = tmp_path / "a.yaml"
    cfg.write_text("seed: 4\nengine: mujoco\nphysics: {preset: fast}\neval: {window_s: 2.0}\n")
    values = {"engine": "pybullet", "eval.window_s": 3.5, "labels.objects": ["004_sugar_box"]}
    config = config_of(Asked("gt_pd", cfg=cfg, values=values, overrides=["eval.window_s=1.5", "physics.friction=0.5"]))
    assert (config.seed, config.engine, config.eval.window_s) == (4, "pybullet", 1.5)
    assert config.labels.objects == ["004_sugar_box"]
    assert (config.physics.preset, config.physics.friction) == ("faithful", 0.5)
    assert config_of(Asked("gt_pd", cfg=cfg, overrides=["physics.preset=fast"])).physics.preset == "fast"


def test_an_engine_of_many_worlds_is_not_bound_to_the_pool_of_a_config(tmp_path: Path) -> None:
    cfg = tmp_path / "a.yaml"
    cfg.write_text("engine: mujoco\npool: {kind: process}\n")
    assert config_of(Asked("gt_pd", cfg=cfg, values={"engine": "warp"})).pool.kind == "auto"
    assert config_of(Asked("gt_pd", cfg=cfg)).pool.kind == "process"
    typed = Asked("gt_pd", cfg=cfg, values={"engine": "warp"}, overrides=["pool.kind=process"])
    assert config_of(typed).pool.kind == "process"


def test_a_policy_brings_its_own_config_and_a_run_has_one(tmp_path: Path) -> None:
    file = trained(tmp_path / "run", "seed=3", "engine=mujoco", "physics.preset=fast")
    by_file = make_request(Asked(policy=file))
    assert isinstance(by_file.method, PolicyMethod) and by_file.method.name == "policy"
    assert (by_file.config.seed, by_file.config.engine, by_file.config.physics.preset) == (3, "mujoco", "faithful")
    by_run = make_request(Asked(run=tmp_path / "run", overrides=SHORT))
    assert by_run.config.seed == 9 and by_run.config.engine == default_engine()
    with pytest.raises(ConfigError, match=r"was trained with env\.goal_space=True"):
        make_request(Asked(policy=file, overrides=["env.goal_space=false"]))
    held = make_request(Asked("static_grasp", policy=file))
    assert isinstance(held.method, StaticGrasp) and isinstance(held.method.grasp, PolicyMethod)


def test_the_policy_that_ships_is_a_run_of_a_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    request = make_request(Asked(run=Path(PRETRAINED), overrides=SHORT))
    # The engine is not the one that it was trained on but this program's.
    assert request.config.engine == default_engine() and request.config.env.scaled_features
    # It was trained with the authors' inertia, which the free set does not have.
    assert request.config.physics.official_compat is None and request.choice.inertia == "true"
    named = make_request(Asked(run=Path(PRETRAINED), overrides=[*SHORT, "physics.official_compat=true"]))
    assert named.choice.inertia == "official"
    # The file that it is says the same, and so does any published policy.
    file = make_request(Asked(policy=ROOT / "data" / "free" / "policy" / "all_objects.safetensors", overrides=SHORT))
    assert file.config.physics.official_compat is None and file.choice.inertia == "true"
    # A folder of that name is a run like any other.
    (tmp_path / PRETRAINED).mkdir()
    with pytest.raises(DataError, match="no checkpoint there"):
        make_request(Asked(run=Path(PRETRAINED), overrides=SHORT))


def test_a_method_that_always_moves_goes_to_the_usual_targets(tmp_path: Path) -> None:
    assert make_request(Asked("static_grasp", overrides=SHORT)).config.motion.targets == "near"
    named = make_request(Asked("static_grasp", values={"motion.targets": "ood"}, overrides=SHORT))
    assert named.config.motion.targets == "ood"
    flat = make_request(Asked("flat_rl", policy=trained(tmp_path / "run", "env.task=flat")))
    assert isinstance(flat.method, FlatRl) and flat.config.motion.targets == "near"


def test_what_does_not_go_together_is_refused_before_a_file_is_read(tmp_path: Path) -> None:
    nowhere = tmp_path / "none.pt"
    for asked in (Asked(), Asked("gt_pd", policy=nowhere), Asked("gt_ik", run=tmp_path / "none")):
        with pytest.raises(ConfigError, match="what to test: expected one of --baseline, --run and --policy"):
            make_request(asked)
    with pytest.raises(ConfigError, match="flat_rl needs a policy trained for it"):
        make_request(Asked("flat_rl"))
    with pytest.raises(DataError, match=re.escape(str(nowhere))):
        make_request(Asked(policy=nowhere))
    file = trained(tmp_path / "run")
    with pytest.raises(ConfigError, match=f"^{re.escape(str(tmp_path / 'run'))}: not a policy of flat_rl but one of "
                                          "task grasp"):
        make_request(Asked("flat_rl", run=tmp_path / "run"))
    with pytest.raises(ConfigError, match=r"policy is for task grasp, but the config has env\.task=flat"):
        make_request(Asked(policy=file, cfg=Path("cfg/flat_rl.yaml"), overrides=SHORT))


def test_a_command_line_is_values_and_overrides() -> None:
    words = ["--run", "runs/a", "--baseline", "static_grasp", "--cfg", "c.yaml", "--data", "free", "--split", "test",
             "--labels", "dexycb", "--engine", "mujoco", "--window", "3.87", "--motion", "ood", "--objects", "004",
             "010", "seed=5"]  # fmt: skip
    asked = parsed([*words, "pool.workers=2"])
    assert (asked.baseline, asked.run, asked.policy, asked.cfg) == ("static_grasp", Path("runs/a"), None,
                                                                    Path("c.yaml"))  # fmt: skip
    assert asked.values == {
        "data": "free", "labels.split": "test", "labels.source": "dexycb", "labels.objects": ["004", "010"],
        "engine": "mujoco", "eval.window_s": 3.87, "motion.targets": "ood",
    }  # fmt: skip
    # argparse takes both for objects; what holds an equals sign is none.
    assert asked.overrides == ["seed=5", "pool.workers=2"]
    assert parsed(["--baseline", "gt_pd"]) == Asked("gt_pd", overrides=[])


def test_the_command_that_a_table_shows_asks_for_the_same() -> None:
    many = [
        Asked("gt_pd", cfg=Path("cfg/fast.yaml"), overrides=["data=free", "labels.objects=[a, b]"]),
        Asked(run=Path("runs/with a space"), overrides=[]),
        Asked("learned_motion", run=Path("r"), overrides=['motion.policy="a b.pt"'], values={"motion.targets": "near"}),
        Asked("static_grasp", policy=Path("p.pt"), overrides=["seed=2"], values={"motion.targets": "easy"}),
    ]
    for asked in many:
        words = shlex.split(_command(asked))
        assert words[:2] == ["python", "test.py"] and parsed(words[2:]) == asked
    assert _command(many[2]) == ("python test.py --run r --baseline learned_motion 'motion.policy=\"a b.pt\"' "
                                 "--motion near")


def test_the_library_knows_no_command_line() -> None:
    library = {"dgrasp/request.py", "dgrasp/training.py", "dgrasp/evaluation.py"}
    found = {path: names for path, names in modules("dgrasp") if path in library or path.startswith("dgrasp/tables/")}
    assert len(found) > len(library)
    assert not any(within(name, "argparse", "dgrasp.commands") for names in found.values() for name in names)
