"""The command line's own messages: unknown commands, options and keys."""

from __future__ import annotations

import pytest

from dgrasp.cli import _SHORT, COMMANDS, main, run_command
from dgrasp.config.experiment import load_config
from dgrasp.errors import ConfigError
from dgrasp.files.paths import cfg_root


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("tran", "unknown command 'tran'; did you mean 'train'?"),
        ("lables", "unknown command 'lables'; did you mean 'labels'?"),
        ("lables make", "unknown command 'lables'; did you mean 'labels make'?"),
        ("labels chek", "unknown command 'labels chek'; did you mean 'labels check'?"),
        ("labels import dexyc x", "unknown command 'labels import dexyc'; did you mean 'labels import dexycb'?"),
        ("hand", "hand: expected one of the commands hand build, hand report"),
        ("labels import", "expected one of the commands labels import dexycb, labels import ho3d, labels import mano"),
        ("nonsense", "unknown command 'nonsense'; expected one of train, test, demo"),
    ],
)
def test_an_unknown_command_names_the_nearest(words: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words.split()) == 2
    message = capsys.readouterr().err
    assert message.startswith("error: ") and said in message and message.count("\n") == 1


@pytest.mark.parametrize("group", ["hand", "object", "labels", "labels import"])
def test_a_group_says_what_its_commands_do(group: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*group.split(), "--help"]) == 0
    out = capsys.readouterr().out
    for command in COMMANDS:
        assert (f"  {command} " in out) == command.startswith(f"{group} ")
    assert _SHORT.keys() == {command for command in COMMANDS if " " in command}


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["train", "--foo"], "unrecognized arguments: --foo; dgrasp train --help"),
        (["train", "--cgf", "x"], "unrecognized arguments: --cgf; did you mean --cfg? dgrasp train --help"),
        (["test", "--cgf", "x"], "unrecognized arguments: --cgf; did you mean --cfg or --gif? dgrasp test --help"),
        (["test", "--engine", "x"], "argument --engine: invalid choice: 'x'"),
        (["hand", "report"], "the following arguments are required: HAND"),
    ],
)
def test_wrong_options_are_one_line(words: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(words)
    message = capsys.readouterr().err
    assert stop.value.code == 2 and message.startswith(f"error: {said}") and message.count("\n") == 1
    assert "--help lists the options" in message


def test_a_mistake_is_said_of_where_it_is(tmp_path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("ppo: {epoch: 3}\n")
    with pytest.raises(ConfigError) as caught:
        load_config(file, ["seed=-1", "ppo.gamma=0.9"])
    assert str(caught.value).splitlines() == [
        "command line:", "  seed: Input should be greater than or equal to 0 (got -1)",
        f"{file}:", "  ppo.epoch: unknown key; did you mean 'ppo.epochs'?",
    ]  # fmt: skip
    file.write_text("env: {grasp_steps: 50}\n")
    with pytest.raises(ConfigError, match=r"\Acommand line:\n  env.grasp_steps must be below"):
        load_config(file, ["env.episode_steps=10"])
    file.write_text("env: {grasp_steps: 50, episode_steps: 10}\n")
    with pytest.raises(ConfigError, match=r"mine.yaml:\n  env.grasp_steps must be below"):
        load_config(file, ["seed=3"])


@pytest.mark.parametrize(
    "words", [["env.hold.first_step=70"], ["physics.timestep=1e-12"], ["env.task=flat", "env.hold.first_step=40"]]
)
def test_a_rule_that_an_override_breaks_is_its_mistake(words: list[str]) -> None:
    """The rule's message may name other keys than the override's."""
    with pytest.raises(ConfigError, match=r"\Acommand line:\n  e"):
        load_config(cfg_root() / "dexycb.yaml", words)


def test_a_single_name_stands_for_a_list_of_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert load_config(None, ["labels.objects=004_sugar_box"]).labels.objects == ["004_sugar_box"]
    with pytest.raises(ConfigError, match=r"labels.objects: expected names .* numbers in quotes: \['004'\] \(got 4\)"):
        load_config(None, ["labels.objects=4"])
    assert run_command("test", ["--baseline", "gt_pd", "labels.objects=999_none"]) == 2
    assert "999_none" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "labels", "epochs", "steps"),
    [
        # 195 control steps in each of 10,000 epochs, of each of the 376 labels.
        ([], "376", "10,000", "733,200,000"),
        (["labels.limit_per_object=1", "ppo.epochs=3", "env.episode_steps=100"], "20", "3", "6,000"),
    ],
)
def test_a_training_needs_a_config(
    words: list[str], labels: str, epochs: str, steps: str, tmp_path, monkeypatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run_command("train", ["--data", "free", "engine=mujoco", "pool.workers=2", *words]) == 2
    message = capsys.readouterr().err
    assert f"on {labels} labels: {epochs} epochs, {steps} control steps" in message
    assert "on 2 cores" in message and "--cfg cfg/fast.yaml" in message and list(tmp_path.iterdir()) == []
    # 733.2 million at 2 x 1000 a second are 4.2 days.
    assert ("about 4 days" if not words else "control steps, under 2 hours on") in message
