"""Draws triangles in software, in NumPy alone: pictures need no display, no GL and no physics engine."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dgrasp.types import Array

FIELD_OF_VIEW = np.deg2rad(40.0)
"""rad, vertical."""
SAMPLES = 2
"""Per pixel and side. Their mean smooths the edges."""
NEAR = 0.02
"""m. Triangles that come closer to the camera are left out."""
CREASE = np.cos(np.deg2rad(40.0))
"""Faces that meet at a smaller angle are shaded as one curved surface."""
LIGHT = np.array([0.32, -0.42, 0.85]) / np.linalg.norm([0.32, -0.42, 0.85])
"""Towards the light, world."""
BACKGROUND = np.array([0.955, 0.96, 0.965])
SHADOW = 0.72
"""How much of the floor's colour is left in the shadow."""


class Shaded(NamedTuple):
    """vertices (V, 3) m and normals (F, 3, 3) of the faces' corners, in one frame; faces (F, 3); color (3,)."""

    vertices: Array
    faces: Array
    normals: Array
    color: Array

    def placed(self, R: Array, t: Array) -> Shaded:
        """The same in the frame that R (3, 3) and t (3,), m, lead to."""
        return self._replace(vertices=self.vertices @ R.T + t, normals=self.normals @ R.T)


def shaded(vertices: Array, faces: Array, color: Sequence[float]) -> Shaded:
    """Triangles that are shaded as curved surfaces where they meet without a crease."""
    return Shaded(vertices, faces, _corner_normals(vertices, faces), np.array(color))


class Floor(NamedTuple):
    """A horizontal rectangle: its lowest and highest corner (2, 2), m, its height, m, and its color (3,)."""

    corners: Array
    height: float
    color: Array


class Camera:
    """A pinhole camera at `eye` (3,) that looks towards `target` (3,), m, world. size: (width, height), pixels."""

    def __init__(self, eye: Array, target: Array, size: tuple[int, int]) -> None:
        self.eye = np.asarray(eye, dtype=float)
        self.width, self.height = SAMPLES * size[0], SAMPLES * size[1]
        ahead = target - self.eye
        ahead = ahead / np.linalg.norm(ahead)
        right = np.cross(ahead, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        self.R = np.stack([right, -np.cross(right, ahead), ahead])
        """Rows are the picture's x, its y (downwards) and the depth."""
        self.focal = self.height / (2.0 * np.tan(FIELD_OF_VIEW / 2.0))
        self._floors: dict[bytes, tuple[Array, Array]] = {}

    def project(self, points: Array) -> tuple[Array, Array]:
        """Places (..., 2) in samples and inverse depths (...,) 1/m of points (..., 3) m, world."""
        seen = (points - self.eye) @ self.R.T
        nearness = 1.0 / np.maximum(seen[..., 2], 1e-6)
        center = np.array([self.width, self.height]) / 2.0
        return center + self.focal * seen[..., :2] * nearness[..., None], nearness

    def floor(self, floor: Floor) -> tuple[Array, Array]:
        """The samples that see a floor, and their inverse depths there, 1/m. A camera finds them once."""
        key = np.append(floor.corners, floor.height).tobytes()
        if key not in self._floors:
            x = (np.arange(self.width) + 0.5 - self.width / 2.0) / self.focal
            y = (np.arange(self.height) + 0.5 - self.height / 2.0) / self.focal
            rays = (x[None, :, None] * self.R[0] + y[:, None, None] * self.R[1] + self.R[2]).reshape(-1, 3)
            with np.errstate(divide="ignore", invalid="ignore"):
                depth = (floor.height - self.eye[2]) / rays[:, 2]
                place = self.eye[:2] + depth[:, None] * rays[:, :2]
                low, high = floor.corners
                seen = (depth > NEAR) & (place >= low).all(axis=1) & (place <= high).all(axis=1)
            self._floors[key] = np.flatnonzero(seen), 1.0 / depth[seen]
        return self._floors[key]


def _corner_normals(vertices: Array, faces: Array) -> Array:
    """(F, 3, 3) unit normals of the faces' corners: means over the faces that meet there without a crease."""
    corners = vertices[faces]
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat = areas / np.maximum(np.linalg.norm(areas, axis=1, keepdims=True), 1e-30)
    order = np.argsort(faces.reshape(-1), kind="stable")
    owner = faces.reshape(-1)[order]
    first = np.searchsorted(owner, owner, side="left")
    count = np.searchsorted(owner, owner, side="right") - first
    corner = np.repeat(np.arange(len(order)), count)
    other = np.arange(len(corner)) - np.repeat(np.cumsum(count) - count, count) + first[corner]
    mine, theirs = order[corner] // 3, order[other] // 3
    joined = (flat[mine] * flat[theirs]).sum(axis=1) >= CREASE
    total = np.zeros((3 * len(faces), 3))
    np.add.at(total, order[corner][joined], areas[theirs[joined]])
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.where(length > 0.0, total / np.maximum(length, 1e-30), 0.0).reshape(-1, 3, 3)


def draw(solids: Sequence[Shaded], camera: Camera, floor: Floor | None = None) -> Array:
    """(height, width, 3) uint8: the solids, over the floor with their shadows on it."""
    colors = np.broadcast_to(BACKGROUND, (camera.height * camera.width, 3)).copy()
    nearness = np.zeros(len(colors))
    if floor is not None:
        _draw_floor(floor, solids, camera, colors, nearness)
    for solid in solids:
        _draw_solid(solid, camera, colors, nearness)
    samples = colors.reshape(camera.height, camera.width, 3)
    total = sum(samples[i::SAMPLES, k::SAMPLES] for i in range(SAMPLES) for k in range(SAMPLES))
    return np.asarray(np.rint((255.0 / SAMPLES**2) * total).clip(0.0, 255.0), dtype=np.uint8)


def _draw_floor(floor: Floor, solids: Sequence[Shaded], camera: Camera, colors: Array, nearness: Array) -> None:
    seen, inverse = camera.floor(floor)
    colors[seen], nearness[seen] = floor.color, inverse
    for solid in solids:
        rise = np.maximum(solid.vertices[:, 2:] - floor.height, 0.0)
        xy, near = camera.project(solid.vertices - rise * LIGHT / LIGHT[2])
        _, sample, _ = _covered(xy[solid.faces], near[solid.faces], camera)
        colors[sample[nearness[sample] > 0.0]] = SHADOW * floor.color


def _draw_solid(solid: Shaded, camera: Camera, colors: Array, nearness: Array) -> None:
    xy, near = camera.project(solid.vertices)
    face, sample, weights = _covered(xy[solid.faces], near[solid.faces], camera)
    inverse = (weights * near[solid.faces][face]).sum(axis=1)
    np.maximum.at(nearness, sample, inverse)
    front = inverse >= nearness[sample]
    face, sample, weights = face[front], sample[front], weights[front]
    # On the picture, what is linear is a value over its depth, not the value; a part is too small to show the error.
    normal = sum(weights[:, i, None] * solid.normals[:, i][face] for i in range(3))
    normal /= np.maximum(np.sqrt((normal * normal).sum(axis=1, keepdims=True)), 1e-9)
    away = camera.R[2]
    normal[normal @ away > 0.25] *= -1.0
    lit = np.maximum(normal @ LIGHT, 0.0)
    sheen = np.maximum(normal @ _halfway(away), 0.0) ** 40
    light = 0.5 + 0.13 * normal[:, 2] + 0.45 * lit
    colors[sample] = light[:, None] * solid.color + 0.08 * sheen[:, None]


def _halfway(away: Array) -> Array:
    middle = LIGHT - away
    return np.asarray(middle / np.linalg.norm(middle))


def _covered(corners: Array, near: Array, camera: Camera) -> tuple[Array, Array, Array]:
    """The samples that triangles cover: triangle (N,), sample (N,) and barycentric weights (N, 3).

    corners: (F, 3, 2), samples. near: their inverse depths (F, 3).
    """
    size = np.array([camera.width, camera.height])
    low = np.clip(np.ceil(corners.min(axis=1) - 0.5), 0, size).astype(np.int64)
    high = np.clip(np.floor(corners.max(axis=1) - 0.5) + 1.0, 0, size).astype(np.int64)
    (ax, ay), (bx, by), (cx, cy) = corners[:, 0].T, (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T
    area = bx * cy - by * cx
    rows = np.maximum(high[:, 1] - low[:, 1], 0)
    rows[(near > 1.0 / NEAR).any(axis=1) | (area == 0.0)] = 0
    face, y = _ranges(low[:, 1], rows)
    left, right = _spans(corners[face], y + 0.5)
    first = np.clip(left, low[face, 0], high[face, 0]).astype(np.int64)
    row, x = _ranges(first, np.clip(right, first, high[face, 0]).astype(np.int64) - first)
    # What depends on the row alone is computed once a row.
    down, turn = y + 0.5 - ay[face], 1.0 / area[face]
    across = x + 0.5 - ax[face][row]
    v = (across * cy[face][row] - (down * cx[face])[row]) * turn[row]
    w = ((bx[face] * down)[row] - by[face][row] * across) * turn[row]
    inside = (v >= 0.0) & (w >= 0.0) & (v + w <= 1.0)
    row, x, v, w = row[inside], x[inside], v[inside], w[inside]
    return face[row], y[row] * camera.width + x, np.stack([1.0 - v - w, v, w], axis=1)


def _ranges(first: Array, counts: Array) -> tuple[Array, Array]:
    """The numbers first, first + 1, ... of ranges (N,) with so many each: the range (M,) and the number (M,)."""
    owner = np.repeat(np.arange(len(counts)), counts)
    return owner, np.arange(len(owner)) + (first + counts - np.cumsum(counts))[owner]


def _spans(corners: Array, y: Array) -> tuple[Array, Array]:
    """First sample (N,) and the one behind the last (N,) in which triangles (N, 3, 2) can cover the line y (N,).

    One more on each side, because the sides' places are rounded.
    """
    sides = np.roll(corners, -1, axis=1) - corners
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (y[:, None] - corners[..., 1]) / sides[..., 1]
        place = corners[..., 0] + share * sides[..., 0]
    crossed = (share >= -1e-9) & (share <= 1.0 + 1e-9)
    left = np.where(crossed, place, np.inf).min(axis=1, initial=np.inf)
    right = np.where(crossed, place, -np.inf).max(axis=1, initial=-np.inf)
    return np.ceil(left - 0.5) - 1.0, np.floor(right - 0.5) + 2.0
