"""The config: typed values, dotted overrides, YAML as YAML 1.2 reads numbers, and one message for each mistake."""

from __future__ import annotations

from pathlib import Path

import pytest

from dgrasp.commands.train import _no_config
from dgrasp.config.experiment import Config, config_keys, control_steps, dump_config, load_config, make_config
from dgrasp.config.sections import LabelsConfig
from dgrasp.config.values import apply_overrides, flat_keys, override, parse_yaml
from dgrasp.errors import ConfigError
from dgrasp.files.paths import cfg_root
from raisim_like.registry import BATCHES, find_engine


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
        (["labels.objects=[4]"], "labels.objects: .*numbers in quotes"),
        (["labels.objects=[4, 025_mug]"], "numbers in quotes"),
        (["labels.objects=[004]"], r"labels\.objects=\[004\]': YAML reads 004 in base 8; .* or quoted text: '004'"),
        (["labels.objects=[010, 025_mug]"], "reads 010 in base 8"),
        (["seed=010"], "override 'seed=010': YAML reads 010 in base 8; expected a decimal number without leading"),
        (["seed=-0_10"], "reads -0_10 in base 8"),
        (["eval.window_s=1:30"], "reads 1:30 in base 60; expected a decimal number .* or quoted text: '1:30'"),
        (["eval.window_s=1:30.5"], "reads 1:30.5 in base 60"),
        (["env.episode_steps=100000000000"], r"env\.episode_steps: .*less than or equal to 10000 \(got 100000000000\)"),
        (["env.episode_steps=1e11"], r"env\.episode_steps: .*valid integer"),
        (["env.lengthens_by=100000000000"], r"env\.lengthens_by: .*less than or equal to 10000"),
        (["motion.steps=100000000000"], r"motion\.steps: .*less than or equal to 10000"),
        (["ppo.epochs=100000000000"], r"ppo\.epochs: .*less than or equal to 1000000"),
        (["ppo.hidden=[128, 100000000000]"], r"ppo\.hidden\.1: .*less than or equal to 10000"),
        (["ppo.threads=100000000000"], r"ppo\.threads: .*less than or equal to 1024"),
        (["physics.substeps=100000000000"], r"physics\.substeps: .*less than or equal to 1000"),
        (["pool.hang_s=1e300"], r"pool\.hang_s: .*less than or equal to 1000000"),
        (["seed=9223372036854775808"], "seed: .*less than 9223372036854775808"),
        (["eval.window_s=1e11"], r"eval\.window_s: 1e\+11 s are 3\.47e\+12 control steps .* at most 10000"),
        (["physics.timestep=1e-12"], r"eval\.window_s: 5 s are 3\.85e\+11 control steps of 1\.3e-11 s"),
        (["env.grasp_steps=195"], "env.grasp_steps must be below"),
        (["env.hold.first_step=70"], "first_step <= last_step"),
        (["engine=havok"], r"engine: .*expected one of pybullet, mujoco, warp \(got 'havok'\)"),
        (["engine=mujoco", "physics.concave=mesh"], "mujoco does not support concave meshes"),
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
    assert parse_yaml("[0, -7, +10, 1_000, 0x1F, 0b11, 01.5, .inf]", "x") == [0, -7, 10, 1000, 31, 3, 1.5, float("inf")]
    # What is text stays text.
    assert parse_yaml("['010', 008, '1:30', 025_mug, localhost:6379]", "x") == [
        "010", "008", "1:30", "025_mug", "localhost:6379"]  # fmt: skip
    with pytest.raises(ConfigError, match=r"^a\.yaml: line 2: YAML reads 017 in base 8"):
        parse_yaml("a: 1\nb: 017", "a.yaml")


def test_values_belong_to_the_caller() -> None:
    """The same text is parsed once."""
    first = parse_yaml("a: {b: [1]}", "x")
    first["a"]["b"].append(2)
    assert parse_yaml("a: {b: [1]}", "x") == {"a": {"b": [1]}}


@pytest.mark.parametrize("name", ["010", "008", "1:30", "0x1F"])
def test_texts_that_look_like_numbers_are_dumped_as_texts(tmp_path: Path, name: str) -> None:
    config = make_config({"labels": {"objects": [name]}})
    (tmp_path / "a.yaml").write_text(dump_config(config))
    assert load_config(tmp_path / "a.yaml") == config


def test_the_papers_config_is_the_defaults() -> None:
    """Its file is there to be read; a number that is changed in one place must be changed in the other."""
    assert load_config(cfg_root() / "dexycb.yaml") == Config()


def test_an_engine_that_is_new_needs_no_line_of_dgrasp(monkeypatch: pytest.MonkeyPatch) -> None:
    """It takes convex parts, as an engine without concave meshes does, and its trainings are estimated too."""
    monkeypatch.setitem(BATCHES, "new", find_engine)  # type: ignore[arg-type]
    assert make_config({"engine": "new"}).engine == "new"
    with pytest.raises(ConfigError, match=r"concave: new does not support concave meshes; .* or the engine pybullet"):
        make_config({"engine": "new", "physics": {"concave": "mesh"}})
    # 20 labels x 195 steps x 7,385 epochs, at 1,000 steps a second for each of 2 workers.
    keys = {"labels.limit_per_object": 1, "ppo.epochs": 7385, "pool.workers": 2, "data": "free", "engine": "new"}
    config = load_config(None, [override(key, value) for key, value in keys.items()])
    assert "28,801,500 control steps, about 4 hours on 2 cores" in str(_no_config(config))


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


def test_the_last_epoch_is_the_last_that_the_limits_allow() -> None:
    config = Config.model_validate({
        "ppo": {"epochs": 9, "max_steps": 1799}, "labels": {"per_epoch": 2, "doubles_every": 3},
        "env": {"episode_steps": 100},
    })  # fmt: skip
    # Of 9 labels 2 take part in epochs 1 to 3, 4 in epochs 4 to 6: 200, 400, 600; 1000, 1400, 1800.
    assert [config.steps_in(epoch, 9) for epoch in (1, 3, 4, 7)] == [200, 200, 400, 800]
    assert config.last_epoch(9) == 5
    # A run that lost steps has some left; one that is past a limit has none.
    assert config.last_epoch(9, epoch=5, steps=1399) == 6 and config.last_epoch(9, epoch=5, steps=1400) == 5
    assert config.last_epoch(9, epoch=8, steps=4000) == 8 and config.last_epoch(9, epoch=12, steps=0) == 9
    endless = config.model_copy(update={"ppo": config.ppo.model_copy(update={"max_steps": None})})
    assert endless.last_epoch(9) == endless.last_epoch(9, epoch=3, steps=10**9) == 9
    short = config.model_copy(update={"ppo": config.ppo.model_copy(update={"max_steps": 1})})
    assert short.last_epoch(9) == 1


def test_the_window_is_a_whole_number_of_control_steps() -> None:
    assert Config().control_period == pytest.approx(0.02886)
    # 5 s are 173.25 control steps, 3.87 s 134.1.
    assert Config().window_steps == 173
    assert Config.model_validate({"eval": {"window_s": 3.87}}).window_steps == 134
    assert Config.model_validate({"eval": {"window_s": 0.001}}).window_steps == 1
    assert control_steps(0.001, 0.02886) == 0 and control_steps(0.1, 0.02886) == 3


def test_a_missing_file_names_the_nearest(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text("seed: 2\n")
    with pytest.raises(ConfigError) as caught:
        load_config(tmp_path / "mien.yaml")
    assert str(caught.value).endswith(
        f"cannot read the config (No such file or directory); did you mean {str(tmp_path / 'mine.yaml')!r}?"
    )
    with pytest.raises(ConfigError, match=r"did you mean 'cfg/fast\.yaml'"):
        load_config(Path("cfg/fast.yml"))
