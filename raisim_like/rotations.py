"""Rotations in batches: matrices (..., 3, 3), quaternions w, x, y, z, intrinsic XYZ Euler angles (rad)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


def matrix_from_euler(angles: Array) -> Array:
    """R = Rx(a) Ry(b) Rz(c) for intrinsic XYZ angles (..., 3)."""
    c, s = np.cos(angles), np.sin(angles)
    cx, cy, cz = c[..., 0], c[..., 1], c[..., 2]
    sx, sy, sz = s[..., 0], s[..., 1], s[..., 2]
    out = np.empty((*angles.shape, 3))
    out[..., 0, 0] = cy * cz
    out[..., 0, 1] = -cy * sz
    out[..., 0, 2] = sy
    out[..., 1, 0] = cx * sz + sx * sy * cz
    out[..., 1, 1] = cx * cz - sx * sy * sz
    out[..., 1, 2] = -sx * cy
    out[..., 2, 0] = sx * sz - cx * sy * cz
    out[..., 2, 1] = sx * cz + cx * sy * sz
    out[..., 2, 2] = cx * cy
    return out


def euler_from_matrix(R: Array) -> Array:
    """Intrinsic XYZ angles (..., 3) of matrices; at gimbal lock the third angle is 0."""
    sy = np.clip(R[..., 0, 2], -1.0, 1.0)
    locked = np.abs(sy) > 1.0 - 1e-12
    out = np.empty(R.shape[:-1])
    out[..., 1] = np.arcsin(sy)
    out[..., 0] = np.where(
        locked, np.arctan2(R[..., 2, 1], R[..., 1, 1]), np.arctan2(-R[..., 1, 2], R[..., 2, 2])
    )
    out[..., 2] = np.where(locked, 0.0, np.arctan2(-R[..., 0, 1], R[..., 0, 0]))
    return out


def matrix_from_quaternion(quaternion: Array) -> Array:
    """Matrices of quaternions (..., 4) w, x, y, z; the quaternions are normalised first."""
    q = quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True)
    w, x, y, z = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    out = np.empty((*q.shape[:-1], 3, 3))
    out[..., 0, 0] = 1 - 2 * (y * y + z * z)
    out[..., 0, 1] = 2 * (x * y - w * z)
    out[..., 0, 2] = 2 * (x * z + w * y)
    out[..., 1, 0] = 2 * (x * y + w * z)
    out[..., 1, 1] = 1 - 2 * (x * x + z * z)
    out[..., 1, 2] = 2 * (y * z - w * x)
    out[..., 2, 0] = 2 * (x * z - w * y)
    out[..., 2, 1] = 2 * (y * z + w * x)
    out[..., 2, 2] = 1 - 2 * (x * x + y * y)
    return out


def quaternion_from_matrix(R: Array) -> Array:
    """Unit quaternions (..., 4) w, x, y, z with w >= 0."""
    m = np.asarray(R, dtype=float)
    d = np.stack([m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]], axis=-1)
    trace = d.sum(axis=-1)
    # Four squared components; the largest one is the safe divisor (Shepperd's method).
    squares = np.stack([trace, *(2 * d[..., i] - trace for i in range(3))], axis=-1) + 1.0
    best = squares.argmax(axis=-1)
    candidates = np.empty((*m.shape[:-2], 4, 4))
    yz, zx, xy = m[..., 2, 1], m[..., 0, 2], m[..., 1, 0]
    zy, xz, yx = m[..., 1, 2], m[..., 2, 0], m[..., 0, 1]
    rows = (
        (squares[..., 0], yz - zy, zx - xz, xy - yx),
        (yz - zy, squares[..., 1], xy + yx, zx + xz),
        (zx - xz, xy + yx, squares[..., 2], yz + zy),
        (xy - yx, zx + xz, yz + zy, squares[..., 3]),
    )
    for i, row in enumerate(rows):
        candidates[..., i, :] = np.stack(row, axis=-1)
    q = np.take_along_axis(candidates, best[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.where(q[..., :1] < 0, -q, q)


def rotation_vector(R: Array) -> Array:
    """Rotation vectors (..., 3), axis times angle in [0, pi] rad, of matrices (..., 3, 3)."""
    q = quaternion_from_matrix(R)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    # As the rotation vanishes, the factor angle / sine tends to 2.
    factor = np.where(sine > 1e-12, 2.0 * np.arctan2(sine, q[..., :1]) / np.maximum(sine, 1e-12), 2.0)
    return np.asarray(factor * q[..., 1:])


def matrix_from_rotation_vector(vector: Array) -> Array:
    """Matrices (..., 3, 3) of rotation vectors (..., 3) rad."""
    angle = np.linalg.norm(vector, axis=-1, keepdims=True)
    # np.sinc(x) is sin(pi x) / (pi x), also at 0.
    half = 0.5 * np.sinc(angle / (2.0 * np.pi)) * vector
    return matrix_from_quaternion(np.concatenate([np.cos(0.5 * angle), half], axis=-1))


def rotate(R: Array, v: Array) -> Array:
    """R v for matrices (..., 3, 3) and vectors (..., 3)."""
    return np.matmul(R, v[..., None])[..., 0]


def rotate_back(R: Array, v: Array) -> Array:
    """R^T v for matrices (..., 3, 3) and vectors (..., 3)."""
    return np.matmul(np.swapaxes(R, -1, -2), v[..., None])[..., 0]


def transform(R: Array, t: Array) -> Array:
    """Homogeneous matrices (..., 4, 4) of rotations and translations."""
    out = np.zeros((*R.shape[:-2], 4, 4))
    out[..., :3, :3] = R
    out[..., :3, 3] = t
    out[..., 3, 3] = 1.0
    return out
