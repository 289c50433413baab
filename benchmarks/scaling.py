"""Predicted speed of training on 1 to 1,000 cores: `python -m benchmarks.scaling --rate 300 data=DIR`.

Measures the learner's time per epoch (the PPO update on one episode of each label) and the bytes that each control step
sends to it. The predicted time of an epoch is the sum of three parts: the largest share of labels of a worker at
`--rate` control steps per second and core, the transfer at `--mbit`, and the update.
"""

from __future__ import annotations

import argparse
import time

import torch

from dgrasp.build import build_hand
from dgrasp.config.experiment import load_config
from dgrasp.data import resolve
from dgrasp.env.features import FeatureLayer
from dgrasp.rl.collect import Trajectories
from dgrasp.rl.networks import ActorCritic
from dgrasp.rl.ppo import Ppo
from dgrasp.rl.runner import epoch_generator, pick_device
from dgrasp.rl.storage import Rollout

CORES = (1, 2, 8, 32, 100, 376, 1000)


def main() -> None:
    """Print the learner's measured costs and a row per number of cores."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--labels", type=int, default=376, help="environments in an epoch")
    parser.add_argument("--rate", type=float, default=300.0, help="control steps per second of one core")
    parser.add_argument("--mbit", type=float, default=1000.0, help="network into the learner, Mbit/s")
    parser.add_argument("overrides", nargs="*", metavar="key=value")
    arguments = parser.parse_intermixed_args()
    config = load_config(None, arguments.overrides)
    hand = build_hand(resolve(config)).layout
    torch.set_num_threads(1)
    layer, steps, n = FeatureLayer(config.env, hand), config.env.episode_steps, arguments.labels
    device = pick_device(config.device)
    model = ActorCritic(
        layer.size, hand.n_dof, config.ppo.hidden, config.ppo.initial_std, epoch_generator(1, 0), layer.actor_size
    ).to(device)
    ppo, rollout = Ppo(model, config.ppo), Rollout(device)
    trajectories = Trajectories.allocate(steps, n, layer.size, hand.n_dof, 7)
    generator = torch.Generator().manual_seed(0)
    trajectories.observations[:] = torch.randn(trajectories.observations.shape, generator=generator).numpy()
    trajectories.actions[:] = torch.randn(trajectories.actions.shape, generator=generator).numpy()
    trajectories.reward[:] = torch.randn(trajectories.reward.shape, generator=generator).numpy()
    trajectories.valid[:] = True
    size = sum(array.nbytes for array in vars(trajectories).values())
    started = time.perf_counter()
    rollout.load(trajectories, model)
    rollout.compute_returns(config.ppo.gamma, config.ppo.lam)
    ppo.update(rollout, epoch_generator(1, 1))
    update = time.perf_counter() - started
    weights = sum(parameter.numel() for parameter in model.parameters()) * 4
    print(f"{n} environments, {steps} control steps each: {size / (n * steps):.0f} bytes per control step, "
          f"{size / 1e6:.0f} MB per epoch, {weights / 1e3:.0f} kB of weights; "
          f"the learner takes {update:.2f} s on {device.type}, one thread")
    print(f"{'cores':>6} {'rollout s':>10} {'transfer s':>11} {'update s':>9} {'epoch s':>8} {'steps/s':>9}")
    transfer = size * 8 / (arguments.mbit * 1e6)
    for cores in CORES:
        rollout_s = -(-n // min(cores, n)) * steps / arguments.rate
        epoch = rollout_s + (transfer if cores > 1 else 0.0) + update
        print(f"{cores:>6} {rollout_s:>10.2f} {transfer if cores > 1 else 0.0:>11.2f} {update:>9.2f} {epoch:>8.2f} "
              f"{n * steps / epoch:>9.0f}")


if __name__ == "__main__":
    main()
