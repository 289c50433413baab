"""Worlds that the tests of MuJoCo Warp share: a machine of two joints, blocks and balls."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from raisim_like import Shape, UrdfModel, read_urdf
from raisim_like.batch import Array, BatchState, BodySpec, Preset, SystemSpec, WorldBatch, WorldSpec
from raisim_like.material import MaterialTable
from raisim_like.registry import make_batch
from raisim_like.rotations import matrix_from_rotation_vector, quaternion_from_matrix
from raisim_like.world import BODY, STATIC, SYSTEM, collision_mask

DT, G, FRICTION = 0.00222, 9.81, 0.5
GROUND, LOW, HIGH, FIRST, SECOND = range(5)
PLATE, ARM = range(2)
ANY = STATIC | BODY | SYSTEM
MACHINE = """
<robot name="machine"><link name="base"/>
<link name="plate"><inertial><mass value="1"/></inertial>
  <collision><geometry><box size="1 1 0.1"/></geometry></collision></link>
<joint name="lift" type="prismatic"><parent link="base"/><child link="plate"/><axis xyz="0 0 1"/>
  <limit lower="-1" upper="1"/></joint>
<link name="arm"><inertial><origin xyz="0.2 0 0"/><mass value="0.3"/></inertial></link>
<joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><origin xyz="2 0 0"/><axis xyz="0 1 0"/>
  <limit lower="-3" upper="3"/><dynamics damping="0.5"/></joint>
</robot>"""


def read_machine(folder: Path) -> UrdfModel:
    """A plate that moves up and down, and a weight of 0.3 kg on an arm of 0.2 m that turns about y."""
    path = folder / "machine.urdf"
    path.write_text(MACHINE, encoding="utf-8")
    return read_urdf(path)


def world_spec(
    machine: UrdfModel, gravity: float = G, preset: Preset = "faithful", mass: float = 1.0, height: float = 0.06
) -> WorldSpec:
    """The machine, the ground, two blocks of `mass` and 2 kg, and two balls of 1 and 2.5 kg."""

    def body(shape: Shape, kg: float, moment: float) -> BodySpec:
        mask = collision_mask(BODY if kg else STATIC, ANY)
        return BodySpec((shape,), kg, moment * np.eye(3), np.zeros(3), "any", mask)

    block, ball = Shape("box", (0.3, 0.3, height)), Shape("sphere", (0.05,))
    bodies = (
        body(Shape("box", (4.0, 4.0, 1.0)), 0.0, 1.0), body(block, mass, 0.008 * mass), body(block, 2.0, 0.016),
        body(ball, 1.0, 0.4 * 0.05**2), body(ball, 2.5, 2.5 * 0.4 * 0.05**2),
    )  # fmt: skip
    system = SystemSpec(machine, "any", collision_mask(SYSTEM, ANY), enforce_limits=False)
    return WorldSpec((system,), bodies, DT, preset, (0.0, 0.0, -gravity), MaterialTable(FRICTION))


class Start:
    """Where everything is at first: out of each other's way, except for what `states` says by body."""

    def __init__(self, states: dict[int, Sequence[float]] | None = None) -> None:
        self.bodies = np.zeros((5, 13))
        self.bodies[:, 0], self.bodies[:, 2:4] = [0, 3, 4, 5, 6], [7.0, 1.0]
        self.bodies[GROUND, 2] = -0.5
        for body, state in (states or {}).items():
            self.bodies[body, : len(state)] = state
        self.base = np.array([[0.0, 15.0, 0.0, 1.0, 0.0, 0.0, 0.0]])


def begin(batch: WorldBatch, rows: Sequence[int], starts: Sequence[Start], kp: float = 5000.0) -> None:
    """Place worlds and set their gains."""
    n = len(rows)
    batch.place(rows, np.array([s.base for s in starts]), np.zeros((n, 2)), np.array([s.bodies for s in starts]))
    batch.set_gains(rows, np.tile([kp, 50.0], (n, 1)), np.tile([100.0, 0.2], (n, 1)), np.zeros((n, 2)))


def make(specs: Sequence[WorldSpec], starts: Sequence[Start], engine: str = "warp") -> WorldBatch:
    """A batch with everything placed."""
    n = len(specs)
    batch = make_batch(engine, specs, BatchState(np.zeros((n, 2)), np.zeros((n, 2)), np.zeros((n, 5, 13))))
    begin(batch, range(n), starts)
    return batch


def advance(batch: WorldBatch, steps: int, substeps: int = 1, rows: Sequence[int] | None = None) -> None:
    n = len(batch.state.gc)
    for _ in range(steps):
        batch.advance(range(n) if rows is None else rows, np.zeros((n, 2)), substeps)


def everything(batch: WorldBatch, rows: Sequence[int] | slice = slice(None)) -> Array:
    """(R, 4 + 65): the states of rows in one array."""
    state = batch.state
    return np.concatenate([state.gc[rows], state.gv[rows], state.bodies[rows].reshape(len(state.gc[rows]), -1)], axis=1)


def tilted(tangent: float) -> tuple[Array, Start]:
    """A plane that falls towards +x with a block on it, and the plane's rotation."""
    R = matrix_from_rotation_vector(np.array([0.0, np.arctan(tangent), 0.0]))
    turn = quaternion_from_matrix(R)
    return R, Start({GROUND: [*R @ [0, 0, -0.5], *turn], LOW: [*R @ [0, 0, 0.03], *turn]})


def busy(k: int) -> Start:
    """A start of world k in which much happens: a block slides, another falls onto the plate, balls collide."""
    return Start({
        LOW: [0, 0, 0.03, 1, 0, 0, 0, 0.5 + 0.1 * k], HIGH: [0, 15, 0.15 + 0.01 * k, 1],
        FIRST: [0, 2, 0.05, 1, 0, 0, 0, 1], SECOND: [0.2, 2.01, 0.05, 1],
    })  # fmt: skip
