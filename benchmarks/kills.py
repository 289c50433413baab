"""Check that a run survives the loss of workers: `python -m benchmarks.kills --kills 10 --epochs 20 data=DIR`.

Trains in this process and kills a random worker with SIGKILL in the middle of random epochs. Prints how many updates
were made and how many episodes were lost.
"""

from __future__ import annotations

import argparse
import os
import signal
import tempfile
from pathlib import Path

import numpy as np
import torch

from dgrasp.build import build_spec
from dgrasp.config.experiment import load_config
from dgrasp.data import resolve
from dgrasp.pool.process import ProcessPool
from dgrasp.rl.collect import Actor, Trajectories
from dgrasp.rl.runner import Runner


def main() -> None:
    """Train with the kills and print what was lost."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=10)
    parser.add_argument("--epochs", type=int, default=20)
    parser.add_argument("--workers", type=int, default=4)
    parser.add_argument("overrides", nargs="*", metavar="key=value")
    arguments = parser.parse_intermixed_args()
    torch.set_num_threads(1)
    config = load_config(None, [*arguments.overrides, f"ppo.epochs={arguments.epochs}"])
    choice = resolve(config)
    pool = ProcessPool(build_spec(choice, config), arguments.workers)
    rng = np.random.default_rng(config.seed)
    doomed = set((1 + rng.permutation(arguments.epochs)[: arguments.kills]).tolist())
    lost, collect = [], pool.collect

    def strike(actor: Actor, epoch: int, steps: int, advance: object) -> Trajectories:
        victim = [pool._members[int(rng.integers(arguments.workers))]] if epoch in doomed else []

        def tell(made: int) -> None:
            if made and victim:
                os.kill(victim.pop().process.pid or 0, signal.SIGKILL)

        trajectories = collect(actor, epoch, steps, tell)
        lost.append(int((~trajectories.valid).sum()))
        return trajectories

    pool.collect = strike  # type: ignore[method-assign]
    with tempfile.TemporaryDirectory() as folder:
        runner = Runner(pool, config, Path(folder), choice.stamp())
        runner.learn()
        print(
            f"{config.engine}: {runner.epoch} of {arguments.epochs} updates made; {pool.timing()['lost_workers']:.0f} "
            f"workers lost; {sum(lost)} of {len(lost) * pool.num_envs} episodes dropped"
        )
    pool.close()


if __name__ == "__main__":
    main()
