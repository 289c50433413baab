"""`python test.py --table NAME`: fill the paper's tables."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from dgrasp.config.values import override
from dgrasp.errors import ConfigError, DataError

RUNS = Path("runs/tables")
"""Default of --runs: the folder of runs and results."""
_NOT_OF_TABLES = ("baseline", "run", "motion", "split", "labels", "objects", "json", "report", "records", "gif",
                  "shapes")
"""Options of test.py that choose what a single evaluation covers or where its output goes; --table refuses them."""


def main(arguments: argparse.Namespace) -> int:
    """Fill, print and write the tables that `arguments.table` names.

    A table without values is complete if its policies are untrained, for then it lists the trainings. `DataError` if no
    table has a value and an evaluation failed.
    """
    refused = [f"--{name}" for name in _NOT_OF_TABLES if getattr(arguments, name) not in (None, False)]
    if refused:
        raise ConfigError("--table takes methods, labels and targets from the paper and writes NAME.md, NAME.csv and "
                          f"NAME.json to --runs; leave out {', '.join(refused)} (--policy FILE replaces the policy of "
                          "all objects; the key labels.objects=[NAME, ...] restricts rows that name no objects of "
                          "their own), or leave out --table for a single evaluation")

    from dgrasp.tables.fill import Cells, Tables, fill
    from dgrasp.tables.plan import plans
    from dgrasp.tables.show import show, write

    given = {"data": arguments.data, "engine": arguments.engine, "eval.window_s": arguments.window}
    overrides = [override(key, value) for key, value in given.items() if value is not None]
    overrides += arguments.overrides
    root, budget = arguments.runs or RUNS, arguments.budget
    each = [[*overrides, f"seed={seed}"] for seed in dict.fromkeys(arguments.seeds)] or [overrides]
    seeds = [Tables(root, arguments.cfg, words, arguments.policy) for words in each]
    chosen = plans(arguments.table)
    import torch

    torch.set_num_threads(1)
    end = None if budget is None else time.monotonic() + 60.0 * budget
    for i, one in enumerate(seeds):
        if end is not None:
            one.trainings.train_missing(chosen, (end - time.monotonic()) / 60.0 / (len(seeds) - i))
    try:
        root.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"--runs {root}: cannot write to this folder ({error.strerror})") from None
    every: list[Cells] = []
    for plan in chosen:
        rows = fill(plan, seeds)
        show(plan, rows)
        write(plan, rows, root)
        every += rows
    errors = [error for cells in every for error in cells.errors]
    if errors and not any(cells.values for cells in every):
        raise DataError(f"--table {arguments.table}: no evaluation was possible; the first that failed is {errors[0]}")
    return 0
