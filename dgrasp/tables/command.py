"""`python test.py --table NAME`: the paper's tables."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from dgrasp.errors import ConfigError
from dgrasp.tables.fill import Tables
from dgrasp.tables.plan import plans
from dgrasp.tables.show import show, write


def main(arguments: argparse.Namespace) -> int:
    """Fill, print and write the tables that `arguments.table` names."""
    if arguments.baseline is not None or arguments.run is not None or arguments.motion is not None:
        raise ConfigError("--table takes its methods from the paper; leave --baseline, --run and --motion away "
                          "(--policy FILE stands in for the policy of all objects)")
    given = {"data": arguments.data, "engine": arguments.engine, "eval.window_s": arguments.window}
    overrides = [f"{key}={json.dumps(value)}" for key, value in given.items() if value is not None]
    root: Path = arguments.runs
    tables = Tables(
        root, arguments.cfg, [*overrides, *arguments.overrides], arguments.policy, arguments.budget,
    )  # fmt: skip
    chosen = plans(arguments.table)
    tables.train_missing(chosen)
    root.mkdir(parents=True, exist_ok=True)
    for plan in chosen:
        rows = tables.fill(plan)
        show(plan, rows)
        write(plan, rows, root)
    return 0
