"""Overhead of the process pool over the engine: `python -m benchmarks.pool data=DIR engine=mujoco`.

A pool of one worker and no pool at all take turns to collect the same epochs, equal to the bit, with an untrained
policy. The overhead is the extra time of the worker's epoch divided by the seconds inside the engine's step. All times
are the minimum over turns, because other work on the machine can only add time.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
import torch

from dgrasp.build import build_spec
from dgrasp.config.experiment import load_config
from dgrasp.data import resolve
from dgrasp.pool.process import ProcessPool
from dgrasp.pool.serial import SerialPool
from dgrasp.rl.networks import ActorCritic
from dgrasp.rl.runner import epoch_generator


def main() -> None:
    """Print the seconds of an epoch with and without the pool, and the overhead."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--turns", type=int, default=3, help="epochs of each; the first, a warm-up, is left out")
    parser.add_argument("--steps", type=int, default=60, help="control steps of an epoch")
    parser.add_argument("overrides", nargs="*", metavar="key=value", help="config keys; data=DIR for real labels")
    arguments = parser.parse_intermixed_args()
    torch.set_num_threads(1)
    config = load_config(None, arguments.overrides)
    spec = build_spec(resolve(config), config)
    alone, pool = SerialPool(spec), ProcessPool(spec, 1)
    generator = epoch_generator(config.seed, 0)
    actor = ActorCritic(
        alone.observation_size, alone.action_size, config.ppo.hidden, config.ppo.initial_std, generator,
        alone.actor_size, config.ppo.output_gain,
    ).actor_arrays(config.seed)  # fmt: skip
    seconds: dict[str, list[float]] = {"no pool": [], "one worker": []}
    physics = []
    print(f"{len(spec.labels)} environments, {arguments.steps} control steps, {config.engine}")
    for epoch in range(1, arguments.turns + 1):
        made = []
        for name, each in (("no pool", alone), ("one worker", pool)):
            start = time.perf_counter()
            made.append(each.collect(actor, epoch, arguments.steps, lambda steps: None))
            seconds[name].append(time.perf_counter() - start)
            print(f"epoch {epoch}, {name:<11} {seconds[name][-1]:8.2f} s", flush=True)
        physics.append(alone.timing()["physics_s"])
        assert np.array_equal(made[0].observations, made[1].observations)
    pool.close()
    alone.close()
    without, with_pool = (min(values[1:]) for values in seconds.values())
    least = min(physics[1:])
    print(f"engine's step {least:.2f} s, no pool {without:.2f} s, one worker {with_pool:.2f} s: "
          f"overhead {(with_pool - without) / least:+.3f} of the engine's time")


if __name__ == "__main__":
    main()
