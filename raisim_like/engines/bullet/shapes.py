"""Shapes, orientations and collision filters in PyBullet's terms."""

from __future__ import annotations

from typing import Any

from raisim_like.engines.bullet.quiet_pybullet import pybullet as p
from raisim_like.shapes import Shape

SHAPE_TYPES = {
    "box": p.GEOM_BOX,
    "cylinder": p.GEOM_CYLINDER,
    "sphere": p.GEOM_SPHERE,
    "capsule": p.GEOM_CAPSULE,
    "mesh": p.GEOM_MESH,
    "hull": p.GEOM_MESH,
}


def xyzw(quaternion: Any) -> list[float]:
    """A quaternion w, x, y, z in PyBullet's order x, y, z, w."""
    w, x, y, z = (float(v) for v in quaternion)
    return [x, y, z, w]


def collision_filter(mask: int) -> tuple[int, int]:
    """Bullet's (group, mask): two bodies collide when each one's group is in the other's mask."""
    return mask & 0xFF, mask >> 8


def geometry(shape: Shape) -> dict[str, Any]:
    """Arguments of `createCollisionShape` for a shape: half extents, radius and height in m, or the mesh file."""
    if shape.kind == "box":
        return {"halfExtents": [v / 2 for v in shape.size]}
    if shape.kind == "sphere":
        return {"radius": shape.size[0]}
    if shape.kind in ("cylinder", "capsule"):
        return {"radius": shape.size[0], "height": shape.size[1]}
    flags = p.GEOM_FORCE_CONCAVE_TRIMESH if shape.kind == "mesh" else 0
    return {"fileName": str(shape.file), "flags": flags, "meshScale": list(shape.scale)}
