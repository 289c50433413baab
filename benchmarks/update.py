"""Time of a PPO update on CPU and GPU, with and without torch.compile: `python -m benchmarks.update`.

Each row learns from the same epoch of random experience with the recipe's settings. Times are the minimum over several
turns, because other work on the machine can only add time. The first turn, in which torch.compile compiles, has its own
column.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import torch

from dgrasp.config.experiment import find_config, load_config
from dgrasp.rl.collect import Trajectories
from dgrasp.rl.networks import ActorCritic
from dgrasp.rl.ppo import Ppo
from dgrasp.rl.runner import epoch_generator
from dgrasp.rl.storage import Rollout

ACTIONS = 51


def main() -> None:
    """Print one row per device without torch.compile, and one with it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cfg", type=Path, default=Path("cfg/fast.yaml"), help="the recipe")
    parser.add_argument("--envs", type=int, default=30, help="environments of an epoch")
    parser.add_argument("--observation", type=int, default=281, help="numbers in an observation")
    parser.add_argument("--turns", type=int, default=5, help="updates of each row after the first")
    parser.add_argument("overrides", nargs="*", metavar="key=value")
    arguments = parser.parse_intermixed_args()
    config = load_config(find_config(arguments.cfg), arguments.overrides)
    torch.set_num_threads(config.ppo.threads)
    steps, ppo = config.env.episode_steps, config.ppo
    epoch = _epoch(steps, arguments.envs, arguments.observation)
    print(f"{steps} x {arguments.envs} samples, {ppo.update_epochs} x {ppo.minibatches} minibatches, {ppo.hidden}")
    print(f"{'device':>8} {'compiled':>9} {'first s':>8} {'load ms':>8} {'update ms':>10}")
    for device in ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]:
        for compiled in (False, True):
            generator = epoch_generator(config.seed, 0)
            model = ActorCritic(
                arguments.observation, ACTIONS, ppo.hidden, ppo.initial_std, generator, None, ppo.output_gain
            ).to(device)
            if compiled:
                model.evaluate = torch.compile(model.evaluate)  # type: ignore[method-assign]
            learner, rollout = Ppo(model, ppo), Rollout(torch.device(device))
            loads, updates = [], []
            for _ in range(arguments.turns + 1):
                start = time.perf_counter()
                rollout.load(epoch, model)
                rollout.compute_returns(ppo.gamma, ppo.lam)
                loaded = time.perf_counter()
                learner.update(rollout, generator)  # returns numbers on the CPU, so a GPU has finished by then
                loads.append(loaded - start)
                updates.append(time.perf_counter() - loaded)
            load, update = 1e3 * min(loads[1:]), 1e3 * min(updates[1:])
            first = loads[0] + updates[0]
            print(f"{device:>8} {'yes' if compiled else 'no':>9} {first:>8.2f} {load:>8.1f} {update:>10.1f}")


def _epoch(steps: int, envs: int, observation: int) -> Trajectories:
    epoch = Trajectories.allocate(steps, envs, observation, ACTIONS, 1)
    random = np.random.default_rng(0)
    for array in (epoch.observations, epoch.actions, epoch.reward, epoch.last_observation):
        array[:] = random.standard_normal(array.shape)
    epoch.truncated[-1] = True
    epoch.valid[:] = True
    return epoch


if __name__ == "__main__":
    main()
