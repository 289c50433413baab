"""What answers at once: `--help` and refusals load none of the libraries that take seconds to import."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

from dgrasp.cli import COMMANDS
from dgrasp.config import names
from dgrasp.files.paths import shipped_root
from dgrasp.labels.recorded.table_sources import TABLE_SOURCES
from dgrasp.methods import METHODS
from dgrasp.tables.plan import _PLANS

HEAVY = ("torch", "pybullet", "mujoco", "warp", "trimesh", "scipy", "matplotlib")
_CODE = """
import contextlib, io, json, sys
from dgrasp.cli import main
heavy, lines = json.load(sys.stdin)
answers, known = [], set()
for words in lines:
    out, err, code = io.StringIO(), io.StringIO(), 0
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main(words)
        except SystemExit as stop:
            code = stop.code
    loaded = set(heavy) & set(sys.modules)
    answers.append((code, out.getvalue(), err.getvalue(), sorted(loaded - known)))
    known |= loaded
json.dump(answers, sys.stdout)
"""


class Answer(NamedTuple):
    """Exit code, output, and the heavy libraries that no command before this one had loaded."""

    code: int
    out: str
    err: str
    loaded: list[str]


def ask(lines: list[list[str]], cwd: Path, heavy: tuple[str, ...] = HEAVY) -> list[Answer]:
    """The answers to commands, one after another in a new interpreter."""
    # The first entry of the path is the current folder.
    done = subprocess.run(
        [sys.executable, "-c", _CODE], cwd=cwd, input=json.dumps([heavy, lines]), capture_output=True, text=True,
        check=True, env={"PYTHONPATH": str(shipped_root())},
    )  # fmt: skip
    return [Answer(*answer) for answer in json.loads(done.stdout)]


HELP = [["--help"], *([*name.split(), "--help"] for name in COMMANDS)]


@pytest.fixture(scope="module")
def help_answers(tmp_path_factory: pytest.TempPathFactory) -> list[Answer]:
    return ask(HELP, tmp_path_factory.mktemp("help"))


@pytest.mark.parametrize("i", range(len(HELP)), ids=[" ".join(words) for words in HELP])
def test_help_loads_nothing_heavy(i: int, help_answers: list[Answer]) -> None:
    code, out, err, loaded = help_answers[i]
    assert code == 0 and out.startswith("usage: ") and err == "" and loaded == []


def test_the_usage_loads_neither_numpy_nor_pydantic(tmp_path: Path) -> None:
    (answer,) = ask([["--help"]], tmp_path, ("numpy", "pydantic", "yaml", "rich"))
    assert answer.code == 0 and answer.err == "" and answer.loaded == []


REFUSED = [
    (["train", "--cfg", "cfg/fast.yaml", "ppo.epoch=3"], "did you mean 'ppo.epochs'?"),
    (["train", "--cfg", "none.yaml"], "none.yaml"),
    (["train", "--cfg", "cfg/fast.yaml", "--data", "none"], "none"),
    (["train", "--cfg", "cfg/fast.yaml", "--data", "free", "labels.objects=[999_none]"], "999_none"),
    (["train", "--resume", "none"], "no run to resume"),
    (["test", "--baseline", "gt_pd", "ppo.epoch=3"], "did you mean 'ppo.epochs'?"),
    (["test"], "expected one of --baseline, --run and --policy"),
    (["test", "--run", "none"], "none: no checkpoint there"),
    (["test", "--policy", "none.pt"], "none.pt: no such file"),
    (["test", "--policy", "none.pt", "--cfg", "cfg/fast.yaml", "ppo.epoch=3"], "did you mean 'ppo.epochs'?"),
    (["test", "--table", "grasp", "ppo.epoch=3"], "did you mean 'ppo.epochs'?"),
    (["test", "--table", "grasp", "--report", "x.html"], "leave out --report"),
    (["test", "--baseline", "gt_pd", "--labels", "none.npz"], "none.npz"),
    (["test", "--baseline", "gt_pd", "--shapes"], "--shapes: only valid with --gif or --report"),
    (["demo", "ppo.epoch=3"], "did you mean 'ppo.epochs'?"),
    (["runs", "none"], "none: no such folder"),
    (["publish", "none", "--out", "x.safetensors"], "none: no such file"),
    (["object", "add", "none.obj", "--mass", "0"], "--mass 0"),
    (["labels", "make", "--objects", "999", "--number", "2", "--out", "x.npz"], "unknown object '999'"),
    (["labels", "check", "none.npz"], "none.npz"),
    (["grasp", "none.obj"], "none.obj: no such mesh file"),
    (["grasp", "025_mug", "--number", "0"], "--number 0"),
    (["grasp", "025_mug", "--to", "1 2"], "--to '1 2': 2 numbers"),
    (["grasp", "025_mug", "--policy", "none.pt"], "none.pt: no such file"),
    (["grasp", "025_mug", "ppo.epoch=3"], "did you mean 'ppo.epochs'?"),
    (["export", "none.npz", "--out", "a.glb"], "none.npz: no stored sequences"),
    (["view", "none", "--out", "a.html"], "none: no stored sequences"),
    (["hand", "report", "none.urdf"], "none.urdf"),
    (["hand", "build", "--mano", "none.pkl", "--out", "h"], "none.pkl: cannot be read"),
    # Files that are there, and hold something else.
    (["train", "--cfg", "bad.yaml"], "bad.yaml"),
    (["train", "--cfg", "cfg/fast.yaml", "--data", "free", "labels.source=bad.npz"], "bad.npz: neither"),
    (["train", "--resume", "."], "no run to resume"),
    (["test", "--policy", "bad.pt"], "bad.pt: damaged or not a checkpoint (a checksum does not match)"),
    (["test", "--policy", "bad.safetensors"], "bad.safetensors: damaged or not a policy"),
    (["test", "--baseline", "gt_pd", "--data", "free", "--labels", "bad.npz"], "bad.npz: neither"),
    (["test", "--baseline", "gt_pd", "--data", "free", "--motion", "near"], "gt_pd holds a pose"),
    (["test", "--baseline", "static_grasp", "--data", "free", "--motion", "bad.csv"], "bad.csv"),
    (["publish", "bad.pt", "--out", "x.safetensors"], "bad.pt: damaged"),
    (["publish", ".", "--out", "x.safetensors"], ".: no checkpoint there"),
    (["object", "add", "bad.obj"], "bad.obj: line 1"),
    (["grasp", "bad.obj"], "bad.obj: line 1"),
    (["grasp", "025_mug", "--policy", "bad.pt"], "bad.pt: damaged"),
    (["grasp", "025_mug", "--hand", "bad.urdf"], "bad.urdf"),
    (["labels", "import", "mano", "bad.npz", "--mano", "bad.pkl", "--hand", "free", "--out", "x.npz"], "bad.pkl"),
    (["labels", "check", "bad.npz", "--data", "free"], "bad.npz: neither"),
    (["labels", "make", "--objects", "004", "--number", "2", "--hand", "bad.urdf", "--out", "x.npz"], "bad.urdf"),
    (["hand", "build", "--mano", "bad.pkl", "--out", "h"], "bad.pkl: not a pickle of a dictionary"),
    (["export", "bad.npz", "--out", "a.npz"], "bad.npz: damaged"),
]


@pytest.fixture(scope="module")
def refusals(tmp_path_factory: pytest.TempPathFactory) -> list[Answer]:
    folder = tmp_path_factory.mktemp("refused")
    for suffix in ("yaml", "npz", "pt", "safetensors", "csv", "obj", "pkl", "urdf"):
        (folder / f"bad.{suffix}").write_text("v 1 2: [\n")
    return ask([words for words, _ in REFUSED], folder)


@pytest.mark.parametrize("i", range(len(REFUSED)), ids=[" ".join(words) for words, _ in REFUSED])
def test_a_refusal_loads_nothing_heavy(i: int, refusals: list[Answer]) -> None:
    code, _, err, loaded = refusals[i]
    assert code == 2 and err.startswith("error: ") and REFUSED[i][1] in err
    assert loaded == []


def test_the_names_that_help_shows_are_those_of_the_code() -> None:
    assert set(names.BASELINES) == METHODS.keys() - {"policy"} and list(names.BASELINES) == sorted(names.BASELINES)
    assert tuple(_PLANS) == names.TABLES and tuple(TABLE_SOURCES) == names.MANO_SOURCES
