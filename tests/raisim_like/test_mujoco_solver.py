"""MuJoCo's sparse solver against its dense one: whether this version of MuJoCo can be used.

The engine relies on the sparse solver. On a version outside the range in pyproject.toml, run this file first.
"""

from __future__ import annotations

import numpy as np
import pytest

from dgrasp.types import Array
from raisim_like import World
from raisim_like.engines.mujoco.model import IMPEDANCE

mujoco = pytest.importorskip("mujoco")

FINGERS = 5
STEPS = 60


def _hand() -> str:
    """Fingers of three links each around a box, with armature and springs as the engine sets them."""
    drive = 'stiffness="5" damping="1" armature="0.003"'
    link = f'<joint axis="0 0 1" {drive}/><joint axis="0 1 0" {drive}/>'
    link += '<geom type="capsule" fromto="0 0 0 .03 0 0" size=".008"/>'
    chain = ""
    for offset in (0.03, 0.03, 0.0):
        chain = f'<body pos="{offset} 0 0">{link}{chain}</body>'
    fingers = ""
    for turn in np.linspace(0.0, 2.0 * np.pi, FINGERS, endpoint=False):
        fingers += (f'<body pos="{0.08 * np.cos(turn)} {0.08 * np.sin(turn)} 0" '
                    f'euler="0 0 {np.degrees(turn) + 180.0}">{chain}</body>')
    return f'''<mujoco><option timestep="0.00222" cone="elliptic" jacobian="JACOBIAN" tolerance="1e-8">
        <flag island="disable" eulerdamp="disable"/></option>
        <default><geom solref="0 {-1.0 / 0.00222}" solimp="{IMPEDANCE} {IMPEDANCE} 0.001 0.5 2" margin="1e-4" mass=".01"
            friction=".8"/></default>
        <worldbody><body><joint type="slide" axis="1 0 0" armature="1"/><joint type="slide" axis="0 0 1" armature="1"/>
        <inertial mass="0.1" pos="0 0 0" diaginertia="1e-4 1e-4 1e-4"/>{fingers}</body>
        <body><freejoint/><geom type="box" size=".03 .03 .05" mass=".3"/></body></worldbody></mujoco>'''


def _states(jacobian: str, correct: bool) -> tuple[Array, int]:
    """Coordinates over some steps in which the fingers close, and the largest number of contacts."""
    model = mujoco.MjModel.from_xml_string(_hand().replace("JACOBIAN", jacobian))
    data = mujoco.MjData(model)
    model.qpos_spring[:-7] = 0.3 * np.random.default_rng(0).normal(size=model.nq - 7)
    rows, contacts = [], 0
    for _ in range(STEPS):
        mujoco.mj_step1(model, data)
        if correct:
            first = data.contact.efc_address[data.contact.efc_address >= 0]
            speed = np.hypot(data.efc_vel[first + 1], data.efc_vel[first + 2])
            data.efc_aref[first] -= 0.8 * speed / model.opt.timestep
        mujoco.mj_step2(model, data)
        rows.append(data.qpos.copy())
        contacts = max(contacts, data.ncon)
    return np.array(rows), contacts


@pytest.mark.parametrize("correct", [False, True])
def test_sparse_and_dense_agree_where_many_fingers_touch(correct: bool) -> None:
    sparse, contacts = _states("sparse", correct)
    dense, _ = _states("dense", correct)
    assert contacts > 10
    assert sparse == pytest.approx(dense, abs=1e-9)


def test_a_stack_of_the_engines_own_world_agrees() -> None:
    ends = []
    for jacobian in (mujoco.mjtJacobian.mjJAC_SPARSE, mujoco.mjtJacobian.mjJAC_DENSE):
        world = World("mujoco")
        world.add_ground()
        boxes = [world.add_box(0.1, 0.1, 0.1, 0.5) for _ in range(3)]
        for k, box in enumerate(boxes):
            box.set_state((0.01 * k, 0.0, 0.05 + 0.1 * k), linear=(0.3, 0.0, 0.0))
        world.engine_world._ready().model.opt.jacobian = jacobian  # type: ignore[attr-defined]
        world.integrate(STEPS)
        ends.append(np.concatenate([box.state for box in boxes]))
    assert ends[0] == pytest.approx(ends[1], abs=1e-9)
