"""Collision shapes as plain data, independent of the engine."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

Kind = Literal["box", "cylinder", "sphere", "capsule", "mesh", "hull"]


@dataclass(frozen=True)
class Shape:
    """One collision shape in its body's frame.

    size: m. Box: full lengths (x, y, z). Cylinder and capsule: (radius, length) along z; the length of a capsule
        excludes its caps. Sphere: (radius,). Mesh and hull: empty.
    position: m. quaternion: w, x, y, z.
    file: of a mesh (its concave triangles) or a hull (the convex hull of its vertices), times `scale` along the file's
        axes.
    """

    kind: Kind
    size: tuple[float, ...] = ()
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    file: Path | None = None
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
