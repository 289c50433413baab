"""The sections of the configuration. Every number in the paper's hyperparameter tables is a default here."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, field_validator

from dgrasp.config.tasks import TASKS

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Count = Annotated[int, Field(ge=1, le=10**9)]
MAX_STEPS = 10_000
"""Most control steps of an episode or window (five minutes); all of them are kept in memory."""
Steps = Annotated[int, Field(ge=1, le=MAX_STEPS)]
WristError = Literal["euler", "rotation_vector"]
Inertia = Literal["true", "official", "mixed"]
_AUTHORS = "the authors' inertia of 1 kg m2"
INERTIA: dict[Inertia, str] = {
    "true": "true inertia", "official": _AUTHORS, "mixed": f"{_AUTHORS}, true inertia for added objects",
}  # fmt: skip
"""The inertia of a set of objects (`PhysicsConfig.official_compat`), and its description for users."""


class Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, validate_default=True, strict=True)


class LabelsConfig(Section):
    """The grasp labels: a split of a label source, or a file, and which of its objects.

    objects: names, numbers, or the paper's sets, "unseen_1" to "unseen_6" and "seen_1" to "seen_6" (docs/labels.md).
    per_epoch: number of labels, drawn anew, in each training epoch; null takes all. doubles_every: number of epochs
    after which per_epoch doubles, again and again; null never doubles it.
    """

    source: str = "dexycb"
    split: Literal["train", "test"] = "train"
    objects: list[str] = []
    limit_per_object: Count | None = None
    per_epoch: Count | None = None
    doubles_every: Count | None = None

    def in_epoch(self, epoch: int, total: int) -> int:
        """How many of `total` labels take part in an epoch; epochs count from 1."""
        if self.per_epoch is None:
            return total
        return min(self.per_epoch << self.doublings(epoch), total)

    def doublings(self, epoch: int) -> int:
        """How often `per_epoch` has doubled by an epoch."""
        # The limit keeps the numbers of a long training from growing without bound.
        return 0 if self.doubles_every is None else min(max(0, epoch - 1) // self.doubles_every, 10)

    @field_validator("objects", mode="before")
    @classmethod
    def _names(cls, value: Any) -> Any:
        if isinstance(value, str):
            return [value]
        # Names are text; a number such as 4 is not a name.
        if any(isinstance(name, (int, float)) for name in (value if isinstance(value, list) else [value])):
            raise ValueError("expected names such as 004_sugar_box, or numbers in quotes: ['004']")
        return value


class PhysicsConfig(Section):
    """The simulated world (supplement, section B.1; docs/deviations.md).

    preset: "faithful" is as close to RaiSim as the engine can be; "fast" trades some of that for speed
    (docs/physics.md). test.py takes "faithful" whatever a run trained with, unless physics.preset is given.
    concave: how the release's concave objects collide: "mesh" as the authors' triangles (pybullet only), "parts" as
    convex parts cut from them; "auto" takes the better one for the object and the engine (docs/physics.md).
    official_compat: true gives every object 1 kg m^2 about every axis, and the release's and the free objects their
    centre of mass at the origin, as in the authors' runs; false gives the mass distribution that follows from shape
    and mass; null takes the first for objects of the release, and the second for the free set and for added objects.
    """

    timestep: Positive = 0.00222
    substeps: Annotated[int, Field(ge=1, le=1000)] = 13
    friction: NonNegative = 0.8
    official_compat: bool | None = None
    masses: Literal["official", "ycb"] = "official"
    concave: Literal["auto", "mesh", "parts"] = "auto"
    preset: Literal["faithful", "fast"] = "faithful"
    hand_table_collision: bool = True
    self_collision: bool = False

    def authors_inertia(self, released: bool) -> bool:
        """Whether an object has the authors' 1 kg m^2; `released` says whether it is an object of their release."""
        return released if self.official_compat is None else self.official_compat


def which_inertia(authors: Iterable[bool]) -> Inertia:
    """The inertia of a set of objects; `authors` has one entry for each: whether it has the authors'."""
    found = set(authors)
    return "mixed" if len(found) > 1 else "official" if True in found else "true"


class NoiseConfig(Section):
    """Half-widths of the uniform reset noise: wrist position (m; x and y, and z), wrist and finger angles (rad)."""

    wrist_xy: NonNegative = 0.02
    wrist_z: NonNegative = 0.01
    wrist_angle: NonNegative = 0.05
    finger_angle: NonNegative = 0.05


class ActionConfig(Section):
    """Scale sigma of the residual action, and the PD gains of the root translation and of all rotations."""

    sigma_wrist_position: Positive = 0.001
    sigma_wrist_rotation: Positive = 0.01
    sigma_fingers: Positive = 0.015
    kp_position: Positive = 50.0
    kd_position: NonNegative = 0.1
    kp_rotation: Positive = 50.0
    kd_rotation: NonNegative = 0.2


class RewardConfig(Section):
    """Weights of the reward terms (paper, section 3.2.2 and Table of weights; docs/deviations.md).

    target_position, target_rotation: alpha_x per m and alpha_q per rad of the distance to the target (supplement,
    equation of r_m and Table of weights), only in the tasks motion and flat. Task motion has no other terms.
    """

    position: float = 2.0
    pose: float = 0.1
    contact: float = 1.0
    impulse: float = 2.0
    object_velocity: float = -1.0
    object_angular_velocity: float = 0.0
    wrist_linear_velocity: float = -0.5
    wrist_angular_velocity: float = -0.5
    tip_weight: Positive = 4.0
    squared_weights: bool = True
    position_floor: float = -10.0
    impulse_per_mass: Positive = 5.0
    hold: float = 0.0
    target_position: float = -2.0
    target_rotation: float = -0.25
    clip: float | None = None


class HoldConfig(Section):
    """The test's hold as a part of training episodes.

    The table is removed at a step drawn from first_step to last_step, the wrist is held where it is, and the episode
    ends when the object has dropped by `drop` (m). `env.reward.hold` is paid for every step until then.
    first_step: null leaves the hold out, as in the paper.
    """

    first_step: Steps | None = None
    last_step: Steps = 65
    drop: Positive = 0.05


def _known_task(name: str) -> str:
    if name not in TASKS:
        raise ValueError(f"expected one of {', '.join(TASKS)}")
    return name


class EnvConfig(Section):
    """The task: episode, components that the paper ablates, reward.

    task: one of `TASKS`. "grasp" trains a grasping policy. The other two have a target for the object (docs/motion.md):
    "motion" trains a policy of the wrist while a frozen policy grasps (the paper's baseline "learned policy"), and
    "flat" trains one policy of everything (its baseline "Flat-RL").
    lengthens_by: control steps by which a training episode lengthens after every `labels.doubles_every` epochs, if that
    is not null.
    wrist_error: how pose error and pose reward measure the wrist: "euler" takes the difference of Euler angles, as the
    paper does; "rotation_vector" does not jump where an angle passes pi (docs/training.md).
    scaled_features: scale every feature to order 1 and clamp it. critic_features: the critic also sees how much of the
    episode has passed and whether the table is gone; the actor does not.
    """

    task: Annotated[str, AfterValidator(_known_task)] = "grasp"
    episode_steps: Steps = 195
    lengthens_by: Annotated[int, Field(ge=0, le=MAX_STEPS)] = 0
    grasp_steps: Steps = 60
    features: Literal["phi", "full_state"] = "phi"
    goal_space: bool = True
    wrist_error: WristError = "euler"
    scaled_features: bool = False
    critic_features: bool = False
    wrist: Literal["guidance", "residual"] = "guidance"
    hold: HoldConfig = HoldConfig()
    noise: NoiseConfig = NoiseConfig()
    action: ActionConfig = ActionConfig()
    reward: RewardConfig = RewardConfig()


SENSES = ("features", "goal_space", "wrist_error", "scaled_features", "wrist", "action")
"""The keys of `env` that a policy's input and output depend on."""


class MotionConfig(Section):
    """Motion synthesis (paper, section 3.3; supplement, A.2): the wrist carries the object to a 6D target.

    targets: the set "easy" (the authors'), "near", "ood", "circle" or "pour", or a file of targets (docs/motion.md);
    null tests the grasp alone. per_label: number of targets per grasp; null takes one of a set, all of a file.
    steps: control steps of the motion. beta_position, beta_rotation: the gain beta, which rises linearly to this value
    over ramp_position and ramp_rotation control steps. stable_alone: leave out grasps that fail the stability test, as
    the paper does. static_fingers: what the baseline "static grasp" holds, the fingers' pose or their last PD targets.

    policy: in the tasks motion and flat, the checkpoint of the grasping policy that makes the grasps (motion) or
    chooses them (flat). sigma_position, sigma_rotation: how far (m, rad) an action of 1 moves the wrist's target in
    those tasks.
    """

    targets: str | None = None
    per_label: Count | None = None
    steps: Steps = 300
    beta_position: Fraction = 1.0
    beta_rotation: Fraction = 1.0
    ramp_position: Count = 1000
    ramp_rotation: Count = 2000
    stable_alone: bool = True
    static_fingers: Literal["pose", "target"] = "pose"
    policy: str | None = None
    sigma_position: Positive = 0.01
    sigma_rotation: Positive = 0.01


class PpoConfig(Section):
    """PPO with the paper's hyperparameters (supplement, Table of PPO) and the authors' choices.

    Training ends after `epochs`, after the last epoch that fits in `max_steps` control steps of all environments
    together, or after the first epoch that ends `max_minutes` or more after training began or was resumed, whichever
    comes first.
    normalise_returns: the critic learns returns of mean 0 and variance 1. separate_clipping: clip the gradient norms of
    actor and critic separately. advantages_per_minibatch: normalise advantages per minibatch, not over the epoch.
    output_gain: initial gain of the actor's last layer. threads: CPU threads of the update, during which the workers
    wait; another number changes the last bits of the weights.
    """

    epochs: Annotated[int, Field(ge=1, le=10**6)] = 10000
    max_steps: Annotated[int, Field(ge=1, le=10**15)] | None = None
    max_minutes: Positive | None = None
    gamma: Fraction = 0.996
    lam: Fraction = 0.95
    clip: Positive = 0.2
    max_grad_norm: Positive = 0.5
    value_coefficient: NonNegative = 0.5
    entropy_coefficient: float = 0.0
    learning_rate: Positive = 5e-4
    adaptive_learning_rate: bool = True
    desired_kl: Positive = 0.01
    min_learning_rate: Positive = 1e-5
    max_learning_rate: Positive = 1e-2
    update_epochs: Count = 4
    minibatches: Count = 4
    shuffle: bool = True
    clipped_value_loss: bool = True
    normalise_returns: bool = False
    separate_clipping: bool = False
    advantages_per_minibatch: bool = False
    output_gain: Positive = 2.0**0.5
    hidden: Annotated[list[Annotated[int, Field(ge=1, le=10_000)]], Field(max_length=100)] = [128, 128]
    initial_std: Positive = 1.0
    min_std: NonNegative = 0.2
    threads: Annotated[int, Field(ge=1, le=1024)] = 1


class PoolConfig(Section):
    """Where the environments run.

    kind: "auto" takes threads of this process on MuJoCo (if its part in C was built), processes on PyBullet, and
    "serial" on MuJoCo Warp, which advances all environments together and refuses the other kinds. workers: null takes
    as many as there are cores. hang_s: seconds without a control step after which a worker process counts as hung and
    is replaced. For "ray" only: address of the cluster (auto, HOST:PORT; null starts one on this machine); patience: a
    worker is left behind once it takes this many times as long as the median of those that have finished.
    """

    kind: Literal["auto", "thread", "process", "serial", "ray"] = "auto"
    workers: Annotated[int, Field(ge=1, le=100_000)] | None = None
    hang_s: Annotated[float, Field(gt=0, le=1e6)] = 120.0
    address: str | None = None
    patience: Annotated[float, Field(ge=1)] = 3.0


class CheckpointConfig(Section):
    """Checkpoints: one every `every` epochs, the last `keep` are kept."""

    every: Count = 10
    keep: Count = 5


class EvalConfig(Section):
    """Periodic deterministic evaluation in training, the window of the stability test, and what a test measures.

    interpenetration: measure it in a test. mano: the MANO file that the hand was made from; interpenetration is then
    measured on its skin. Otherwise it is measured on the free hand's own skin, or else on the hand's part meshes or
    collision shapes.
    """

    every: Count = 25
    window_s: Positive = 5.0
    gif: bool = True
    interpenetration: bool = True
    mano: str | None = None
