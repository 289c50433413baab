"""How close convex parts are to their objects: `python -m benchmarks.collision_shapes --reference DIR`.

Prints, for a mug, a hoop and a bowl, and for the nine concave objects of the authors' release: the number of parts and
their vertices; by how much their volume is larger; the share of the points inside walls and bars of up to 10 mm that
collide; the share of the points of hollows (where a ball of 8 mm fits, and a place is 5 mm or more away from the
object) that are free; the shares of the object's surface and of the parts' surface within 2 mm of the other; and the
CPU seconds.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import manifold3d
import numpy as np
import trimesh
from scipy.ndimage import distance_transform_edt, label

from dgrasp.files.atomic import write_atomic
from dgrasp.geometry.inertia import load_mesh
from dgrasp.geometry.shape_mesh import shape_mesh
from dgrasp.geometry.winding import winding_grid
from dgrasp.objects.add.judge import CLOSE, judge
from dgrasp.objects.add.parts import obj_text, part_hulls
from dgrasp.objects.add.repair import RepairedSolid, repair
from dgrasp.objects.catalogue import CATALOGUE
from raisim_like.shapes import Shape

_POINTS = 1_000_000
_THIN, _BALL, _DEEP = 0.010, 0.004, 0.005


def made() -> dict[str, RepairedSolid]:
    """A mug of 3 mm walls with a handle of 12 mm, a hoop of 8 mm, and a bowl with a wall of 4 mm."""
    cylinder, ball = manifold3d.Manifold.cylinder, manifold3d.Manifold.sphere
    tube = manifold3d.CrossSection.circle

    def ring(radius: float, thickness: float) -> manifold3d.Manifold:
        return tube(thickness, 24).translate((radius, 0.0)).revolve(64)

    cup = cylinder(0.095, 0.042, circular_segments=64)
    cup -= cylinder(0.095, 0.039, circular_segments=64).translate((0.0, 0.0, 0.004))
    handle = ring(0.026, 0.006).rotate((90.0, 0.0, 0.0)).translate((0.056, 0.0, 0.0475))
    mug = cup + (handle - cylinder(0.095, 0.0392, circular_segments=64))
    bowl = (ball(0.08, 96) - ball(0.076, 96)).trim_by_plane((0.0, 0.0, -1.0), 0.02)
    named = {"mug": mug, "hoop": ring(0.06, 0.004), "bowl": bowl}
    return {name: RepairedSolid(solid, ()) for name, solid in named.items()}


def solids(reference: Path | None) -> Iterator[tuple[str, RepairedSolid]]:
    """The objects by name."""
    yield from made().items()
    for entry in CATALOGUE:
        if reference is not None and entry.collision.kind == "mesh" and entry.collision.file is not None:
            mesh = load_mesh(reference / "objects" / entry.name / entry.collision.file)
            yield entry.name, repair(np.asarray(mesh.vertices, dtype=float), np.asarray(mesh.faces))


def measure(solid: RepairedSolid) -> list[str]:
    """The row of a solid."""
    started = time.process_time()
    hulls = part_hulls(solid)
    seconds = time.process_time() - started
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder) / f"{i}.obj" for i in range(len(hulls))]
        for file, hull in zip(files, hulls, strict=True):
            write_atomic(file, obj_text(*hull))
        shapes = [Shape("hull", file=file) for file in files]
        gaps, meshes = judge(solid, shapes), [shape_mesh(shape) for shape in shapes]
    vertices, faces = solid.mesh
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    pitch = max(0.001, float((np.prod(high - low) / _POINTS) ** (1 / 3)))
    first, n = low - 5.37 * pitch, np.ceil((high - low) / pitch).astype(int) + 11
    size = (int(n[0]), int(n[1]), int(n[2]))
    inside = winding_grid(vertices, faces, first, pitch, size) > 0
    collides = np.any([winding_grid(*mesh, first, pitch, size) > 0 for mesh in meshes], axis=0)
    away = pitch * distance_transform_edt(~inside)
    core = pitch * distance_transform_edt(inside) >= _THIN / 2
    thin = inside & (pitch * distance_transform_edt(~core) > _THIN / 2) if core.any() else inside
    hull = trimesh.convex.convex_hull(vertices)
    held = winding_grid(np.asarray(hull.vertices), np.asarray(hull.faces), first, pitch, size) > 0
    wide = held & ~inside & (pitch * distance_transform_edt(~(away >= _BALL)) <= _BALL)
    places, count = label(wide)
    deep = np.zeros(count + 1)
    np.maximum.at(deep, places.ravel(), away.ravel())
    hollow = wide & (deep[places] >= _DEEP)
    shares = [collides[thin].mean(), (~collides[hollow]).mean(), (gaps.missed_by <= CLOSE).mean(),
              (gaps.added_by <= CLOSE).mean()]
    return [str(len(hulls)), str(sum(len(hull[0]) for hull in hulls)), f"{collides.sum() / inside.sum() - 1:+.0%}",
            *(f"{share:.3f}" for share in shares), f"{1000 * gaps.largest:.1f}", f"{seconds:.0f}"]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--reference", type=Path, metavar="DIR", help="the authors' release, for its concave objects")
    parser.add_argument("names", nargs="*", help="objects (default: all)")
    arguments = parser.parse_args()
    print("| object | parts | vertices | volume | thin | free | surface | parts' surface | largest, mm | CPU, s |")
    print("|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|")
    for name, solid in solids(arguments.reference):
        if not arguments.names or name in arguments.names:
            print(f"| {name} | {' | '.join(measure(solid))} |", flush=True)


if __name__ == "__main__":
    main()
