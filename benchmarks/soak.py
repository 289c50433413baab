"""Does the physics stay sane, and the memory constant? `python -m benchmarks.soak --episodes 1000 data=DIR`.

Random actions with a large spread over all labels: counts simulations that broke, joints that ran at the engine's
clamp for a second on end, and the largest kinetic energy; then resets of every world again and again, and how much
memory the process has gained.
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
"""rad/s. Joints that are faster run at the engine's clamp of 100."""


def resident_mb() -> float:
    """Memory of this process that is in RAM, MB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1e6


def random_episodes(spec: PoolSpec, config: Config, std: float, episodes: int, batch: int) -> None:
    """Plays the episodes, `batch` worlds at a time, and prints what happened."""
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
    """Places one world per object again and again, replacing one of them now and then; prints the growth."""
    first = {label.object_id: label for label in spec.labels}
    env = GraspEnv(list(first.values()), spec.hand, spec.objects, config)
    rounds = -(-resets // env.num_envs)
    warm = before = 0.0
    for k in range(rounds):
        # A world that is taken down and set up again with its object, as after an explosion.
        env.worlds.rebuild(k % env.num_envs)
        env.reset(k)
        env.step(np.zeros((env.num_envs, 51)))
        if k == rounds // 10:
            gc.collect()
            warm = before = resident_mb()
    gc.collect()
    print(
        f"{config.engine}: {rounds * env.num_envs} resets with {rounds} worlds set up anew: "
        f"{resident_mb() - before:+.1f} MB (from {warm:.0f} MB after the first tenth)",
        flush=True,
    )
    env.close()


def main() -> None:
    """Print a line per engine and spread of the actions, and one for the memory."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--engines", default="pybullet,mujoco", metavar="NAME,...")
    parser.add_argument("--episodes", type=int, default=1000)
    parser.add_argument("--stds", default="1,3", metavar="N,...", help="spreads of the actions (training starts at 1)")
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
