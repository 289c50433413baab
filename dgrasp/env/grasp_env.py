"""The grasping task for N labels at once: reset, step, and the phases of training and testing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from dgrasp.config.experiment import Config
from dgrasp.control.controllers import GRASP_CONTROLLERS, Controller, LabelPose, WristHold
from dgrasp.control.motion import Fingers, MotionSynthesis
from dgrasp.env.features import FeatureLayer
from dgrasp.env.goal import make_goal
from dgrasp.env.rewards import Reward
from dgrasp.env.start import start_pose, taking_part, with_noise
from dgrasp.env.training_hold import TrainingHold
from dgrasp.hand.layout import N_WRIST, HandLayout
from dgrasp.hand.model import HandModel
from dgrasp.objects.model import ObjectModel
from dgrasp.rl.collect import Actor
from dgrasp.rl.step import Step
from dgrasp.scene.relations import Relations, relations
from dgrasp.scene.scene import LOWERED_TOP, TABLE_TOP
from dgrasp.scene.state import state_views, take
from dgrasp.scene.worlds import Worlds
from dgrasp.types import Array, GraspGoal, GraspLabel, SceneState, StartPose

Mode = Literal["train", "test", "label"]
"""train: noisy start, the table stays, ended episodes restart. test: exact start, no episode restarts.
label: hand and object start in the label's pose without a table (for the baselines)."""


@dataclass(frozen=True)
class Seen:
    """The inputs of observation and reward for some environments after a step. rows: their rows; a slice means all."""

    rows: Array | slice
    state: SceneState
    goal: GraspGoal
    relations: Relations


@dataclass
class GraspEnv:
    """N environments, one label each, stepped together.

    indices: the places of the labels in the whole set. They seed the environments, so an environment's noise does not
    depend on how the set is divided over processes. total: the size of the whole set. events: messages for the user.
    grasp: the frozen grasping policy of a task that has one. threads: how many worlds may step side by side.
    """

    labels: Sequence[GraspLabel]
    hand: HandModel
    objects: Mapping[str, ObjectModel]
    config: Config
    indices: Sequence[int] = ()
    total: int = 0
    events: list[str] = field(default_factory=list)
    grasp: Actor | None = None
    threads: int = 1

    def __post_init__(self) -> None:
        n = len(self.labels)
        env = self.config.env
        self.num_envs = n
        layout = self.hand.layout
        self.action_size = self.actions(layout)
        self.layer = FeatureLayer(env, layout)
        self.observation_size = self.layer.size
        self.reward = Reward(env.reward, layout, env.task)
        self.reward_terms = self.reward.names
        self.indices, self.total = self.indices or range(n), self.total or n
        self.s = state_views(n, layout)
        self.o = Step.allocate(n, self.layer.size, len(self.reward.names))
        self.goal = make_goal(self.labels)
        self.starts = [start_pose(label, self.hand) for label in self.labels]
        self.worlds = Worlds(self.labels, self.hand, self.objects, self.config, self.s, self.threads)
        self._target = np.zeros((n, layout.n_dof))
        self._limits = self.hand.limits.T.copy()
        self._rng: dict[int, np.random.Generator] = {}
        self.mode: Mode = "train"
        self.restarts = True  # Whether a training episode that has ended restarts in the same step.
        self.control = self._start_control()
        self.hold = TrainingHold(env, layout, self.s, n)
        self.alive = np.ones(n, bool)
        self.active = np.ones(n, bool)
        """Environments that are simulated: those that take part in this epoch (`labels.per_epoch`) and have not been
        stopped by `rest`. The others do not change."""
        self._rows: Array | slice = slice(None)
        self._path: Array | None = None
        self._path_step = 0
        self.clock = np.zeros(n, int)
        self.episode_steps = self.config.episode_steps(1)
        """Control steps of an episode in this epoch."""
        self.steps_made = np.zeros(n, int)
        """Control steps of each environment since its construction."""

    @classmethod
    def actions(cls, hand: HandLayout) -> int:
        """A, the size of the policy's action: one number per generalised coordinate."""
        return hand.n_dof

    def _start_control(self) -> Controller:
        """The controller that an episode begins with."""
        env = self.config.env
        make = LabelPose if self.mode == "label" else GRASP_CONTROLLERS[env.wrist]
        return make(env.action, self.hand.layout)

    def close(self) -> None:
        """Free all worlds."""
        self.worlds.close()

    @property
    def step_seconds(self) -> float:
        """Wall seconds spent inside the engine's step so far."""
        return float(self.seconds_per_env.sum())

    @property
    def seconds_per_env(self) -> Array:
        """(N,) wall seconds spent inside the engine's step so far, by environment."""
        return self.worlds.seconds

    # Reset -------------------------------------------------------------------------------------

    def reset(self, epoch: int = 0, mode: Mode = "train") -> Array:
        """Start all episodes and return the observations (N, O); the noise depends on (seed, epoch, environment)."""
        self.mode, self.episode_steps = mode, self.config.episode_steps(epoch)
        count = self.config.labels.in_epoch(epoch, self.total) if mode == "train" else self.total
        self.active[:] = taking_part(self.config.seed, epoch, count, self.indices, self.total)
        acting = np.flatnonzero(self.active).tolist()
        # A slice avoids copies when all environments are active.
        self._rows = slice(None) if len(acting) == self.num_envs else np.array(acting, dtype=int)
        self._rng = {i: np.random.default_rng([self.config.seed, epoch, self.indices[i]]) for i in acting}
        self.control = self._start_control()
        for i in acting:
            if not self.alive[i]:
                self.worlds.rebuild(i)
            self._place(i)
        self.alive[self._rows] = True
        self._path = None
        self.worlds.derive(self._rows)
        # The PD target before the first action. `begin_motion` may hold the fingers at it if no step comes before.
        self.control.bias(self.s, self.goal, self._target)
        # Environments that do not take part report zeros.
        for rests in (self.o.observation, self.o.reward, self.o.reward_terms):
            rests[~self.active] = 0.0
        self._observe(self._rows)
        self.o.terminated[:], self.o.truncated[:] = False, False
        return self.o.observation

    def _place(self, i: int) -> None:
        label = self.labels[i]
        if self.mode == "label":
            start = StartPose(label.T_WH, label.T_WO, label.hand_pose)
        else:
            start = self.starts[i]
            if self.mode == "train":
                start = with_noise(start, self.config.env.noise, self._rng[i])
        # In the label's pose the object is in the hand and weighs on the wrist; elsewhere it stands on the table.
        held = self.mode == "label"
        self.worlds.place(i, start, LOWERED_TOP if held else TABLE_TOP, self.control.kp_position, carries=held)
        s = self.s
        s.R_WG[i], s.target_pos_W[i] = start.T_WO[:3, :3], start.T_WO[:3, 3]
        s.table_gone[i], s.holding[i], s.episode_time[i] = 0.0, 0.0, 0.0
        self.clock[i] = 0
        if self.mode == "train":
            self.hold.draw(i, self._rng[i])

    # Step --------------------------------------------------------------------------------------

    def step(self, actions: Array) -> Step:
        """Make one control step with residual actions (N, A)."""
        self._write_target_pose()
        self._write_pd_targets(actions)
        np.clip(self._target, self._limits[0], self._limits[1], out=self._target)
        self._advance()
        self.clock += self.alive & self.active
        self.steps_made += self.alive & self.active
        broken = self.worlds.exploded() & self.alive & self.active
        if broken.any():
            # The last valid observation of these episodes is the one before this step.
            self.o.final_observation[broken] = self.o.observation[broken]
            self._rebuild_broken(np.flatnonzero(broken))
        self.worlds.derive(self._rows)
        np.divide(self.clock, self.episode_steps, out=self.s.episode_time)
        dropped = self.hold.judge(self.s) if self._training_hold else np.zeros(self.num_envs, bool)
        self._write_reward(self._observe(self._rows))
        # A broken episode earns nothing in its last step; its environment has already been placed at a start.
        self.o.reward[broken], self.o.reward_terms[broken] = 0.0, 0.0
        self.o.broken[:] = self.o.terminated[:] = broken
        self.o.truncated[:] = False
        if self.mode == "train":
            fallen = dropped & self.active & ~broken
            self.o.terminated[:] |= fallen
            self.o.truncated[:] = ~self.o.terminated & (self.clock >= self.episode_steps) & self.active
            ended = fallen | self.o.truncated
            if self.restarts and ended.any():
                self._restart(np.flatnonzero(ended))
        return self.o

    def _write_pd_targets(self, actions: Array) -> None:
        """Write the PD targets of this step: the controller's bias plus the scaled residual actions."""
        if self._training_hold:
            for i in self.hold.begin(self.s, self.clock, self.active).tolist():
                self.worlds.release(i, self.hold.control.kp_position)
        self.control.bias(self.s, self.goal, self._target)
        sigma = self.control.sigma
        if self._training_hold:
            sigma = self.hold.aim(self.s, self.goal, sigma, self._target)
        self._target += sigma * actions

    def _write_reward(self, seen: Seen) -> None:
        """Write the reward of this step."""
        if isinstance(seen.rows, slice):
            self.reward(seen.state, seen.goal, seen.relations, self.o.reward_terms, self.o.reward)
            return
        n = len(seen.rows)
        terms, total = np.empty((n, len(self.reward.names)), np.float32), np.empty(n, np.float32)
        self.reward(seen.state, seen.goal, seen.relations, terms, total)
        self.o.reward_terms[seen.rows], self.o.reward[seen.rows] = terms, total

    @property
    def _training_hold(self) -> bool:
        return self.mode == "train" and self.hold.exists

    def rest(self, which: Array) -> None:
        """Stop simulating the environments where `which` (N,) bool is true; they do not change until the next reset."""
        self.active &= ~which

    def remove_table(self) -> None:
        """Begin the stability test: take the table away and hold the wrist where it is."""
        self.control = WristHold(self.config.env.action, self.hand.layout, self.s)
        self.s.table_gone[:] = 1.0
        for i in range(self.num_envs):
            self.worlds.release(i, self.control.kp_position)

    def begin_motion(self, path: Array, fingers: Fingers = "policy") -> None:
        """Begin motion synthesis: the wrist carries the objects along the path (N, P, 4, 4) of targets T_WG.

        Pose k is the target of control step k from now; the last pose remains the target afterwards. The table does not
        change. fingers: "policy" lets the policy move them; "target" holds their last PD targets; "pose" holds their
        present pose.
        """
        self._path, self._path_step = path, 0
        self.s.R_WG[:], self.s.target_pos_W[:] = path[:, 0, :3, :3], path[:, 0, :3, 3]
        self._begin_motion_control(fingers)
        # The policy must see the target before it chooses the next action.
        self._observe(self._rows)

    def _begin_motion_control(self, fingers: Fingers) -> None:
        """Switch the wrist to the controller of motion synthesis."""
        held = None
        if fingers != "policy":
            held = np.clip(self._target if fingers == "target" else self.s.gc, *self._limits)[:, N_WRIST:]
        env = self.config.env
        self.control = MotionSynthesis(env.action, self.config.motion, self.hand.layout, held)
        for i in range(self.num_envs):
            self.worlds.set_gains(i, self.control.kp_position)

    def _write_target_pose(self) -> None:
        """Put the target of the next control step into the state."""
        if self._path is not None:
            T_WG = self._path[:, min(self._path_step, self._path.shape[1] - 1)]
            self.s.R_WG[:], self.s.target_pos_W[:] = T_WG[:, :3, :3], T_WG[:, :3, 3]
            self._path_step += 1

    def _advance(self) -> None:
        """Simulate one control step in the active worlds that have not exploded."""
        rows = np.flatnonzero(self.alive & self.active).tolist()
        self.worlds.advance(rows, self._target, watch_table=self.mode != "train")

    def _observe(self, rows: Array | slice) -> Seen:
        """Write the observations of some environments; return the inputs that they were computed from."""
        if isinstance(rows, slice):
            seen = Seen(rows, self.s, self.goal, relations(self.s, self.goal, self.config.env.wrist_error))
            self.layer(self.s, self.goal, seen.relations, self.o.observation)
            return seen
        state, goal = take(self.s, rows), take(self.goal, rows)
        seen = Seen(rows, state, goal, relations(state, goal, self.config.env.wrist_error))
        out = np.empty((len(rows), self.layer.size), np.float32)
        self.layer(state, goal, seen.relations, out)
        self.o.observation[rows] = out
        return seen

    # Ends --------------------------------------------------------------------------------------

    def _rebuild_broken(self, ids: Array) -> None:
        """Report broken episodes, then rebuild their worlds and place them at a start.

        This comes before features and rewards are computed, which must not see the broken state. Outside training these
        environments are not simulated further.
        """
        for i in ids.tolist():
            label = self.labels[i]
            self.events.append(
                f"unstable simulation ended an episode: env {self.indices[i]}, label {label.name}, "
                f"step {int(self.clock[i])}"
            )
            self.worlds.rebuild(i)
            self._place(i)
            self.alive[i] = self.mode == "train"

    def _restart(self, ids: Array) -> None:
        """Restart ended episodes in the same step; `final_observation` keeps their last observation."""
        self.o.final_observation[ids] = self.o.observation[ids]
        for i in ids:
            self._place(i)
        self.worlds.derive(ids)
        self._observe(ids)
