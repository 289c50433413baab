"""Test whether a recorded grasp could carry its object: one that touches too little of it, or the wrong end, cannot."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dgrasp.config.sections import PhysicsConfig
from dgrasp.geometry.equilibrium import holds_weight
from dgrasp.geometry.inside import inside_hull
from dgrasp.geometry.intersection import Body
from dgrasp.hand.model import HandModel
from dgrasp.hand.spheres import HandSpheres
from dgrasp.types import Array, GraspLabel

REACH = 0.010
"""m. A part this near to the object counts as in contact, because recorded hands do not touch the object everywhere
where they hold it."""
_SAMPLES = 8000
_CONTACTS = 200
"""Most samples near the hand, evenly drawn, at which friction cones are placed."""


class Carrying:
    """The weight test of one hand's labels.

    objects: surfaces, each in the object's frame. centers: (3,) m, centres of mass in the same frames.
    """

    def __init__(self, hand: HandModel, objects: Mapping[str, Body], centers: Mapping[str, Array]) -> None:
        self._hand, self._spheres = hand, HandSpheres.of_hand(hand)
        self._cores = _cores(self._spheres)
        self._centers = centers
        self._surfaces = {name: _samples(body) for name, body in objects.items()}

    def carries(self, label: GraspLabel) -> bool:
        """Whether forces where the hand is inside the object, or within `REACH` of it, can balance its weight."""
        points, normals = self._surfaces[label.object_id]
        R, t = self._hand.part_poses(label.T_WH[None], label.hand_pose[None])
        centers_O, cores_O = (
            (places[0] - label.T_WO[:3, 3]) @ label.T_WO[:3, :3]
            for places in (self._spheres.place(R, t), self._cores.place(R, t))
        )
        gaps, nearest = _gaps(points, centers_O, self._spheres.radii)
        # A finger outside a thin wall does not touch the wall's inner side.
        facing = np.einsum("pi,pi->p", cores_O[nearest] - points, normals) > 0.0
        near = np.flatnonzero(self._pressed(points, centers_O, gaps) | (facing & (gaps < REACH)))
        near = near[np.linspace(0, len(near) - 1, min(len(near), _CONTACTS)).astype(int)]
        return holds_weight(
            points[near], normals[near], self._centers[label.object_id], label.T_WO[2, :3], PhysicsConfig().friction
        )


    def _pressed(self, points: Array, centers_O: Array, gaps: Array) -> Array:
        """(P,) bool: the points of the surface that are inside the hand."""
        inside = gaps < 0.0
        for part in np.unique(self._spheres.parts):
            # The points of boxes and hulls have no radius, but the space between them is part of the hand.
            own = centers_O[(self._spheres.parts == part) & (self._spheres.radii == 0.0)]
            if len(own) > 3:
                inside |= inside_hull(own, points)
        return inside


def _samples(body: Body) -> tuple[Array, Array]:
    """Points (P, 3) all over the surface, and its outward normals (P, 3) there."""
    import trimesh  # Imported late: it takes a second.

    vertices, faces = body.surface()
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    points, rows = trimesh.sample.sample_surface(mesh, _SAMPLES, seed=0)
    return np.asarray(points), np.asarray(mesh.face_normals)[rows]


def _cores(spheres: HandSpheres) -> HandSpheres:
    """Spheres moved to the middle of their shapes: points of boxes and hulls to the mean of those of their part."""
    centers = spheres.centers.copy()
    for part in np.unique(spheres.parts):
        own = (spheres.parts == part) & (spheres.radii == 0.0)
        if own.any():
            centers[own] = centers[own].mean(axis=0)
    return HandSpheres(centers, spheres.radii, spheres.parts, spheres.n_parts)


def _gaps(points: Array, centers: Array, radii: Array) -> tuple[Array, Array]:
    """(P,) m from points to the nearest sphere, negative inside it, inf beyond `REACH`; and (P,) the sphere's index."""
    from scipy.spatial import cKDTree

    gaps, nearest = np.full(len(points), np.inf), np.zeros(len(points), int)
    for radius in np.unique(radii):
        own = np.flatnonzero(radii == radius)
        distance, found = cKDTree(centers[own]).query(points, distance_upper_bound=radius + REACH)
        closer = np.flatnonzero(distance - radius < gaps)
        gaps[closer], nearest[closer] = distance[closer] - radius, own[found[closer]]
    return gaps, nearest
