"""Speed of a training epoch and its share of physics: `python -m benchmarks.epoch --workers 1,2`.

Each row is the median over epochs as the runner makes them (rollout and PPO update), without the first epoch, a
warm-up. Physics is the time inside the engine's own step divided by the wall time of all workers, update included.
Compare `pool.kind=ray` with `pool.kind=process` to see the cost of Ray.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from pathlib import Path

import torch

from dgrasp.build import build_pool
from dgrasp.config.experiment import find_config, load_config
from dgrasp.data import resolve
from dgrasp.rl.runner import Runner


def main() -> None:
    """Print one row per number of workers, and the speed-up over the first."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cfg", type=Path, help="the recipe; without it, the defaults")
    parser.add_argument("--workers", default="1,2", metavar="N,N,...", help="numbers of workers to compare")
    parser.add_argument("--epochs", type=int, default=2, help="epochs per row; the first, a warm-up, is left out")
    parser.add_argument("overrides", nargs="*", metavar="key=value")
    arguments = parser.parse_intermixed_args()
    base = 0.0
    print(f"{'workers':>7} {'steps/s':>9} {'physics':>8} {'update':>7} {'ratio':>6}")
    for workers in map(int, arguments.workers.split(",")):
        config = load_config(
            find_config(arguments.cfg) if arguments.cfg else None,
            [
                *arguments.overrides, f"pool.workers={workers}", f"ppo.epochs={arguments.epochs}",
                "checkpoint.every=1000",
            ],
        )
        torch.set_num_threads(1)
        choice = resolve(config)
        pool = build_pool(choice, config)
        rows: list[dict[str, float]] = []
        with tempfile.TemporaryDirectory() as folder:
            runner = Runner(pool, config, Path(folder), choice.stamp())
            complete = runner._complete

            def keep(epoch, values, log, last=False, rows=rows, complete=complete):  # type: ignore[no-untyped-def]
                rows.append(values)
                complete(epoch, values, log, last)

            runner._complete = keep  # type: ignore[method-assign]
            start = time.perf_counter()
            runner.learn()
            seconds = time.perf_counter() - start
        pool.close()
        speed, share, update = (
            statistics.median(row[f"speed/{name}"] for row in rows[1:])
            for name in ("steps_per_second", "physics_share", "update_share")
        )
        base = base or speed
        print(f"{workers:>7} {speed:>9.1f} {share:>8.3f} {update:>7.3f} {speed / base:>6.2f}   ({seconds:.0f} s)")


if __name__ == "__main__":
    main()
