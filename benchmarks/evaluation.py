"""Overhead of a test over its physics: `python -m benchmarks.evaluation data=DIR labels.limit_per_object=2`.

Runs the baseline gt_pd in one process. Prints the share of the time inside the engine's step and inside `integrate`,
which includes the PD controller, as RaiSim's does.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence

from dgrasp.build import build_spec
from dgrasp.config.experiment import load_config
from dgrasp.data import resolve
from dgrasp.eval.evaluator import evaluate
from dgrasp.methods import PdBaseline
from dgrasp.pool import make_pool
from raisim_like import loop
from raisim_like.world import World, integrate


class Clock:
    """Replaces `integrate` and adds up the wall seconds spent in it."""

    seconds = 0.0

    def __call__(self, worlds: Sequence[World], substeps: int = 1) -> None:
        started = time.perf_counter()
        integrate(worlds, substeps)
        self.seconds += time.perf_counter() - started


def main() -> None:
    """Run the baseline and print the shares."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("overrides", nargs="*", metavar="key=value", help="config keys; data=DIR for real labels")
    config = load_config(None, [*parser.parse_args().overrides, "pool.kind=serial"])
    choice = resolve(config)
    print(choice.describe())
    clock = Clock()
    # `LoopBatch` calls `integrate` through the name in its own module.
    loop.integrate = clock  # type: ignore[assignment]
    pool = make_pool(build_spec(choice, config))
    try:
        _, cost = evaluate(pool, PdBaseline(), config)
    finally:
        pool.close()
    engine, physics = cost["physics_share"], clock.seconds / cost["wall_s"]
    print(f"{config.engine}, preset {config.physics.preset}, {cost['control_steps']:.0f} control steps in "
          f"{cost['wall_s']:.1f} s: the test takes {1.0 / physics:.3f} times its physics (share {physics:.3f}), "
          f"{1.0 / engine:.3f} times the engine's step (share {engine:.3f})")


if __name__ == "__main__":
    main()
