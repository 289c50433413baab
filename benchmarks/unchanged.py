"""Whether a change of the code changes any result, to the bit.

    python -m benchmarks.unchanged --write before.json [--reference DIR]
    python -m benchmarks.unchanged --against before.json [--reference DIR]

Trains a few epochs, tests the baselines and the policies, carries objects and makes labels, on both engines, and prints
one SHA-256 for each. `--write` keeps them; `--against` compares, names what differs and exits with 1. Commit, versions
and timings are left out of what is compared. `--reference` adds a folder laid out like the authors' release.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import torch

ENGINES = ("pybullet", "mujoco")
FREE = ["labels.limit_per_object=1", "labels.objects=[004_sugar_box,025_mug,037_scissors,040_large_marker]"]
REAL = ["labels.limit_per_object=1",
        "labels.objects=[003_cracker_box,004_sugar_box,006_mustard_bottle,024_bowl,037_scissors,040_large_marker]"]
TRAINING = ["ppo.epochs=3", "seed=5", "pool.workers=2", "eval.every=1000", "eval.gif=false", "checkpoint.every=1"]
NOT_COMPARED = ("commit", "code", "version", "versions", "wall_s", "physics_share", "seconds_per_episode",
                "preparation_s")
"""Keys of the results that may differ between two runs of the same code, or name the code itself."""

Case = Callable[[Path], str]


def main() -> int:
    """Run all cases, two at a time; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    group = parser.add_mutually_exclusive_group(required=True)
    group.add_argument("--write", type=Path, metavar="FILE", help="keep the hashes in a new file")
    group.add_argument("--against", type=Path, metavar="FILE", help="compare with the hashes of a file")
    parser.add_argument("--reference", type=Path, metavar="DIR", help="a folder laid out like the authors' release")
    parser.add_argument("--only", metavar="TEXT", default="", help="only the cases whose name contains this")
    arguments = parser.parse_args()
    cases = {name: case for name, case in all_cases(arguments.reference).items() if arguments.only in name}
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(2) as threads:
        running = {name: threads.submit(case, Path(folder)) for name, case in cases.items()}
        found = {}
        for name, case in running.items():
            found[name] = case.result()
            print(f"{found[name][:16]}  {name}", flush=True)
    if arguments.write is not None:
        arguments.write.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
        return 0
    before = json.loads(arguments.against.read_text(encoding="utf-8"))
    differ = [name for name, value in found.items() if before.get(name) != value]
    for name in differ:
        print(f"changed: {name}" if name in before else f"new: {name}")
    print(f"{len(found) - len(differ)} of {len(found)} unchanged")
    return 1 if differ else 0


def all_cases(reference: Path | None) -> dict[str, Case]:
    """What is run, by name."""
    cases: dict[str, Case] = {}
    for engine in ENGINES:
        for cfg in ("fast", "dexycb"):
            cases[f"train {cfg} {engine}"] = training(f"{cfg}-{engine}", "free", engine, [f"cfg/{cfg}.yaml"])
        for what in ("--baseline gt_pd", "--baseline gt_ik", "--run pretrained",
                     "--run pretrained --motion near motion.steps=60 motion.stable_alone=false",
                     "--baseline static_grasp --motion near motion.steps=60 motion.stable_alone=false"):
            cases[f"free {what} {engine}"] = evaluation([*what.split(), "--data", "free", "--engine", engine, *FREE])
        if reference is not None:
            policy = str(reference / "policies" / "all_objs" / "full_6000.pt")
            for what in ("--baseline gt_pd", "--baseline gt_ik", f"--policy {policy}",
                         f"--policy {policy} --motion easy"):
                words = [*what.split(), "--data", str(reference), "--engine", engine, *REAL]
                cases[f"real {what.replace(policy, 'published')} {engine}"] = evaluation(words)
            cases[f"train fast real {engine}"] = training(f"real-{engine}", str(reference), engine, ["cfg/fast.yaml"])
    cases["train flat_rl mujoco"] = training(
        "flat", "free", "mujoco", ["cfg/flat_rl.yaml", "motion.stable_alone=false", "env.episode_steps=120"])
    policy = str(Path("data/free/policy/all_objects.safetensors"))
    cases["train learned_motion mujoco"] = training(
        "motion", "free", "mujoco",
        ["cfg/learned_motion.yaml", f"motion.policy={policy}", "motion.stable_alone=false", "env.scaled_features=true",
         "env.episode_steps=100"])
    cases["labels make"] = labels
    return cases


def run(script: str, words: list[str]) -> None:
    """One command of the program; stops everything where it fails."""
    done = subprocess.run([sys.executable, *script.split(), *words], capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{script} {' '.join(words)}\n{done.stdout[-2000:]}{done.stderr[-2000:]}")


def training(name: str, data: str, engine: str, words: list[str]) -> Case:
    """Some epochs of a config: the hash of the weights."""

    def case(folder: Path) -> str:
        run_dir = folder / f"run-{name}"
        objects = REAL if data != "free" else FREE
        run("train.py", ["--cfg", words[0], "--run", str(run_dir), "--data", data, f"engine={engine}", *TRAINING,
                         *objects, *words[1:]])
        last = sorted((run_dir / "checkpoints").glob("*.pt"))[-1]
        return tensors_hash(torch.load(last, map_location="cpu", weights_only=True)["model"])

    return case


def tensors_hash(state: dict[str, torch.Tensor]) -> str:
    """SHA-256 of a state dictionary's tensors in the order of their names."""
    digest = hashlib.sha256()
    for name in sorted(state):
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(state[name].numpy()).tobytes())
    return digest.hexdigest()


def evaluation(words: list[str]) -> Case:
    """A test: the hash of its JSON."""

    def case(folder: Path) -> str:
        file = folder / f"{hashlib.sha256(' '.join(words).encode()).hexdigest()[:12]}.json"
        run("test.py", [*words, "--json", str(file)])
        plain = comparable(json.loads(file.read_text(encoding="utf-8")))
        return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()

    return case


def comparable(value: Any) -> Any:
    """A result without what may differ."""
    if isinstance(value, dict):
        return {key: comparable(item) for key, item in value.items() if key not in NOT_COMPARED}
    return [comparable(item) for item in value] if isinstance(value, list) else value


def labels(folder: Path) -> str:
    """Labels made for one object: the hash of their arrays."""
    file = folder / "made.npz"
    run("-m dgrasp", ["labels", "make", "--objects", "004_sugar_box", "--number", "2", "--out", str(file),
                          "--engine", "mujoco"])
    digest = hashlib.sha256()
    with np.load(file, allow_pickle=False) as arrays:
        for name in ("hand_pose", "T_WH", "T_WO", "goal_contacts"):
            digest.update(arrays[name].tobytes())
    return digest.hexdigest()


if __name__ == "__main__":
    sys.exit(main())
