"""The config: typed values, dotted overrides, YAML as YAML 1.2 reads numbers, and one message for each mistake."""

from __future__ import annotations

from pathlib import Path

import pytest

from dgrasp.config.experiment import Config, config_keys, dump_config, load_config, make_config
from dgrasp.config.sections import LabelsConfig
from dgrasp.config.values import apply_overrides, flat_keys, parse_yaml
from dgrasp.errors import ConfigError
from dgrasp.files.paths import cfg_root


def test_every_shipped_config_is_valid_and_names_itself() -> None:
    files = sorted(cfg_root().glob("*.yaml"))
    assert {file.stem for file in files} >= {"dexycb", "fast", "motion", "flat_rl", "learned_motion"}
    for file in files:
        assert load_config(file).name == file.stem


def test_a_dumped_config_is_the_same_again(tmp_path: Path) -> None:
    config = load_config(None, ["ppo.learning_rate=3e-4", "env.hold.first_step=45", "labels.objects=['004', 025_mug]"])
    assert config.ppo.learning_rate == 3e-4 and config.labels.objects == ["004", "025_mug"]
    (tmp_path / "a.yaml").write_text(dump_config(config))
    assert load_config(tmp_path / "a.yaml") == config


def test_overrides_lie_over_the_file_and_the_last_wins(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("seed: 4\nppo: {gamma: 0.9, epochs: 7}\n")
    config = load_config(tmp_path / "a.yaml", ["ppo.gamma=0.5", "ppo.gamma=0.8"])
    assert (config.seed, config.ppo.gamma, config.ppo.epochs) == (4, 0.8, 7)
    values = {"a": {"b": 1}}
    assert apply_overrides(values, ["a.b=2", "c.d=[1, x]"]) == {"a": {"b": 2}, "c": {"d": [1, "x"]}}
    assert values == {"a": {"b": 1}}


def test_keys_are_dotted_leaves() -> None:
    keys = config_keys()
    assert {"seed", "env.noise.wrist_xy", "ppo.gamma"} <= set(keys) and "env" not in keys
    assert len(keys) == len(set(keys))


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["ppo.gama=0.9"], "ppo.gama: unknown key; did you mean 'ppo.gamma'"),
        (["epochs=3"], "epochs: unknown key; did you mean 'ppo.epochs'"),
        (["ppo.gamma=1.5"], "ppo.gamma: .*less than or equal to 1.*got 1.5"),
        (["ppo.gamma=nan"], "ppo.gamma"),
        (["ppo.epochs=many"], "ppo.epochs: .*got 'many'"),
        (["seed"], "expected key=value"),
        (["ppo.gamma.x=1"], "ppo.gamma"),
        (["seed=[1"], "not valid YAML"),
        (["labels.objects=[004]"], "labels.objects: .*numbers in quotes"),
        (["labels.objects=[010, 025_mug]"], "numbers in quotes"),
        (["env.grasp_steps=195"], "env.grasp_steps must be below"),
        (["env.hold.first_step=70"], "first_step <= last_step"),
        (["engine=havok"], r"engine: .*expected one of pybullet, mujoco \(got 'havok'\)"),
        (["engine=mujoco", "physics.concave=mesh"], "mujoco collides no concave meshes"),
        (["ppo.min_learning_rate=0.1"], "must not exceed"),
    ],
)
def test_mistakes_are_named(overrides: list[str], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load_config(None, overrides)


def test_all_mistakes_at_once() -> None:
    with pytest.raises(ConfigError) as caught:
        make_config({"sed": 1, "ppo": {"gamma": -1.0}, "engine": "havok"}, "a.yaml")
    text = str(caught.value)
    assert text.startswith("a.yaml:") and all(word in text for word in ("sed", "ppo.gamma", "engine"))


@pytest.mark.parametrize("text", ["- 1", "a: 1\na: 2", "1: x", "a: [", "\x00", "a: !!python/object:os.system {}"])
def test_files_that_are_no_config(tmp_path: Path, text: str) -> None:
    file = tmp_path / "a.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=r"a\.yaml"):
        load_config(file)
    with pytest.raises(ConfigError, match="cannot read"):
        load_config(tmp_path / "none.yaml")


def test_numbers_are_read_as_in_yaml_1_2() -> None:
    assert parse_yaml("[1e-3, 2E5, .5, -1.5e+2]", "x") == [1e-3, 2e5, 0.5, -150.0]


def test_nested_values_have_dotted_keys() -> None:
    assert flat_keys({"a": 1, "b": {"c": [2], "d": {"e": None}}, "f": {}}) == {"a": 1, "b.c": [2], "b.d.e": None}
    assert list(flat_keys(Config().model_dump(mode="json"))) == config_keys()


def test_a_config_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="frozen"):
        Config().seed = 3  # type: ignore[misc]


@pytest.mark.parametrize(
    ("labels", "sizes"),
    [
        ({}, [100, 100, 100]),
        ({"per_epoch": 16}, [16, 16, 16]),
        ({"per_epoch": 16, "doubles_every": 10}, [16, 32, 100]),
        ({"per_epoch": 160, "doubles_every": 10}, [100, 100, 100]),
        ({"doubles_every": 10}, [100, 100, 100]),
    ],
)
def test_how_many_labels_take_part_in_an_epoch(labels: dict[str, int], sizes: list[int]) -> None:
    config = LabelsConfig(**labels)
    assert [config.in_epoch(epoch, 100) for epoch in (10, 11, 1000)] == sizes
    assert config.in_epoch(0, 100) == config.in_epoch(1, 100)


def test_episodes_lengthen_when_the_epochs_grow() -> None:
    config = Config.model_validate({
        "labels": {"per_epoch": 16, "doubles_every": 10}, "env": {"episode_steps": 100, "lengthens_by": 45},
    })
    assert [config.episode_steps(epoch) for epoch in (0, 1, 10, 11, 21)] == [100, 100, 100, 145, 190]
    assert config.learned_steps(11) == 145
    moving = config.model_copy(update={"env": config.env.model_copy(update={"task": "motion"})})
    assert moving.learned_steps(11) == 145 - config.env.grasp_steps
    # However long the training is.
    assert config.episode_steps(10**9) == config.episode_steps(1000) == 100 + 10 * 45
    assert Config.model_validate({"env": {"lengthens_by": 45}}).episode_steps(1000) == Config().episode_steps(1)
