"""Stability of physics and memory over a long run: `python -m benchmarks.soak --episodes 1000 data=DIR`.

First plays random actions with a large spread on all labels. Prints the number of broken simulations, the number of
joints that stayed at the engine's velocity clamp for a second, and the largest kinetic energy of an object. Then resets
all worlds many times and prints the growth of the process's memory.
"""

from __future__ import annotations

import argparse
import gc
import time
from pathlib import Path

import numpy as np

from dgrasp.build import build_spec
from dgrasp.config.experiment import Config, load_config
from dgrasp.data import resolve
from dgrasp.env.grasp_env import GraspEnv
from dgrasp.pool.base import PoolSpec

CLAMP = 99.0
"""rad/s. A faster joint counts as running at the engine's clamp of 100 rad/s."""


def resident_mb() -> float:
    """Resident memory of this process, MB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1e6


def random_episodes(spec: PoolSpec, config: Config, std: float, episodes: int, batch: int) -> None:
    """Play the episodes, `batch` worlds at a time, and print a summary."""
    rng = np.random.default_rng(config.seed)
    second = round(1.0 / config.control_period)
    broken, ran_away, energy, fastest, steps = 0, 0, 0.0, 0.0, 0
    started = time.perf_counter()
    for first in range(0, episodes, batch):
        labels = [spec.labels[i % len(spec.labels)] for i in range(first, min(first + batch, episodes))]
        env = GraspEnv(labels, spec.hand, spec.objects, config, range(first, first + len(labels)))
        env.reset(1 + first // len(spec.labels))
        fast = np.zeros((len(labels), 51), int)
        for _ in range(config.env.episode_steps):
            o = env.step(std * rng.normal(size=(len(labels), 51)))
            broken += int(o.broken.sum())
            speed = np.abs(env.s.gv)
            fast = np.where(speed > CLAMP, fast + 1, 0)
            ran_away += int((fast == second).sum())
            fastest = max(fastest, float(speed.max()))
            v, w = env.s.object_linvel_W, env.s.object_angvel_W
            inertia = np.array([np.trace(spec.objects[label.object_id].inertia) / 3 for label in labels])
            kinetic = 0.5 * (env.s.object_mass * (v**2).sum(1) + inertia * (w**2).sum(1))
            energy = max(energy, float(kinetic.max()))
            steps += len(labels)
        env.close()
    print(
        f"{config.engine}, action std {std:g}: {episodes} episodes, {steps} control steps, {broken} broken, "
        f"{ran_away} joints at the clamp for a second, fastest joint {fastest:.1f} rad/s, largest kinetic energy of "
        f"an object {energy:.2f} J, {steps / (time.perf_counter() - started):.0f} steps/s",
        flush=True,
    )


def many_resets(spec: PoolSpec, config: Config, resets: int) -> None:
    """Reset one world per object many times, rebuild one of them in each round, and print the growth of memory."""
    first = {label.object_id: label for label in spec.labels}
    env = GraspEnv(list(first.values()), spec.hand, spec.objects, config)
    rounds = -(-resets // env.num_envs)
    warm = before = 0.0
    for k in range(rounds):
        # Destroy a world and build it again with its object, as after an explosion.
        env.worlds.rebuild(k % env.num_envs)
        env.reset(k)
        env.step(np.zeros((env.num_envs, 51)))
        if k == rounds // 10:
            gc.collect()
            warm = before = resident_mb()
    gc.collect()
    print(
        f"{config.engine}: {rounds * env.num_envs} resets with {rounds} worlds rebuilt: "
        f"{resident_mb() - before:+.1f} MB (from {warm:.0f} MB after the first tenth)",
        flush=True,
    )
    env.close()


def main() -> None:
    """Print a line per engine and spread of the actions, and a line per engine for the memory."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--engines", default="pybullet,mujoco", metavar="NAME,...")
    parser.add_argument("--episodes", type=int, default=1000)
    parser.add_argument("--stds", default="1,3", metavar="N,...", help="stds of the actions (training starts at 1)")
    parser.add_argument("--resets", type=int, default=2000)
    parser.add_argument("--batch", type=int, default=40, help="worlds at a time")
    parser.add_argument("overrides", nargs="*", metavar="key=value")
    arguments = parser.parse_intermixed_args()
    for engine in arguments.engines.split(","):
        config = load_config(None, [*arguments.overrides, f"engine={engine}"])
        choice = resolve(config)
        print(choice.describe())
        spec = build_spec(choice, config)
        for std in map(float, arguments.stds.split(",")):
            random_episodes(spec, config, std, arguments.episodes, arguments.batch)
        many_resets(spec, config, arguments.resets)


if __name__ == "__main__":
    main()
