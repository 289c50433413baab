"""Pools beside each other: `python -m benchmarks.pool --workers 2 --cfg cfg/fast.yaml data=DIR engine=mujoco`.

No pool, threads and processes take turns to collect the same epochs, equal to the bit, with an untrained policy. A row
gives medians over the turns: the control steps per second, the share of the workers' time inside the engine's step, and
the speed relative to that of no pool in the same turn.
"""

from __future__ import annotations

import argparse
import statistics
import time
from pathlib import Path

import torch

from dgrasp.build import build_spec
from dgrasp.config.experiment import find_config, load_config
from dgrasp.data import resolve
from dgrasp.pool import Pool
from dgrasp.pool.process import ProcessPool
from dgrasp.pool.serial import SerialPool
from dgrasp.rl.networks import ActorCritic
from dgrasp.rl.runner import epoch_generator
from raisim_like.engines import steps_in_threads


def main() -> None:
    """Print a row for each pool."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cfg", type=Path, help="the recipe; without it, the defaults")
    parser.add_argument("--workers", type=int, default=2, help="threads and processes, besides one process")
    parser.add_argument("--turns", type=int, default=3, help="epochs of each pool; the first, a warm-up, is left out")
    parser.add_argument("--steps", type=int, default=60, help="control steps of an epoch")
    parser.add_argument("overrides", nargs="*", metavar="key=value", help="config keys; data=DIR for real labels")
    arguments = parser.parse_intermixed_args()
    torch.set_num_threads(1)
    config = load_config(find_config(arguments.cfg) if arguments.cfg else None, arguments.overrides)
    spec = build_spec(resolve(config), config)
    counts = sorted({1, arguments.workers})
    pools: dict[str, Pool] = {"no pool": SerialPool(spec)}
    if steps_in_threads(config.engine):
        pools |= {f"thread, {n}": SerialPool(spec, n) for n in counts if n > 1}
    pools |= {f"process, {n}": ProcessPool(spec, n) for n in counts}
    alone = pools["no pool"]
    actor = ActorCritic(
        alone.observation_size, alone.action_size, config.ppo.hidden, config.ppo.initial_std,
        epoch_generator(config.seed, 0), alone.actor_size, config.ppo.output_gain,
    ).actor_arrays(config.seed)  # fmt: skip
    rows: dict[str, list[tuple[float, float]]] = {name: [] for name in pools}
    print(f"{len(spec.labels)} environments, {arguments.steps} control steps, {config.engine}")
    for epoch in range(1, arguments.turns + 1):
        reference = b""
        for name, pool in pools.items():
            made: list[int] = []
            start = time.perf_counter()
            experience = pool.collect(actor, epoch, arguments.steps, made.append)
            speed = sum(made) / (time.perf_counter() - start)
            seen = experience.observations.tobytes() + experience.reward.tobytes()
            reference = reference or seen
            assert seen == reference, name
            print(f"epoch {epoch}, {name:<11} {speed:9.1f} control steps/s", flush=True)
            if epoch > 1:
                rows[name].append((speed, pool.timing()["physics_share"]))
    for pool in pools.values():
        pool.close()
    print(f"{'pool':<11} {'steps/s':>9} {'physics':>8} {'ratio':>6}")
    for name, turns in rows.items():
        speed, physics = (statistics.median(values) for values in zip(*turns, strict=True))
        ratio = statistics.median(a[0] / b[0] for a, b in zip(turns, rows["no pool"], strict=True))
        print(f"{name:<11} {speed:>9.1f} {physics:>8.3f} {ratio:>6.2f}")


if __name__ == "__main__":
    main()
