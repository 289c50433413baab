"""Meshes with volumes known in closed form."""

from __future__ import annotations

import numpy as np
import trimesh

from dgrasp.types import Array

Mesh = tuple[Array, Array]


def ball(radius: float, center: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Mesh:
    """A fine sphere: 0.1% less volume than the true one."""
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=radius)
    return np.asarray(mesh.vertices) + np.array(center), np.asarray(mesh.faces)


def box(size: tuple[float, float, float], center: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Mesh:
    mesh = trimesh.creation.box(size)
    return np.asarray(mesh.vertices) + np.array(center), np.asarray(mesh.faces)


def tube(radius: float, length: float, corners: int = 48) -> Mesh:
    """The wall of a prism along z, open at both ends: what a finger cut from a hand's skin looks like."""
    angle = 2 * np.pi * np.arange(corners) / corners
    ring = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    vertices = np.concatenate([np.column_stack([ring, np.full(corners, z)]) for z in (-length / 2, length / 2)])
    i = np.arange(corners)
    j = (i + 1) % corners
    faces = np.concatenate([np.stack([i, j, j + corners], axis=1), np.stack([i, j + corners, i + corners], axis=1)])
    return vertices, faces


def lens(radius: float, distance: float) -> float:
    """Volume shared by two balls whose centres are `distance` apart: two caps of height h = r - d / 2."""
    h = radius - distance / 2
    return 2 * np.pi * h * h * (radius - h / 3)


def moved(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Array:
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T
