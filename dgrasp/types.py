"""The data that flows through the system. All arrays are float64 unless said otherwise, SI units.

`T_AB` maps points of frame B into frame A. Frames: W world (z up), O object, H wrist, H0 the wrist at the
start of the episode, G the object at its target. Quaternions are w, x, y, z. Angles are intrinsic XYZ Euler
angles in radians.

Sizes of a hand (`dgrasp.hand.layout`): D generalised coordinates, the first six of them the wrist's; J finger joints; P
parts that can touch; K key points.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

Array = NDArray[Any]


@dataclass(frozen=True)
class StartPose:
    """Where hand and object are when the approach begins.

    T_WH, T_WO: (4, 4). hand_pose: (J,) rad.
    """

    T_WH: Array
    T_WO: Array
    hand_pose: Array


@dataclass(frozen=True)
class GraspLabel:
    """One static grasp, as a data source provides it (paper, section 3.1).

    object_id: catalogue name, such as "004_sugar_box".
    hand_pose: (J,) finger joint angles, rad.
    T_WH, T_WO: (4, 4) wrist and object in the world at the grasp.
    joints_W: (K, 3) key points in the world, m; the first is the wrist.
    goal_contacts: (P,) bool, which parts should touch the object.
    start: the start of the approach; None if the source has only the static grasp; the scene then
        makes one.
    hand: id of the hand that the label was made for ("mano_mean", "free"); other hands refuse it.
    source, index: where the label comes from ("dexycb_train_labels.pkl", "free"), and its number there;
        `index` counts within the object.
    on_table: whether the label knows the table; its world then has the table at z = 0.5 m.
    """

    object_id: str
    hand_pose: Array
    T_WH: Array
    T_WO: Array
    joints_W: Array
    goal_contacts: Array
    start: StartPose | None
    hand: str
    source: str
    index: int
    on_table: bool = True

    @property
    def name(self) -> str:
        """Short unique name for messages: source, object and index."""
        return f"{self.source}:{self.object_id}[{self.index}]"


@dataclass(frozen=True)
class GraspGoal:
    """The goals of N environments in their objects' frames (supplement, section A.1).

    joints_O: (N, K, 3). R_OH: (N, 3, 3). hand_pose: (N, J). goal_contacts: (N, P) float, 0 or 1.
    wrist_euler_O: (N, 3), Euler angles of R_OH.
    """

    joints_O: Array
    R_OH: Array
    hand_pose: Array
    goal_contacts: Array
    wrist_euler_O: Array


@dataclass
class SceneState:
    """The physical state of N environments after a control step.

    gc, gv: (N, D) generalised coordinates and velocities; the first six are relative to the initial
        wrist frame H0 (m, rad as Euler angles; m/s, rad/s as their rates).
    R_WH0 (N, 3, 3), wrist_start_W (N, 3): the initial wrist frame.
    R_WH (N, 3, 3), joints_W (N, K, 3): wrist rotation and key points; joints_W[:, 0] is the wrist.
    R_WO (N, 3, 3), object_pos_W (N, 3), object_linvel_W, object_angvel_W (N, 3).
    contacts (N, P) float 0 or 1; contact_impulse (N, P), N s per substep, hand parts against the object.
    object_start_W (N, 3): position of the object at the start. table_height_W (N,).
    object_mass (N,) kg. table_contact (N,) bool: the object touches the table.
    table_gone (N,): 1 once the table has been removed. holding (N,): 1 while the table is gone and the object has
        not dropped. episode_time (N,): share of the episode that has passed.
    R_WG (N, 3, 3), target_pos_W (N, 3): the target pose of the object, T_g; until a motion begins, its start pose.
    """

    gc: Array
    gv: Array
    R_WH0: Array
    wrist_start_W: Array
    R_WH: Array
    joints_W: Array
    R_WO: Array
    object_pos_W: Array
    object_linvel_W: Array
    object_angvel_W: Array
    contacts: Array
    contact_impulse: Array
    object_start_W: Array
    table_height_W: Array
    object_mass: Array
    table_contact: Array
    table_gone: Array
    holding: Array
    episode_time: Array
    R_WG: Array
    target_pos_W: Array


@dataclass
class EpisodeRecord:
    """One evaluated episode of T control steps, as the metrics and the report read it.

    label: the grasp label. gc (T, D), T_WH (T, 4, 4), joints_W (T, K, 3), T_WO (T, 4, 4),
    contacts (T, P), contact_impulse (T, P) N s per substep, table_contact (T,) bool: states after each
    control step. window_start: index of the first step after the grasp. In this step the table is removed or, if
    `table_stays`, the motion of the object begins. 0 if the episode begins without a table.
    dt: control period in s. terminated: why the episode ended early ("" if it did not).
    reward: (T,). T_WG: (T, 4, 4) target pose of the object after each control step, in episodes that move it; else
    None. Raises `ValueError` for a T_WG of another shape.
    """

    label: GraspLabel
    gc: Array
    T_WH: Array
    joints_W: Array
    T_WO: Array
    contacts: Array
    contact_impulse: Array
    table_contact: Array
    reward: Array
    window_start: int
    dt: float
    terminated: str = ""
    T_WG: Array | None = None

    def __post_init__(self) -> None:
        expected = (len(self.T_WO), 4, 4)
        if self.T_WG is not None and self.T_WG.shape != expected:
            raise ValueError(f"{self.label.name}: T_WG has shape {self.T_WG.shape}; expected {expected}")

    @property
    def table_stays(self) -> bool:
        """Whether the table is never removed, as in a motion that begins with a grasp."""
        return self.T_WG is not None and self.window_start > 0
