"""`python test.py --table NAME`: the paper's tables."""

from __future__ import annotations

import argparse
import json
import time

from dgrasp.errors import ConfigError
from dgrasp.tables.fill import Tables, fill
from dgrasp.tables.plan import plans
from dgrasp.tables.show import show, write


def main(arguments: argparse.Namespace) -> int:
    """Fill, print and write the tables that `arguments.table` names."""
    if arguments.baseline is not None or arguments.run is not None or arguments.motion is not None:
        raise ConfigError("--table takes its methods from the paper; leave --baseline, --run and --motion away "
                          "(--policy FILE stands in for the policy of all objects)")
    given = {"data": arguments.data, "engine": arguments.engine, "eval.window_s": arguments.window}
    overrides = [f"{key}={json.dumps(value)}" for key, value in given.items() if value is not None]
    overrides += arguments.overrides
    root, budget = arguments.runs, arguments.budget
    each = [[*overrides, f"seed={seed}"] for seed in dict.fromkeys(arguments.seeds)] or [overrides]
    seeds = [Tables(root, arguments.cfg, words, arguments.policy) for words in each]
    chosen = plans(arguments.table)
    end = None if budget is None else time.monotonic() + 60.0 * budget
    for i, one in enumerate(seeds):
        if end is not None:
            one.train_missing(chosen, (end - time.monotonic()) / 60.0 / (len(seeds) - i))
    root.mkdir(parents=True, exist_ok=True)
    for plan in chosen:
        rows = fill(plan, seeds)
        show(plan, rows)
        write(plan, rows, root)
    return 0
