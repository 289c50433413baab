"""The log of a run, read back."""

from __future__ import annotations

import csv
import io
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.plugins.custom_scalar import layout_pb2

from dgrasp.errors import DataError
from dgrasp.rl.collect import Incident
from dgrasp.rl.networks import Policy
from dgrasp.rl.run.log import Log
from dgrasp.rl.run.progress import LINE_INTERVAL_S, TrainingProgress, format_duration
from dgrasp.rl.runner import Runner
from tests.rl.toy import ToyEnv, toy_config

# The smallest header of a GIF: 7 x 5 pixels.
GIF = b"GIF89a" + (7).to_bytes(2, "little") + (5).to_bytes(2, "little") + b"\0\0\0;"


def _console() -> tuple[Console, io.StringIO]:
    stream = io.StringIO()
    return Console(file=stream, force_terminal=False), stream


def _events(run_dir: Path) -> EventAccumulator:
    events = EventAccumulator(str(run_dir), size_guidance={"tensors": 0, "images": 0, "scalars": 0})
    events.Reload()
    return events


def _text(events: EventAccumulator, tag: str) -> str:
    return str(events.Tensors(f"{tag}/text_summary")[0].tensor_proto.string_val[0].decode())


def _evaluate(policy: Policy) -> dict[str, Any]:
    return {"success": 0.75, "contact_ratio": 0.5, "sim_dist": 1.5, "gif": GIF}


def _report(env: ToyEnv, epoch: int, step: int) -> None:
    if epoch == 2:
        env.events.append(f"environment {step}: unstable")


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("run")
    Runner(ToyEnv(on_step=_report), toy_config(), path, {"hand": "toy <b>"}, _evaluate).learn()
    return path


def test_scalars(run_dir: Path) -> None:
    events = _events(run_dir)
    tags = set(events.Tags()["scalars"])
    wanted = {
        "train/return", "train/terminated", "train/truncated", "reward/contact_reward", "reward/effort",
        "ppo/kl", "ppo/learning_rate", "ppo/action_std", "ppo/explained_variance", "speed/steps_per_second",
        "speed/physics_share", "speed/update_share", "eval/success", "eval/contact_ratio", "eval/sim_dist",
    }  # fmt: skip
    assert wanted <= tags
    assert [event.step for event in events.Scalars("train/return")] == [1, 2, 3, 4]
    assert [(event.step, event.value) for event in events.Scalars("eval/success")] == [(0, 0.75), (2, 0.75), (4, 0.75)]
    # The reward is the sum of its terms, so the return is the sum of the logged terms.
    terms = [events.Scalars(f"reward/{term}")[1].value for term in ToyEnv.reward_terms]
    assert events.Scalars("train/return")[1].value == pytest.approx(sum(terms), rel=1e-5)
    # Epochs of 10 steps hold one end of an episode of 7 steps per environment.
    ends = events.Scalars("train/truncated")[0].value + events.Scalars("train/terminated")[0].value
    assert ends >= 1.0


def test_config_and_data_are_there_as_text(run_dir: Path) -> None:
    events = _events(run_dir)
    assert "    seed: 1\n" in _text(events, "config")
    assert '"hand": "toy <b>"' in _text(events, "data")


def test_gif_is_stored_as_it_is(run_dir: Path) -> None:
    images = _events(run_dir).Images("eval/episode")
    assert [image.step for image in images] == [0, 2, 4]
    assert images[0].encoded_image_string == GIF and (images[0].width, images[0].height) == (7, 5)


def test_the_page_shows_what_matters_first(run_dir: Path) -> None:
    event = _events(run_dir).Tensors("custom_scalars__config__")[0]
    layout = layout_pb2.Layout()
    layout.ParseFromString(event.tensor_proto.string_val[0])
    first = layout.category[0]
    wanted = ["success", "return", "contact", "KL", "steps per second", "success by control steps"]
    assert [chart.title for chart in first.chart] == wanted
    contact = list(first.chart[2].multiline.tag)
    assert contact == ["eval/contact_ratio", "reward/contact_reward"]


def test_events_of_the_environments(run_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "environment 10: unstable" in _text(_events(run_dir), "events")
    Runner(ToyEnv(on_step=_report), toy_config(epochs=2), tmp_path, {}).learn()
    shown = capsys.readouterr().err
    assert "epoch 2: environment 3: unstable" in shown and "environment 4" not in shown
    assert "epoch 2: and 7 more such events" in shown


def test_csv(run_dir: Path) -> None:
    lines = (run_dir / "progress.csv").read_text().splitlines()
    header = lines[0].split(",")
    assert header[:5] == ["epoch", "control_steps", "seconds", "core_hours", "return"]
    assert [line.split(",")[:2] for line in lines[1:]] == [[str(n), str(80 * n)] for n in range(5)]
    assert {len(line.split(",")) for line in lines} == {len(header)}
    assert [line.split(",")[header.index("success")] for line in lines[1:]] == ["0.75", "", "0.75", "", "0.75"]


def _log(run_dir: Path, resumed: int = 0, terms: tuple[str, ...] = ("a",)) -> Log:
    return Log(run_dir, toy_config(), {}, terms, lambda epoch: 80 * epoch, 3, resumed, _console()[0])


def test_resumed_csv_keeps_its_columns_and_its_clock(tmp_path: Path) -> None:
    header = "epoch,control_steps,seconds,return,a\n"
    (tmp_path / "progress.csv").write_text(header + "1,80,100.0,-1,2\n2,160,200.0,-1,2\nx,,,,\n3,240,300.0,-1,2\n4,3")
    with _log(tmp_path, resumed=2, terms=("b",)) as log:
        log.epoch(3, {"train/return": -0.5, "reward/b": 7.0})
    lines = (tmp_path / "progress.csv").read_text().splitlines()
    assert lines[0].startswith(header.strip() + ",core_hours,") and len(lines) == 4
    # Earlier rows are empty in new columns.
    assert [line.rstrip(",") for line in lines[1:3]] == ["1,80,100.0,-1,2", "2,160,200.0,-1,2"]
    assert {line.count(",") for line in lines} == {lines[0].count(",")}
    row = dict(zip(lines[0].split(","), lines[3].split(","), strict=True))
    assert [row[name] for name in ("epoch", "control_steps", "return", "a", "b")] == ["3", "240", "-0.5", "", "7"]
    assert 200.0 <= float(row["seconds"]) < 260.0


def test_a_run_that_is_resumed_with_a_further_reward_term_logs_it(tmp_path: Path) -> None:
    class Further(ToyEnv):
        """A toy with a third reward term, which is always 0.5."""

        reward_terms = (*ToyEnv.reward_terms, "patience")  # type: ignore[assignment]

        def __init__(self) -> None:
            super().__init__()
            self.terms = np.full((self.num_envs, 3), 0.5, np.float32)

    Runner(ToyEnv(), toy_config(epochs=2), tmp_path, {}).learn()
    header = (tmp_path / "progress.csv").read_text().splitlines()[0]
    Runner(Further(), toy_config(epochs=4), tmp_path, {}, resume=True).learn()
    with open(tmp_path / "progress.csv", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0]) == [*header.split(","), "patience"]
    # 0.5 in each of an epoch's 10 steps.
    assert [row["patience"] for row in rows] == ["", "", "5", "5"] and all(row["contact_reward"] for row in rows)
    # A second resume keeps the present columns.
    Runner(ToyEnv(), toy_config(epochs=5), tmp_path, {}, resume=True).learn()
    with open(tmp_path / "progress.csv", encoding="utf-8") as stream:
        again = list(csv.DictReader(stream))
    assert again[:4] == rows and again[4]["patience"] == "" and again[4]["effort"]


def test_incidents_that_come_again_are_written_once(tmp_path: Path) -> None:
    (tmp_path / "incidents.csv").write_text("epoch,env,label,step\n2,0,toy/0,5\n3,1,toy/1,4\n")
    with _log(tmp_path, resumed=2) as log:
        log.incidents([Incident(1, 3, np.zeros((4, 2)))], ("toy/0", "toy/1"))
    lines = (tmp_path / "incidents.csv").read_text().splitlines()
    assert lines == ["epoch,env,label,step", "2,0,toy/0,5", "3,1,toy/1,4"]


def test_success_stands_over_its_cost(tmp_path: Path) -> None:
    """A resumed run keeps the earlier points, although TensorBoard hides those whose step exceeds the epoch."""
    with _log(tmp_path) as log:
        for epoch in (1, 2, 3):
            log.epoch(epoch, {"eval/success": epoch / 10, "speed/workers": 4.0})
    with open(tmp_path / "progress.csv", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    # Core hours: four workers times the duration of the run.
    assert float(rows[-1]["core_hours"]) == pytest.approx(4 * float(rows[-1]["seconds"]) / 3600, abs=1.2e-4)
    with _log(tmp_path, resumed=2) as log:
        log.epoch(3, {"eval/success": 0.5, "speed/workers": 1.0})
    points = _events(tmp_path).Scalars("cost/success_by_control_steps")
    assert [(p.step, round(p.value, 3)) for p in points] == [(80, 0.1), (160, 0.2), (240, 0.5)]


def test_resumed_events_hide_what_came_later(tmp_path: Path) -> None:
    with _log(tmp_path) as log:
        for epoch in (1, 2, 3):
            log.epoch(epoch, {"train/return": 1.0})
    with _log(tmp_path, resumed=1) as log:
        log.epoch(2, {"train/return": 2.0})
    assert [(e.step, e.value) for e in _events(tmp_path).Scalars("train/return")] == [(1, 1.0), (2, 2.0)]


@pytest.mark.skipif(sys.platform == "win32", reason="needs limits on the size of files")
def test_full_disk_is_one_error(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    import resource

    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        with pytest.raises(DataError, match="cannot write the log"), _log(tmp_path) as log:
            resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, limits[1]))
            for epoch in range(1000):
                log.epoch(epoch, {"train/return": 1.0})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert epoch < 999 and capfd.readouterr().err == ""


def test_what_is_not_a_gif_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="not a GIF"), _log(tmp_path) as log:
        log.epoch(0, {}, gif=b"PNG")


def test_plain_lines_come_at_intervals() -> None:
    console, stream = _console()
    now = [0.0]
    progress = TrainingProgress(1000, 0, console, clock=lambda: now[0])
    progress.success(0.5)
    for _ in range(4):
        now[0] += LINE_INTERVAL_S / 2.0
        progress.advance(150, "epoch 1/2")
    progress.close()
    # After 30 s: 300 of 1000 steps, 10 per s, 70 s left; after 60 s: 600 steps, 40 s left.
    assert stream.getvalue().splitlines() == [
        "epoch 1/2, 10 steps/s, 0:01:10 left, success 0.500",
        "epoch 1/2, 10 steps/s, 0:00:40 left, success 0.500",
    ]


def test_time_left_of_a_resumed_run_counts_its_own_steps_only() -> None:
    console, stream = _console()
    now = [0.0]
    progress = TrainingProgress(1000, 500, console, clock=lambda: now[0])
    now[0] = 50.0
    progress.advance(100, "epoch 6/10")
    # 100 steps in 50 s, 400 left.
    assert stream.getvalue() == "epoch 6/10, 2 steps/s, 0:03:20 left\n"


def test_bar_on_a_terminal() -> None:
    stream = io.StringIO()
    progress = TrainingProgress(
        100, 0, Console(file=stream, force_terminal=True, width=120, _environ={"TERM": "xterm"})
    )
    progress.advance(50, "epoch 1/2")
    progress.message("a line [not markup]")
    progress.close()
    shown = stream.getvalue()
    assert "epoch 1/2" in shown and "50.0%" in shown and "a line [not markup]" in shown


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.0, "0:00:00"), (59.9, "0:00:59"), (3723.0, "1:02:03"), (4e5, "111:06:40")]
)
def test_format_duration(seconds: float, text: str) -> None:
    assert format_duration(seconds) == text


def test_a_time_limit_bounds_the_time_left() -> None:
    now = [0.0]
    stream = io.StringIO()
    progress = TrainingProgress(1_000_000, 0, Console(file=stream), lambda: now[0], max_seconds=100.0)
    now[0] = 40.0
    progress.advance(400, "epoch 1/9")
    assert "10 steps/s, 0:01:00 left" in stream.getvalue()
    progress.close()


def test_the_line_has_the_return_and_the_share_of_recent_episodes_that_were_held() -> None:
    console, stream = _console()
    now = [0.0]
    progress = TrainingProgress(1000, 0, console, clock=lambda: now[0])
    progress.trained(-3.0, None)
    for k in range(12):
        progress.trained(float(k), k / 16)
    now[0] = 50.0
    progress.advance(100, "epoch 13/20")
    # Epochs 2 to 11 of the twelve: (2 + ... + 11) / 10 / 16 = 6.5 / 16.
    assert stream.getvalue() == "epoch 13/20, 2 steps/s, 0:07:30 left, return 11.000, held 0.406\n"


def test_the_time_of_evaluations_is_left_out_of_the_estimate() -> None:
    console, stream = _console()
    now = [0.0]
    progress = TrainingProgress(1000, 0, console, clock=lambda: now[0])
    with progress.evaluation():
        now[0] = 31.0
        progress.evaluating("epoch 0/2", 5, 20)
        now[0] = 40.0
    now[0] = 80.0
    progress.advance(400, "epoch 1/2")
    # 400 steps in 40 of the 80 s, 600 left.
    assert stream.getvalue().splitlines() == [
        "epoch 0/2, evaluating: step 5 of 20", "epoch 1/2, 10 steps/s, 0:01:00 left",
    ]  # fmt: skip
