"""The tasks that move the object to a target: one policy for the whole hand, or one for the wrist of a frozen grasp."""

from __future__ import annotations

import numpy as np

from dgrasp.control.controllers import HOLD_KP_POSITION, Controller
from dgrasp.control.motion import Fingers
from dgrasp.control.wrist import WholeHand, move_wrist
from dgrasp.env.features import FeatureLayer
from dgrasp.env.grasp_env import GraspEnv, Mode, Seen
from dgrasp.hand.layout import N_WRIST, HandLayout
from dgrasp.motion.targets import training_target
from dgrasp.scene.relations import relations
from dgrasp.types import Array


class TargetEnv(GraspEnv):
    """A `GraspEnv` that draws a target for each training episode from (seed, epoch, environment)."""

    def _place(self, i: int) -> None:
        super()._place(i)
        if self.mode == "train":
            T_WG = training_target(self.labels[i], self._rng[i])
            self.s.R_WG[i], self.s.target_pos_W[i] = T_WG[:3, :3], T_WG[:3, 3]


class FlatEnv(TargetEnv):
    """The baseline Flat-RL: one policy controls wrist and fingers from the first step to the last (supplement, B.4).

    The wrist's bias is that of `env.wrist`. The first six actions move the wrist along and about the axes of W, the
    frame of psi. `begin_motion` changes only the target.
    """

    def _start_control(self) -> Controller:
        return super()._start_control() if self.mode == "label" else WholeHand(self.config.env, self.hand.layout)

    def _write_pd_targets(self, actions: Array) -> None:
        super()._write_pd_targets(actions)
        if isinstance(self.control, WholeHand):
            move_wrist(self._target, self.s, actions[:, :N_WRIST], self.config.motion, slice(None))

    def _begin_motion_control(self, fingers: Fingers) -> None:
        """Do nothing, because the policy already controls the wrist."""


class MotionEnv(TargetEnv):
    """The baseline "learned policy": actions (N, 6) move the wrist while a frozen policy grasps (supplement, A.2).

    An episode begins with the grasp: `env.grasp_steps` control steps of the frozen policy alone. In training, the reset
    makes these steps, so the learner does not see them. An episode that restarts within an epoch, for example because
    the simulation broke, makes them in the epoch; until then its actions have no effect and its reward is 0. In a
    test, the actions have no effect before `begin_motion`.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        env = self.config.env.model_copy(update={"task": "grasp", "critic_features": False})
        self._grasp_layer = FeatureLayer(env, self.hand.layout)
        self._moving = np.zeros(self.num_envs, bool)
        """Environments in which the actions move the wrist."""

    @classmethod
    def actions(cls, hand: HandLayout) -> int:
        """A: the wrist's coordinates alone."""
        return N_WRIST

    def reset(self, epoch: int = 0, mode: Mode = "train") -> Array:
        """As `GraspEnv.reset`; in training it also makes the grasps before it returns."""
        super().reset(epoch, mode)
        if mode == "train":
            nothing = np.zeros((self.num_envs, self.action_size))
            for _ in range(self.config.env.grasp_steps):
                self.step(nothing)
        return self.o.observation

    def _place(self, i: int) -> None:
        super()._place(i)
        self._moving[i] = False

    def _write_pd_targets(self, actions: Array) -> None:
        if self.mode == "train":
            self._start_moving(~self._moving & (self.clock >= self.config.env.grasp_steps))
        super()._write_pd_targets(self._grasp_actions())
        rows = np.flatnonzero(self._moving)
        self._target[rows, :N_WRIST] = self.s.gc[rows, :N_WRIST]
        move_wrist(self._target, self.s, actions, self.config.motion, rows)

    def _grasp_actions(self) -> Array:
        """(N, D) actions of the frozen policy; zeros for environments that are not simulated."""
        assert self.grasp is not None
        rows = np.flatnonzero(self.alive & self.active)
        phi = np.zeros((self.num_envs, self._grasp_layer.size), np.float32)
        self._grasp_layer(self.s, self.goal, relations(self.s, self.goal, self.config.env.wrist_error), phi)
        n_dof = self.hand.layout.n_dof
        means, actions = np.zeros((len(rows), n_dof), np.float32), np.zeros((self.num_envs, n_dof), np.float32)
        self.grasp.means(phi[rows], means)
        actions[rows] = means
        return actions

    def _start_moving(self, which: Array) -> None:
        """Begin the motion of some environments: the wrist gets the stiffness of motion synthesis."""
        for i in np.flatnonzero(which).tolist():
            self.worlds.set_gains(i, HOLD_KP_POSITION)
        self._moving |= which

    def _begin_motion_control(self, fingers: Fingers) -> None:
        """Let the actions move all wrists."""
        self._start_moving(np.ones(self.num_envs, bool))

    def _write_reward(self, seen: Seen) -> None:
        super()._write_reward(seen)
        self.o.reward[~self._moving], self.o.reward_terms[~self._moving] = 0.0, 0.0
