"""Checks for label files of every format. Each failure is one `DataError` that names the place."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from dgrasp.errors import DataError
from dgrasp.types import Array

MAX_POSITION = 10.0
"""m. A position beyond it is taken to be in another unit."""

MAX_ANGLE = 2.0 * np.pi
"""rad. An angle beyond it is taken to be in degrees."""

QUATERNION_TOLERANCE = 1e-3
ROTATION_TOLERANCE = 1e-6
WRIST_TOLERANCE = 1e-3
"""m, between the wrist's position and the wrist key point of one label."""

Where = Callable[[int], str]
"""Gives the text for messages that names a row: file, object and index."""


def require(ok: Array, where: Where, problem: str, remedy: str) -> None:
    """Raise `DataError` for the first row of `ok` (n,) that is False: its place, the problem, and the remedy."""
    bad = np.flatnonzero(~ok)
    if bad.size:
        more = f" ({bad.size} labels have this problem)" if bad.size > 1 else ""
        raise DataError(f"{where(int(bad[0]))}: {problem}{more}; {remedy}")


def _all(ok: Array) -> Array:
    """(n,) from (n, ...): whether every entry of the row is True."""
    return np.asarray(ok.reshape(len(ok), -1).all(axis=1))


def as_rows(value: object, name: str, width: Sequence[int], where: str) -> Array:
    """`value` as float64 (n, *width). Raises `DataError` unless it is a plain numeric array of that shape."""
    expected = f"expected an array of numbers of shape (labels, {', '.join(str(n) for n in width)})"
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "biuf":
        kind = f"an array of {value.dtype}" if isinstance(value, np.ndarray) else f"a {type(value).__name__}"
        raise DataError(f"{where}: {name} is {kind}; {expected}")
    if value.ndim != 1 + len(width) or value.shape[1:] != tuple(width):
        raise DataError(f"{where}: {name} has shape {value.shape}; {expected}")
    return value.astype(np.float64)


def check_finite(rows: Array, name: str, where: Where) -> None:
    """Check that (n, ...) holds no NaN and no infinity."""
    require(_all(np.isfinite(rows)), where, f"{name} holds NaN or infinity; expected finite numbers",
            "remove this label or repair the file at its source")


def check_positions(rows: Array, name: str, where: Where) -> None:
    """Check that all coordinates of (n, ...) are within `MAX_POSITION` of the origin."""
    require(_all(np.abs(rows) <= MAX_POSITION), where,
            f"{name} lies beyond {MAX_POSITION:g} m, as millimetres would; expected metres",
            "convert the file to metres (millimetres: multiply by 0.001)")


def check_angles(rows: Array, name: str, where: Where) -> None:
    """Check that all angles of (n, ...) are within `MAX_ANGLE`."""
    require(_all(np.abs(rows) <= MAX_ANGLE), where,
            f"{name} has an angle beyond 2 pi, as degrees would; expected radians",
            "convert the file to radians (degrees: multiply by pi / 180)")


def check_contacts(rows: Array, name: str, where: Where) -> Array:
    """The contacts (n, 16) as bool. Only 0 and 1 are accepted."""
    require(_all((rows == 0) | (rows == 1)), where, f"{name} has a value other than 0 and 1; expected 0 or 1",
            "threshold the contacts at their source")
    return rows.astype(bool)


def check_wrist_keypoint(wrist: Array, joints: Array, where: Where) -> None:
    """Check that the first key point of (n, 21, 3) is at the wrist's position (n, 3)."""
    gap = np.linalg.norm(joints[:, 0] - wrist, axis=1)
    require(gap <= WRIST_TOLERANCE, where,
            f"the wrist key point lies away from the wrist's position; expected at most {WRIST_TOLERANCE:g} m",
            "check that key points and pose are in the same frame")


def poses_from_quaternions(rows: Array, name: str, where: Where) -> Array:
    """(n, 7), position m and quaternion w, x, y, z, as transforms (n, 4, 4); the quaternions are normalised."""
    from scipy.spatial.transform import Rotation

    check_finite(rows, name, where)
    check_positions(rows[:, :3], name, where)
    length = np.linalg.norm(np.clip(rows[:, 3:], -2.0, 2.0), axis=1)
    require(np.abs(length - 1.0) <= QUATERNION_TOLERANCE, where,
            f"{name} has a quaternion that is not of length 1 within {QUATERNION_TOLERANCE:g}; "
            "expected position x, y, z and unit quaternion w, x, y, z",
            "normalise it, or check the order of the columns")
    return transforms(rows[:, :3], Rotation.from_quat(rows[:, [4, 5, 6, 3]]).as_matrix())


def poses_from_euler(rows: Array, name: str, where: Where) -> Array:
    """(n, 6), position m and intrinsic XYZ Euler angles rad, as transforms (n, 4, 4)."""
    from scipy.spatial.transform import Rotation

    check_finite(rows, name, where)
    check_positions(rows[:, :3], name, where)
    check_angles(rows[:, 3:], name, where)
    return transforms(rows[:, :3], Rotation.from_euler("XYZ", rows[:, 3:]).as_matrix())


def transforms(position: Array, rotation: Array) -> Array:
    """(n, 4, 4) from positions (n, 3) and rotations (n, 3, 3)."""
    out = np.tile(np.eye(4), (len(position), 1, 1))
    out[:, :3, :3] = rotation
    out[:, :3, 3] = position
    return out


def check_transforms(rows: Array, name: str, where: Where) -> None:
    """Check that (n, 4, 4) are rigid: finite, in metres, a proper rotation, last row 0 0 0 1."""
    check_finite(rows, name, where)
    check_positions(rows[:, :3, 3], name, where)
    rotation = np.clip(rows[:, :3, :3], -2.0, 2.0)
    gram = np.einsum("nij,nik->njk", rotation, rotation)
    proper = (np.abs(gram - np.eye(3)) <= ROTATION_TOLERANCE).all(axis=(1, 2)) & (np.linalg.det(rotation) > 0.0)
    closed = (rows[:, 3] == np.array([0.0, 0.0, 0.0, 1.0])).all(axis=1)
    require(proper & closed, where, f"{name} is not a rigid transform; expected a rotation and the last row 0 0 0 1",
            "orthonormalise it, or check for transposed or scaled matrices")
