"""`dgrasp object add`: make objects for the physics from mesh files."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.table import Table

from dgrasp.config.names import DENSITY, OVERLAP, PRIMITIVES
from dgrasp.errors import DataError
from dgrasp.objects.add.mesh_reader import FORMATS, SCALES
from dgrasp.objects.store import PICTURE_FILE, check_name, clean_name, default_store

if TYPE_CHECKING:
    from dgrasp.objects.add.add import Added, Mass

HELP = """\
Add an object from a mesh (OBJ, STL, PLY, GLB), or every mesh of a folder. The command checks the units, repairs the
mesh, fits collision shapes, computes mass and inertia, and draws a picture. Labels that name the object can then be
used to train and test.

examples:
  dgrasp object add cup.stl --units mm --mass 0.21
  dgrasp object add scans/ --density 700
  dgrasp object add cup.obj --shape parts --to objects/   then: dgrasp test --labels MY.npz objects=objects/
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `object add`."""
    parser.add_argument("mesh", type=Path, metavar="MESH|FOLDER", help=f"a file ({', '.join(FORMATS)}), or a folder")
    parser.add_argument("--name", help="the object's name in labels (default: the file's name)")
    parser.add_argument("--units", choices=("auto", *SCALES), default="auto",
                        help="the file's unit of length (default: the only unit that gives an object of 1 to 50 cm)")
    parser.add_argument("--scale", type=float, default=1.0, metavar="S",
                        help="factor for the file's numbers, before the unit (default: 1); for a normalised mesh")
    weight = parser.add_mutually_exclusive_group()
    weight.add_argument("--mass", type=float, metavar="KG", help="the object's mass")
    weight.add_argument("--density", type=float, metavar="KG/M3", default=DENSITY,
                        help=f"compute the mass from the mesh's volume (default: {DENSITY:g})")
    parser.add_argument("--center", type=float, nargs=3, metavar=("X", "Y", "Z"),
                        help="centre of mass, m in the mesh's frame (default: a homogeneous body's)")
    parser.add_argument("--inertia", type=float, nargs=6, metavar=("XX", "YY", "ZZ", "XY", "XZ", "YZ"),
                        help="inertia about the centre of mass, kg m2 (default: a homogeneous body's)")
    parser.add_argument("--shape", choices=("auto", *PRIMITIVES, "parts", "mesh"), default="auto",
                        help="collision shape: a primitive, convex parts or triangles (default: the first that fits)")
    parser.add_argument("--overlap", type=float, default=OVERLAP, metavar="SHARE",
                        help=f"smallest volume overlap at which a primitive is used (default: {OVERLAP})")
    parser.add_argument("--to", type=Path, metavar="DIR", help="where NAME/ is written (default: data/objects)")
    parser.add_argument("--replace", action="store_true", help="replace an object of that name")


def main(arguments: argparse.Namespace) -> int:
    """Add the object or objects and print their figures; returns the exit code."""
    if not 0.0 < arguments.overlap <= 1.0:
        raise DataError(f"--overlap {arguments.overlap:g}: expected a share above 0 and at most 1")
    for option in ("mass", "density", "scale"):
        value = getattr(arguments, option)
        if value is not None and not 0.0 < value < np.inf:
            raise DataError(f"--{option} {value:g}: expected a positive number")

    from dgrasp.objects.add.add import add_object

    to = default_store() if arguments.to is None else arguments.to
    added, refused = [], []
    for file, name in _files(arguments):
        try:
            check_name(name, file)
            added.append(add_object(file, to, name, arguments.units, _mass(arguments), arguments.shape,
                                    arguments.overlap, arguments.replace, arguments.scale))
        except DataError as error:
            if not arguments.mesh.is_dir():
                raise
            refused.append(str(error))
    if added:
        _print(added)
    for line in refused:
        print(f"refused: {line}", file=sys.stderr)
    return 2 if refused else 0


def _files(arguments: argparse.Namespace) -> list[tuple[Path, str]]:
    """Mesh files with the names of their objects."""
    path: Path = arguments.mesh
    if not path.is_dir():
        return [(path, arguments.name or clean_name(path.stem))]
    for option in ("name", "center", "inertia"):
        if getattr(arguments, option) is not None:
            raise DataError(f"--{option}: {path} is a folder, but this option describes one object; add the file alone")
    files = sorted(p for p in path.rglob("*") if p.is_file() and p.suffix.lower()[1:] in FORMATS)
    if not files:
        raise DataError(f"{path}: no mesh in this folder; expected files of type {', '.join(FORMATS)}")
    named = [(file, clean_name("_".join(file.relative_to(path).with_suffix("").parts))) for file in files]
    for index, (file, name) in enumerate(named):
        other = next((earlier for earlier, taken in named[:index] if taken == name), None)
        if other is not None:
            raise DataError(f"{file}: its object would be called {name!r}, like that of {other}; rename one of them")
    return named


def _mass(arguments: argparse.Namespace) -> Mass:
    from dgrasp.objects.add.add import Mass

    inertia = None
    if arguments.inertia is not None:
        xx, yy, zz, xy, xz, yz = arguments.inertia
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    center = None if arguments.center is None else np.array(arguments.center)
    return Mass(arguments.mass, arguments.density, center, inertia)


def figures_row(meta: dict[str, Any]) -> list[str]:
    """The table row of an object's figures."""
    figures = meta["figures"]
    low, high = np.array(figures["bounds_m"])
    sides = " ".join(f"{1000 * side:.1f}" for side in high - low)
    kind = figures["kind"] if len(meta["shapes"]) == 1 else f"{len(meta['shapes'])} {figures['kind']}"
    return [meta["name"], meta["source"]["units"], sides, str(figures["faces"]), f"{1e6 * figures['volume_m3']:.1f}",
            f"{1000 * meta['mass_kg']:.4g}", kind, f"{figures['overlap']:.2f}", f"{figures['share_close']:.3f}",
            "; ".join(figures["remarks"]) or "-"]


def _print(added: list[Added]) -> None:
    table = Table("object", "unit", "sides mm", "faces", "cm3", "g", "collides as", "overlap", "within 2 mm", "remarks")
    for entry in added:
        table.add_row(*figures_row(entry.meta))
    # In a file or a pipe, a wide table keeps each row on one line.
    console = Console(highlight=False, width=None if sys.stdout.isatty() else 200)
    console.print(table)
    for entry in added:
        known = " (already there, nothing computed)" if entry.cached else ""
        console.print(f"{entry.folder}: {entry.meta['id']}, see {PICTURE_FILE}{known}", soft_wrap=True, markup=False)
