"""Control steps per second of each engine on each object: `python -m benchmarks.step_rate --policy FILE.pt data=DIR`.

The policy acts as in a test: the approach, then the hold without a table. Each row gives control steps per second and
core, the share of the wall time inside the engine's own step, and the ratio to the rate of a bare loop of that step.
For the bare loop, every tenth control step is first made under constant torques, then undone.
Afterwards several processes run at once, each with its share of the labels; the result is the sum of their rates.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import time
from dataclasses import dataclass
from multiprocessing.synchronize import Barrier
from pathlib import Path

from dgrasp.build import build_spec
from dgrasp.config.experiment import load_config
from dgrasp.data import resolve
from dgrasp.env.grasp_env import GraspEnv
from dgrasp.methods.method import Method
from dgrasp.methods.policy import PolicyMethod
from dgrasp.pool.base import PoolSpec
from dgrasp.rl.run.published import load_published_actor
from dgrasp.types import Array
from raisim_like.loop import LoopBatch

BARE_EVERY = 10


class _Zeros:
    """Zero actions, used when no policy is given."""

    name, mode = "zeros", "test"

    def act(self, observation: Array) -> Array:
        return observation[:, :51] * 0.0


@dataclass
class Rate:
    """Control steps and wall seconds of some environments."""

    labels: int
    steps: int = 0
    seconds: float = 0.0
    physics_s: float = 0.0
    bare_steps: int = 0
    bare_s: float = 0.0

    @property
    def per_second(self) -> float:
        """Control steps per second of one process."""
        return self.steps / self.seconds

    def row(self, name: str) -> str:
        """A line of the table."""
        bare = self.bare_steps / self.bare_s
        share, ratio = self.physics_s / self.seconds, self.per_second / bare
        return f"{name:<24}{self.labels:>7}{self.per_second:>10.1f}{share:>9.3f}{bare:>10.1f}{ratio:>8.3f}"


HEADER = f"{'object':<24}{'labels':>7}{'steps/s':>10}{'physics':>9}{'bare/s':>10}{'ratio':>8}"


def measure(spec: PoolSpec, method: Method, hold: int, bare: bool) -> Rate:
    """Time all labels of a specification, stepped together. bare: also time the bare loop at every tenth step."""
    grasp, substeps = spec.config.env.grasp_steps, spec.config.physics.substeps
    env = GraspEnv(spec.labels, spec.hand, spec.objects, spec.config)
    rate = Rate(len(spec.labels))
    observation = env.reset(0, method.mode)
    for t in range(grasp + hold):
        if t == grasp:
            env.remove_table()
        if bare and t % BARE_EVERY == BARE_EVERY // 2:
            assert isinstance(env.worlds.batch, LoopBatch)
            for world in env.worlds.batch.worlds:
                snapshot = world.save()
                rate.bare_s += world.engine_world.bare_step(substeps)
                rate.bare_steps += 1
                world.restore(snapshot)
        before, start = env.step_seconds, time.perf_counter()
        observation = env.step(method.act(observation)).observation
        rate.seconds += time.perf_counter() - start
        rate.physics_s += env.step_seconds - before
        rate.steps += len(spec.labels)
    env.close()
    return rate


def _method(policy: Path | None) -> Method:
    return PolicyMethod(load_published_actor(policy)) if policy is not None else _Zeros()  # type: ignore[return-value]


def _part(spec: PoolSpec, rows: slice) -> PoolSpec:
    return PoolSpec(spec.labels[rows], spec.hand, spec.objects, spec.config)


def _process(
    spec: PoolSpec, policy: Path | None, hold: int, start: Barrier, rates: multiprocessing.Queue[float]
) -> None:
    method = _method(policy)
    start.wait()
    rates.put(measure(spec, method, hold, bare=False).per_second)


def side_by_side(spec: PoolSpec, policy: Path | None, hold: int, processes: int) -> float:
    """Total control steps per second of n processes that run at once, each with every n-th label."""
    context = multiprocessing.get_context("spawn")
    start, rates = context.Barrier(processes), context.Queue()
    running = [
        context.Process(target=_process, args=(_part(spec, slice(k, None, processes)), policy, hold, start, rates))
        for k in range(processes)
    ]
    for process in running:
        process.start()
    total = sum(rates.get() for _ in running)
    for process in running:
        process.join()
    return total


def main() -> None:
    """Print a table per engine."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--engines", default="pybullet,mujoco", metavar="NAME,...")
    parser.add_argument("--policy", type=Path, metavar="FILE.pt", help="the authors' policy; default: zero actions")
    parser.add_argument("--hold", type=int, default=60, help="control steps without a table")
    parser.add_argument("--processes", default="1,2", metavar="N,...", help="numbers of processes to compare")
    parser.add_argument("overrides", nargs="*", metavar="key=value", help="such as data=DIR labels.limit_per_object=2")
    arguments = parser.parse_intermixed_args()
    os.environ["OMP_NUM_THREADS"] = "1"
    for engine in arguments.engines.split(","):
        config = load_config(None, [*arguments.overrides, f"engine={engine}"])
        choice = resolve(config)
        spec = build_spec(choice, config)
        print(f"\n{engine}, {len(spec.labels)} labels of {choice.describe()}\n{HEADER}")
        method, rates = _method(arguments.policy), []
        for name in dict.fromkeys(label.object_id for label in spec.labels):
            labels = [label for label in spec.labels if label.object_id == name]
            rates.append(measure(PoolSpec(labels, spec.hand, spec.objects, config), method, arguments.hold, True))
            print(rates[-1].row(name), flush=True)
        total = Rate(sum(rate.labels for rate in rates))
        for rate in rates:
            for field in ("steps", "seconds", "physics_s", "bare_steps", "bare_s"):
                setattr(total, field, getattr(total, field) + getattr(rate, field))
        print(total.row("all labels"))
        base = 0.0
        for processes in map(int, arguments.processes.split(",")):
            together = side_by_side(spec, arguments.policy, arguments.hold, processes)
            base = base or together
            print(f"{processes} processes: {together:.1f} control steps/s together, {together / base:.2f} times")


if __name__ == "__main__":
    main()
