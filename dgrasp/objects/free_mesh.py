"""The free objects as the project's own closed meshes: `python -m dgrasp.objects.free_mesh --out data/free/objects`.

The meshes have the published extents to the micrometre and follow the shapes of `dgrasp.objects.free`, with rounder
rims, shoulders, handles and hollows. Surfaces are measured and drawn on the meshes; the shapes are what is simulated.
The frame O is the same: its origin is the centre of the bounding box.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from dgrasp.errors import DGraspError
from dgrasp.files.atomic import write_atomic
from dgrasp.geometry.closing import close_mesh
from dgrasp.geometry.solids import block, lofted, plate, rounded, smooth, swept, turned
from dgrasp.objects.add.parts import obj_text
from dgrasp.objects.catalogue import CATALOGUE, catalogue_object
from dgrasp.types import Array

_COARSE = 5e-5
"""Distance by which the surface may move to save triangles, m."""


def free_mesh(name: str) -> tuple[Array, Array]:
    """Vertices (V, 3) m, to the micrometre, and faces (F, 3), closed and wound outwards, of a free object in O.

    Raises `DataError` for an unknown name.
    """
    entry = catalogue_object(name)
    solid = _SOLIDS[entry.name]() if entry.name in _SOLIDS else block(entry.extents)
    solid = solid.simplify(_COARSE)
    low, high = np.array(solid.bounding_box()).reshape(2, 3)
    solid = solid.translate(tuple(-(low + high) / 2)).scale(tuple(np.array(entry.extents) / (high - low)))
    triangles = solid.to_mesh64()
    # Booleans leave edges of almost no length. Rounding makes their ends one vertex, and empty faces are dropped.
    vertices = np.round(np.asarray(triangles.vert_properties)[:, :3], 6) + 0.0
    closed = close_mesh(vertices, np.asarray(triangles.tri_verts))
    return closed.vertices, closed.faces


def _can(radius: float, height: float) -> Any:
    """A tin with a rim at both ends, its lids 1.5 mm deep."""
    rim, deep = 0.0025, 0.0015
    return turned([
        (0, deep), (radius - rim, deep), (radius - rim, 0), (radius - 0.0005, 0), (radius, 0.0005),
        (radius, height - 0.0005), (radius - 0.0005, height), (radius - rim, height), (radius - rim, height - deep),
        (0, height - deep),
    ])  # fmt: skip


def _marker() -> Any:
    """A marker with its cap up; the cap is a little thicker than the barrel."""
    return turned([
        (0, 0), (0.0070, 0), (0.0084, 0.002), (0.0084, 0.074), (0.0090, 0.075), (0.0090, 0.116), (0.0078, 0.118),
        (0.0072, 0.121), (0, 0.121),
    ])  # fmt: skip


def _meat_can() -> Any:
    """Two flat sides and two round ones, with a rim at both ends."""
    body = plate(rounded((0.0, -0.0235, 0.025), (0.0, 0.0235, 0.025)), 0.089)
    lid = rounded((0.0, -0.0235, 0.0225), (0.0, 0.0235, 0.0225))
    return body - plate(lid, 0.002, -0.0005) - plate(lid, 0.002, 0.0875)


def _mustard() -> Any:
    """An oval body, shoulders, a screw cap and a nozzle."""
    return lofted([
        (0.000, 0.0465, 0.0310, 2.6), (0.003, 0.0485, 0.0330, 2.6), (0.114, 0.0485, 0.0330, 2.6),
        (0.124, 0.0460, 0.0322, 2.5), (0.130, 0.0400, 0.0305, 2.3), (0.138, 0.0300, 0.0270, 2.0),
        (0.152, 0.0230, 0.0220, 2.0),
        (0.153, 0.0180, 0.0180, 2.0), (0.176, 0.0180, 0.0180, 2.0), (0.178, 0.0090, 0.0090, 2.0),
        (0.180, 0.0065, 0.0065, 2.0), (0.191, 0.0055, 0.0055, 2.0), (0.192, 0.0045, 0.0045, 2.0),
    ])  # fmt: skip


def _bleach() -> Any:
    """An oval body, shoulders, a neck and a cap."""
    return lofted([
        (0.000, 0.0490, 0.0315, 2.6), (0.004, 0.0515, 0.0340, 2.6), (0.152, 0.0515, 0.0340, 2.6),
        (0.163, 0.0490, 0.0334, 2.5), (0.170, 0.0430, 0.0320, 2.3), (0.178, 0.0340, 0.0300, 2.0),
        (0.193, 0.0270, 0.0270, 2.0), (0.200, 0.0220, 0.0220, 2.0),
        (0.203, 0.0165, 0.0165, 2.0), (0.220, 0.0165, 0.0165, 2.0), (0.221, 0.0210, 0.0210, 2.0),
        (0.249, 0.0210, 0.0210, 2.0), (0.251, 0.0195, 0.0195, 2.0),
    ])  # fmt: skip


def _banana() -> Any:
    """A bent body that tapers to a stem at one end and a tip at the other."""
    radius, reach, turn = 0.115, np.radians(54.8), np.radians(24.8)
    share = np.array([0.0, 0.04, 0.10, 0.20, 0.36, 0.50, 0.64, 0.80, 0.90, 0.97, 1.0])
    thick = np.array([0.0035, 0.0060, 0.0090, 0.0125, 0.0181, 0.0188, 0.0181, 0.0125, 0.0095, 0.0070, 0.0045])
    curve = smooth(np.column_stack([share, thick]).tolist())[::2]
    angle = (2.0 * curve[:, 0] - 1.0) * reach + turn
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), 0.0 * angle], axis=1)
    return swept(points, curve[:, 1], (0.0, 0.0, 1.0))


def _pitcher() -> Any:
    """A tapered vessel with a wall of 5 mm and a handle towards the corner of its bounding box."""
    inside = turned([(0, 0.006), (0.0435, 0.006), (0.0450, 0.008), (0.0551, 0.25), (0, 0.25)])
    outside = turned([(0, 0), (0.0480, 0), (0.0495, 0.0015), (0.0600, 0.242), (0, 0.242)])
    way = smooth([(0.036, 0.033, 0.217), (0.079, 0.075, 0.212), (0.079, 0.075, 0.080), (0.034, 0.031, 0.053)])
    return outside + swept(way, np.full(len(way), 0.009), (-0.075, 0.079, 0.0)) - inside


def _bowl() -> Any:
    """A round shell of 4 mm on a low foot."""
    outer = smooth([(0.0395, 0.0005), (0.062, 0.018), (0.0705, 0.028), (0.080, 0.056)])
    inner = smooth([(0.0756, 0.056), (0.0660, 0.0320), (0.057, 0.0215), (0.036, 0.005)])
    return turned([(0, 0), (0.0385, 0), *map(tuple, outer.tolist()), *map(tuple, inner.tolist()), (0, 0.005)])


def _mug() -> Any:
    """A wall of 5 mm, a bottom of 6 mm, and a bent handle with room for two fingers."""
    inside = turned([(0, 0.006), (0.039, 0.006), (0.041, 0.008), (0.041, 0.09), (0, 0.09)])
    outside = turned([(0, 0), (0.0445, 0), (0.046, 0.0015), (0.046, 0.0800), (0.0455, 0.081), (0, 0.081)])
    way = smooth([(0.042, 0.0, 0.067), (0.064, 0.0, 0.063), (0.064, 0.0, 0.021), (0.042, 0.0, 0.017)])
    return outside + swept(way, np.full(len(way), 0.005), (0.0, 1.0, 0.0)) - inside


def _drill() -> Any:
    """Motor with chuck along x, a trigger, a rounded handle, and a battery at the foot; y is up."""
    profile = [(0, 0), (0.020, 0), (0.0255, 0.004), (0.026, 0.010), (0.026, 0.138), (0.021, 0.148), (0.016, 0.150),
               (0.016, 0.176), (0.010, 0.184), (0, 0.184)]  # fmt: skip
    motor = turned(profile).rotate((0.0, 90.0, 0.0)).translate((-0.092, 0.0675, 0.0))
    grip = lofted([(0.0, 0.019, 0.017, 3.0), (0.060, 0.0195, 0.017, 3.0), (0.120, 0.021, 0.017, 3.0)])
    handle = grip.rotate((-90.0, 0.0, 0.0)).rotate((0.0, 0.0, -5.0)).translate((-0.056, -0.058, 0.0))
    trigger = block((0.014, 0.030, 0.014), (-0.031, 0.030, 0.0), 0.003)
    battery = block((0.088, 0.045, 0.056), (-0.045, -0.071, 0.0), 0.005)
    return motor + handle + trigger + battery


def _scissors() -> Any:
    """Two blades crossing at the pivot, one above the other, each with an oval ring."""
    import manifold3d

    angle = 2.0 * np.pi * np.arange(32) / 32
    whole = turned([(0, -0.0068), (0.005, -0.0068), (0.005, 0.0068), (0, 0.0068)]).translate((0.0, 0.056, 0.0))
    for side in (-1.0, 1.0):
        x, y = (half * np.sign(v) * np.abs(v) ** 0.5
                for half, v in ((0.0155, np.cos(angle)), (0.024, np.sin(angle))))  # fmt: skip
        loop = np.stack([side * 0.0245 + x, -0.069 + y, 0.0 * x], axis=1)
        blade = np.array([(0.0245, -0.044), (0.0245, -0.030), (0.012, 0.050), (0.0, 0.100), (-0.0105, 0.100),
                          (0.0115, -0.047)])  # fmt: skip
        outline = manifold3d.CrossSection.hull_points(blade * np.array([side, 1.0]))
        whole += swept(loop, np.full(32, 0.0075), (0.0, 0.0, 1.0), closed=True)
        # The blades overlap slightly, because solids that just touch have no clear surface.
        whole += plate(outline, 0.0061, -0.0001 if side > 0 else -0.006)
    return whole


def _clamp() -> Any:
    """Two arms crossing at a pivot: handles that spread towards -x and jaws that close towards +x."""
    whole = plate(rounded((0.020, 0.0, 0.020)), 0.037, -0.0185)
    for side in (-1.0, 1.0):
        handle = rounded((-0.0920, side * 0.0702, 0.0120), (0.020, side * 0.009, 0.012))
        jaw = rounded((0.018, side * 0.016, 0.011), (0.066, side * 0.029, 0.011))
        tip = rounded((0.068, side * 0.032, 0.010), (0.095, side * 0.015, 0.008))
        for outline in (handle, jaw, tip):
            whole += plate(outline, 0.030, -0.015)
    return whole


_SOLIDS: dict[str, Callable[[], Any]] = {
    "002_master_chef_can": lambda: _can(0.051, 0.139),
    "005_tomato_soup_can": lambda: _can(0.033, 0.101),
    "006_mustard_bottle": _mustard,
    "007_tuna_fish_can": lambda: _can(0.0425, 0.033),
    "010_potted_meat_can": _meat_can,
    "011_banana": _banana,
    "019_pitcher_base": _pitcher,
    "021_bleach_cleanser": _bleach,
    "024_bowl": _bowl,
    "025_mug": _mug,
    "035_power_drill": _drill,
    "037_scissors": _scissors,
    "040_large_marker": _marker,
    "052_extra_large_clamp": _clamp,
}


def main(arguments: list[str] | None = None) -> int:
    """Write `NAME/mesh.obj` for every free object; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m dgrasp.objects.free_mesh", description="The free objects' meshes.")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="where NAME/mesh.obj is written")
    options = parser.parse_args(arguments)
    try:
        for entry in CATALOGUE:
            write_atomic(options.out / entry.name / "mesh.obj", obj_text(*free_mesh(entry.name)))
    except DGraspError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
