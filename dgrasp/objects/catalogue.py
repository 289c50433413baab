"""The 20 objects of the paper's experiments: ids, masses, sizes and the authors' collision shapes.

The names and ids are those of the YCB set as DexYCB numbers it (id 19, the large clamp, is in none of its
grasps). Sizes and masses are published facts about the YCB objects.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from dgrasp.objects.names import resolve_object
from raisim_like.shapes import Shape

MassSet = Literal["official", "ycb"]

LABEL_TYPES = ("cylinder", "box", "mesh", "hull")
"""Kinds of collision shape in the order of the label files' `obj_type` codes 0 to 3."""


@dataclass(frozen=True)
class CatalogueObject:
    """One object.

    id: its DexYCB id. mass_ycb, mass_authors: kg, as YCB publishes it and as the authors simulate it.
    extents: (x, y, z) m of the bounding box, in the axes of the free set's object frame.
    collision: the authors' collision shape in the object frame O; a file is relative to the object's folder.
    thin: made of walls and bars so thin that it keeps its triangles where the engine takes them (docs/physics.md,
        "Objects in physics").
    """

    id: int
    name: str
    mass_ycb: float
    mass_authors: float
    extents: tuple[float, float, float]
    collision: Shape
    thin: bool = False

    def mass(self, masses: MassSet) -> float:
        """Mass in kg: "official" as the authors simulate it, "ycb" as published."""
        return self.mass_authors if masses == "official" else self.mass_ycb


def _cylinder(radius: float, height: float) -> Shape:
    return Shape("cylinder", (radius, height))


def _box(x: float, y: float, z: float) -> Shape:
    return Shape("box", (x, y, z))


_ALIGNED = Shape("hull", file=Path("mesh_aligned.obj"))
_CONCAVE = Shape("mesh", file=Path("textured_meshlab_quart.obj"))

CATALOGUE = (
    CatalogueObject(1, "002_master_chef_can", 0.414, 0.414, (0.102, 0.102, 0.139), _cylinder(0.051, 0.139)),
    CatalogueObject(2, "003_cracker_box", 0.411, 0.453, (0.060, 0.158, 0.210), _box(0.060, 0.158, 0.210)),
    CatalogueObject(3, "004_sugar_box", 0.514, 0.514, (0.038, 0.089, 0.175), _box(0.038, 0.089, 0.175)),
    CatalogueObject(4, "005_tomato_soup_can", 0.349, 0.349, (0.066, 0.066, 0.101), _cylinder(0.033, 0.101)),
    CatalogueObject(5, "006_mustard_bottle", 0.603, 0.431, (0.097, 0.066, 0.192), _CONCAVE),
    CatalogueObject(6, "007_tuna_fish_can", 0.171, 0.171, (0.085, 0.085, 0.033), _cylinder(0.0425, 0.033)),
    CatalogueObject(7, "008_pudding_box", 0.187, 0.187, (0.110, 0.089, 0.035), _ALIGNED),
    CatalogueObject(8, "009_gelatin_box", 0.097, 0.097, (0.073, 0.085, 0.028), _ALIGNED),
    CatalogueObject(9, "010_potted_meat_can", 0.370, 0.370, (0.050, 0.097, 0.089), _ALIGNED),
    CatalogueObject(10, "011_banana", 0.066, 0.066, (0.109, 0.178, 0.037), _CONCAVE),
    CatalogueObject(11, "019_pitcher_base", 0.178, 0.178, (0.148, 0.144, 0.242), _CONCAVE),
    CatalogueObject(12, "021_bleach_cleanser", 1.131, 0.302, (0.103, 0.068, 0.251), _CONCAVE),
    CatalogueObject(13, "024_bowl", 0.147, 0.147, (0.160, 0.160, 0.056), _CONCAVE, thin=True),
    CatalogueObject(14, "025_mug", 0.118, 0.118, (0.115, 0.092, 0.081), _CONCAVE, thin=True),
    CatalogueObject(15, "035_power_drill", 0.895, 0.895, (0.184, 0.187, 0.056), _CONCAVE),
    CatalogueObject(16, "036_wood_block", 0.729, 0.729, (0.085, 0.085, 0.200), _ALIGNED),
    CatalogueObject(17, "037_scissors", 0.082, 0.082, (0.095, 0.201, 0.016), _CONCAVE),
    CatalogueObject(18, "040_large_marker", 0.0158, 0.010, (0.018, 0.018, 0.121), _ALIGNED),
    CatalogueObject(20, "052_extra_large_clamp", 0.202, 0.102, (0.208, 0.165, 0.037), _CONCAVE, thin=True),
    CatalogueObject(21, "061_foam_brick", 0.028, 0.028, (0.050, 0.075, 0.050), _box(0.050, 0.075, 0.050)),
)
"""All objects in the order of their ids."""

_BY_NAME = {entry.name: entry for entry in CATALOGUE}


def catalogue_object(name: str) -> CatalogueObject:
    """The object of that name, such as "004_sugar_box" (or "004"); `DataError` for an unknown one."""
    return _BY_NAME[resolve_object(name)]
