"""The files of a run directory: its checkpoints by name, its description and its plan. Imports no torch."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dgrasp.config.experiment import Config, dump_config
from dgrasp.errors import DataError
from dgrasp.files.atomic import write_atomic

CSV_NAME = "progress.csv"
PLAN_NAME = "run.json"
FOLDER, BEST = "checkpoints", "best.pt"
WEIGHTS_SUFFIX = ".safetensors"
PRETRAINED = "pretrained"
PRETRAINED_FILE = Path("free/policy/all_objects.safetensors")
"""What the run `pretrained` stands for: the policy that ships, below the shipped data."""
_NAME = re.compile(r"\d{6,}\.pt")


def saved(run_dir: Path) -> list[Path]:
    """The checkpoints of a run directory, oldest first."""
    folder = run_dir / FOLDER
    found = [path for path in folder.glob("*.pt") if _NAME.fullmatch(path.name)] if folder.is_dir() else []
    return sorted(found, key=lambda path: int(path.stem))


def latest(run_dir: Path) -> Path:
    """The newest checkpoint of a run directory; `DataError` if it has none."""
    found = saved(run_dir)
    if not found:
        raise DataError(f"{run_dir}: no checkpoint there; expected {FOLDER}/NNNNNN.pt, as train.py writes them")
    return found[-1]


def write_description(run_dir: Path, config: Config, data_stamp: Mapping[str, Any]) -> None:
    """Write a run directory's config and data stamp."""
    write_atomic(run_dir / "config.yaml", dump_config(config))
    write_atomic(run_dir / "data.json", json.dumps(data_stamp, indent=2) + "\n")


def write_plan(run_dir: Path, environments: int, epochs: int, max_steps: int | None, last_epoch: int) -> None:
    """Write the length that a run was begun or resumed for; `Run.epochs` cannot find it in the config alone."""
    plan = {"environments": environments, "epochs": epochs, "max_steps": max_steps, "last_epoch": last_epoch}
    write_atomic(run_dir / PLAN_NAME, json.dumps(plan) + "\n")


def read_plan(run_dir: Path) -> dict[str, Any]:
    """The content of `write_plan`; empty if there is none, or if it is damaged."""
    try:
        plan = json.loads((run_dir / PLAN_NAME).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return plan if isinstance(plan, dict) and isinstance(plan.get("last_epoch"), int) else {}
