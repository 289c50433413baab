"""Make bodies and articulated systems in a PyBullet client, without Bullet's default damping."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Sequence
from itertools import permutations
from typing import Any

from raisim_like.engines.body_frame import BodyFrame
from raisim_like.engines.bullet.quiet_pybullet import pybullet as p
from raisim_like.engines.bullet.rest import ends, may_roll
from raisim_like.engines.bullet.shapes import SHAPE_TYPES, collision_filter, geometry, xyzw
from raisim_like.engines.bullet.urdf import compound_urdf, normalised_urdf
from raisim_like.errors import EngineError
from raisim_like.mimic import Mimic
from raisim_like.rotations import quaternion_from_matrix
from raisim_like.shapes import Shape
from raisim_like.urdf import UrdfModel

TIED_ERP = 1e-6
"""Error reduction of the joints in a world with joints that follow others. Bullet multiplies it by that of each gear.
The product is 1, so a gear removes its error within one step; joints at their limits hardly notice 1e-6."""
FIRM = 1e6
"""N m or N. Largest force of a gear; it is never reached."""


def make_body(client: int, shapes: Sequence[Shape], mass: float, frame: BodyFrame, collision_mask: int) -> int:
    """Make a rigid body whose Bullet frame is the inertial frame of `frame`; mass 0 makes it static. Returns its id."""
    if not shapes:
        raise EngineError("a body needs at least one shape")
    for shape in shapes:
        if shape.kind in ("mesh", "hull") and (shape.file is None or not shape.file.is_file()):
            raise EngineError(f"mesh file {shape.file} does not exist")
    rolls = may_roll(shapes, mass, frame)
    if len(shapes) == 1 and not rolls and (mass > 0 or shapes[0].kind != "box"):
        uid = p.createMultiBody(
            baseMass=float(mass),
            baseCollisionShapeIndex=_collision_shape(client, shapes[0]),
            baseInertialFramePosition=[float(v) for v in frame.com],
            baseInertialFrameOrientation=xyzw(quaternion_from_matrix(frame.axes)),
            physicsClientId=client,
        )
    else:
        # Load a URDF, because PyBullet's arrays of shapes silently overflow beyond 16 parts.
        flags = p.URDF_USE_INERTIA_FROM_FILE
        if rolls or mass == 0:
            # Hulls and boxes then get all points of a contact at once, and cylinders stay round.
            flags |= p.URDF_INITIALIZE_SAT_FEATURES | p.URDF_USE_IMPLICIT_CYLINDER
        more = list(ends(shapes)) if rolls else []
        text = compound_urdf(shapes, mass, frame.com, frame.axes, more)
        uid = _load(client, text, flags, fixed=False)
    if uid < 0:
        raise EngineError("PyBullet refused the body")
    if mass > 0:
        _undamp(client, uid, -1, localInertiaDiagonal=[float(v) for v in frame.moments])
    for link in range(-1, p.getNumJoints(uid, physicsClientId=client)):
        p.setCollisionFilterGroupMask(uid, link, *collision_filter(collision_mask), physicsClientId=client)
    return int(uid)


def keep_ends_apart(client: int, moving: Iterable[int]) -> None:
    """Switch off contacts between the ends of round bodies and everything that moves (`rest`)."""
    links = {uid: p.getNumJoints(uid, physicsClientId=client) for uid in moving}
    for uid, other in permutations(links, 2):
        # A rigid body with ends has them as its one link.
        if links[uid] == 1 and p.getJointInfo(uid, 0, physicsClientId=client)[2] == p.JOINT_FIXED:
            for link in range(-1, links[other]):
                p.setCollisionFilterPair(uid, other, 0, link, 0, physicsClientId=client)


def make_articulated(
    client: int, model: UrdfModel, collision_mask: int, self_collision: bool, enforce_limits: bool
) -> int:
    """Make an articulated system on a fixed base, with its links in the order of `model`. Returns its id."""
    flags = p.URDF_USE_INERTIA_FROM_FILE
    if self_collision:
        flags |= p.URDF_USE_SELF_COLLISION | p.URDF_USE_SELF_COLLISION_EXCLUDE_ALL_PARENTS
    uid = _load(client, normalised_urdf(model, enforce_limits), flags, fixed=True)
    joints = range(p.getNumJoints(uid, physicsClientId=client))
    names = [p.getJointInfo(uid, i, physicsClientId=client)[1].decode() for i in joints]
    if names != list(model.joint_names):
        raise EngineError(f"PyBullet ordered the joints of {model.path} as {names}")
    for link in range(-1, model.dof):
        _undamp(client, uid, link, jointDamping=0.0)
        p.setCollisionFilterGroupMask(uid, link, *collision_filter(collision_mask), physicsClientId=client)
    for i, made in enumerate(model.links):
        if made.mimic is not None:
            _tie(client, uid, i, made.mimic)
    return uid


def _tie(client: int, uid: int, joint: int, mimic: Mimic) -> None:
    """Tie a joint to its leader by a gear."""
    gear = p.createConstraint(
        uid, joint, uid, mimic.leader, p.JOINT_GEAR, [0, 0, 0], [0, 0, 0], [0, 0, 0], physicsClientId=client
    )
    p.changeConstraint(
        gear, gearRatio=-mimic.multiplier, relativePositionTarget=mimic.offset, erp=1.0 / TIED_ERP, maxForce=FIRM,
        physicsClientId=client,
    )  # fmt: skip


def _undamp(client: int, uid: int, link: int, **also: Any) -> None:
    p.changeDynamics(
        uid,
        link,
        linearDamping=0.0,
        angularDamping=0.0,
        rollingFriction=0.0,
        spinningFriction=0.0,
        restitution=0.0,
        activationState=p.ACTIVATION_STATE_DISABLE_SLEEPING,
        physicsClientId=client,
        **also,
    )


def _collision_shape(client: int, shape: Shape) -> int:
    try:
        index = p.createCollisionShape(
            SHAPE_TYPES[shape.kind],
            collisionFramePosition=list(shape.position),
            collisionFrameOrientation=xyzw(shape.quaternion),
            physicsClientId=client,
            **geometry(shape),
        )
    except p.error as error:
        raise EngineError(f"PyBullet refused the collision shape {shape}: {error}") from None
    if index < 0:
        raise EngineError(f"PyBullet refused the collision shape {shape}")
    return int(index)


def _load(client: int, text: str, flags: int, fixed: bool) -> int:
    """Load a URDF given as text; no file remains."""
    handle, path = tempfile.mkstemp(suffix=".urdf")
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as stream:
            stream.write(text)
        return int(p.loadURDF(path, useFixedBase=int(fixed), flags=flags, physicsClientId=client))
    except p.error as error:
        raise EngineError(f"PyBullet could not load a body: {error}") from None
    finally:
        os.unlink(path)
