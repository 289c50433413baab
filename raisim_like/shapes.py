"""Collision shapes as plain data, independent of the engine."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

Kind = Literal["box", "cylinder", "sphere", "capsule", "mesh", "hull"]


@dataclass(frozen=True)
class Shape:
    """One collision shape in its body's frame.

    size: box (x, y, z) full lengths; cylinder and capsule (radius, length) along z, the capsule's length
    without its caps; sphere (radius,). A mesh (concave triangles) and a hull (convex hull of the vertices)
    come from `file`, times `scale` along the file's axes, and their size is empty. m; quaternion w, x, y, z.
    """

    kind: Kind
    size: tuple[float, ...] = ()
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    file: Path | None = None
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
