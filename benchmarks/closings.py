"""Share of labels that a hand holds by closing its fingers, without a policy.

Run `python -m benchmarks.closings data=free labels.split=test`.

The fingers' targets are the label's angles plus a given number of radians towards each other; the thumb has its own
factor on that number. The first table starts in the label's pose without a table and with a stiff wrist, as gt_pd does.
The second starts from the label's start with the test's own approach; the fingers close between a first and a last
control step. A label that is held only in the first table is lost during the approach. A label that is held in neither
is hardly a grasp.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from dgrasp.build import build_spec
from dgrasp.config.experiment import load_config
from dgrasp.data import resolve
from dgrasp.env.grasp_env import GraspEnv
from dgrasp.hand.mano.skeleton import FINGERS, KEYPOINTS, N_DOF
from dgrasp.synthesis.trial import outlasts_window
from dgrasp.types import Array

HELD = [(0.0, 1.0), *((angle, thumb) for angle in (0.1, 0.2, 0.4, 0.8) for thumb in (0.5, 1.0, 2.0))]
"""Angle (rad) beyond the label, and the thumb's factor on it."""
APPROACHES = [(15, 30, 0.1, 0.5), (25, 45, 0.1, 0.5), (25, 45, 0.2, 0.5), (25, 45, 0.1, 1.0), (25, 45, 0.3, 1.0),
              (35, 50, 0.2, 1.0), (15, 40, 0.4, 1.0)]  # fmt: skip
"""First and last control step of closing, then angle (rad) and thumb's factor as in `HELD`."""
_THUMB = FINGERS.index("thumb")


def main() -> None:
    """Print the shares of labels that are held."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("overrides", nargs="*", metavar="key=value")
    config = load_config(Path("cfg/fast.yaml"), parser.parse_args().overrides)
    choice = resolve(config)
    print(choice.describe(), flush=True)
    spec = build_spec(choice, config)
    env = GraspEnv(spec.labels, spec.hand, spec.objects, config)
    inward = closing_directions(env)
    held = np.array([_hold(env, squeeze(inward, *how)) for how in HELD])
    _show("from the label's pose", HELD, held)
    caught = np.array([_approach(env, first, last, squeeze(inward, *how)) for first, last, *how in APPROACHES])
    _show("from the start", APPROACHES, caught)
    names = [label.object_id for label in spec.labels]
    print(f"\n{'object':<24}{'n':>4}{'as labelled':>13}{'any':>7}{'from the start, best way':>26}")
    best = caught[caught.mean(axis=1).argmax()]
    for name in dict.fromkeys(names):
        mine = np.array(names) == name
        print(f"{name:<24}{mine.sum():>4}{held[0, mine].mean():>13.2f}{held[:, mine].any(axis=0).mean():>7.2f}"
              f"{best[mine].mean():>26.2f}")
    env.close()


def closing_directions(env: GraspEnv) -> Array:
    """(N, 45) in [-1, 1]: how each joint turns to move its fingertip towards the object and the opposite fingertips.

    The largest absolute value of each finger is 1.
    """
    labels, hand, n = env.labels, env.hand, env.num_envs
    R, t = (np.array([label.T_WH for label in labels])[:, :3, part] for part in (slice(3), 3))
    pose = np.array([label.hand_pose for label in labels])
    middle = [label.T_WO @ np.append(env.objects[label.object_id].center_of_mass_O, 1.0) for label in labels]
    tips = [KEYPOINTS.index(f"{finger}_tip") for finger in FINGERS]

    def tips_at(angles: Array) -> Array:
        return hand.forward(np.concatenate([np.zeros((n, 6)), angles], axis=1), R, t)[1][:, tips]

    at, step, directions = tips_at(pose), 0.02, np.zeros((n, 45))
    for joint in range(45):
        finger = joint // 9
        opposite = at[:, :3].mean(axis=1) if finger == _THUMB else at[:, _THUMB]
        way = 0.5 * (opposite + np.array(middle)[:, :3]) - at[:, finger]
        moved = pose.copy()
        moved[:, joint] += step
        directions[:, joint] = np.sum((tips_at(moved)[:, finger] - at[:, finger]) * way, axis=1)
    largest = np.abs(directions.reshape(n, 5, 9)).max(axis=2, keepdims=True)
    return np.asarray((directions.reshape(n, 5, 9) / np.maximum(largest, 1e-9)).reshape(n, 45))


def squeeze(inward: Array, angle: float, thumb: float) -> Array:
    """(N, 45) rad to add to the label's angles: `angle` along `inward`, times `thumb` for the thumb's joints."""
    beyond = angle * inward
    beyond[:, 9 * _THUMB : 9 * _THUMB + 9] *= thumb
    return beyond


def _hold(env: GraspEnv, beyond: Array) -> Array:
    env.reset(0, "label")
    # In gt_pd the actions have no effect; here they offset the fingers' targets.
    env.control.sigma = np.r_[np.zeros(6), np.ones(N_DOF - 6)]
    targets = _fingers_alone(beyond)
    return outlasts_window(env, lambda: targets)


def _approach(env: GraspEnv, first: int, last: int, beyond: Array) -> Array:
    env.reset(0, "test")
    start, label = env.s.gc[:, 6:].copy(), env.goal.hand_pose
    target = np.zeros((env.num_envs, N_DOF))

    def fingers(step: int) -> Array:
        closed, pressed = np.clip([(step - first) / (last - first), (step - last) / 8.0], 0.0, 1.0)
        env.control.bias(env.s, env.goal, target)
        wanted = start + closed * (label - start) + pressed * beyond
        return np.asarray((wanted - target[:, 6:]) / env.config.env.action.sigma_fingers)

    for step in range(env.config.env.grasp_steps):
        env.step(_fingers_alone(fingers(step)))
    env.remove_table()
    return outlasts_window(env, lambda: _fingers_alone(fingers(10**6)))


def _fingers_alone(actions: Array) -> Array:
    return np.concatenate([np.zeros((len(actions), 6)), actions], axis=1)


def _show(title: str, ways: list[tuple[float, ...]], held: Array) -> None:
    print(f"\n{title}, {held.shape[1]} labels")
    for way, share in zip(ways, held.mean(axis=1), strict=True):
        print(f"  {' '.join(f'{number:g}' for number in way):<14} {share:.3f}")
    print(f"  any            {held.any(axis=0).mean():.3f}", flush=True)


if __name__ == "__main__":
    main()
