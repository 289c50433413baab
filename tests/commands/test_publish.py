"""`dgrasp publish`: which checkpoint of a run it takes."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from dgrasp.cli import main
from dgrasp.config.experiment import Config
from dgrasp.rl.networks import ActorCritic
from dgrasp.rl.run.checkpoint import Checkpoint, save, save_best
from dgrasp.rl.run.weights import read_weights


def checkpoint_of(epoch: int, success: float | None) -> Checkpoint:
    model = ActorCritic(5, 3, [4], 1.0, torch.Generator().manual_seed(epoch), actor_size=5)
    plain = Config().model_dump(mode="json")
    data = {"inertia": "official"}
    return Checkpoint(epoch, model.state_dict(), {}, 1e-3, model.architecture(), plain, data, "0", success)


@pytest.mark.parametrize(
    ("best", "last", "words", "taken", "said"),
    [
        (4, 8, [], 4, "the best evaluation was after epoch 4 of 8; --last takes the last one"),
        (4, 8, ["--last"], 8, None),
        (8, 8, [], 8, None),
        (0, 8, [], 8, "no evaluation was better than before training"),
        (None, 8, [], 8, None),
    ],
)
def test_the_best_checkpoint_or_the_last(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], best: int | None, last: int, words: list[str], taken: int,
    said: str | None,
) -> None:  # fmt: skip
    save(tmp_path, checkpoint_of(last, 0.5))
    if best is not None:
        save_best(tmp_path, checkpoint_of(best, 0.5))
    out = tmp_path / "mine.safetensors"
    assert main(["publish", str(tmp_path), "--out", str(out), *words]) == 0
    shown = capsys.readouterr().out
    assert "trained on unknown labels with the authors' inertia of 1 kg m2; " in shown
    assert read_weights(out)[1]["epoch"] == taken and f"({taken} epochs" in shown
    assert (said in shown) if said else shown.startswith("wrote ")


def test_what_is_not_trained_is_not_published(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = save(tmp_path, checkpoint_of(0, 0.0))
    save_best(tmp_path, checkpoint_of(0, 0.0))
    out = ["--out", str(tmp_path / "mine.safetensors")]
    for words in ([], ["--last"]):
        assert main(["publish", str(tmp_path), *out, *words]) == 2
        assert "no epoch is trained yet" in capsys.readouterr().err
    assert main(["publish", str(file), *out, "--last"]) == 2
    assert "is a checkpoint; expected a run directory" in capsys.readouterr().err
    assert not (tmp_path / "mine.safetensors").exists()
