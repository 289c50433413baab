"""Make a mesh file into an object that can be grasped: repair, fit, weigh and picture it, and write it to a folder.

The slow results depend only on the file's content and a few choices. They are kept in the user's cache under a hash of
these, so that the same file is never computed twice, whatever its name, its folder and its mass.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from dgrasp.config.names import DENSITY, OVERLAP
from dgrasp.errors import DataError
from dgrasp.files.atomic import replaced_folder, write_atomic
from dgrasp.files.paths import user_cache_root
from dgrasp.geometry.inertia import LEAST_SHARE, moment_bounds
from dgrasp.objects import store
from dgrasp.objects.add.fit import Choice, fit_shapes, simplified
from dgrasp.objects.add.mesh_reader import MeshFile, Units, read_mesh_file
from dgrasp.objects.add.parts import obj_text
from dgrasp.objects.add.picture import picture
from dgrasp.objects.add.repair import repair
from dgrasp.types import Array

SURFACE_FACES = 20_000
"""Number of triangles to which a larger surface is simplified, if its shape allows (`simplified`)."""
_VERSION = 8
"""Increases whenever the results for the same file and choices change."""
_MADE = "made.json"
_THIN = 2.0
"""mm. A box thinner than this gets a remark, because a body that is pressed hard goes through it."""
_SHOWN = ("remarks", "faces", "bounds_m", "volume_m3", "kind", "overlap", "share_close", "farthest_m", "tried")


@dataclass(frozen=True)
class Mass:
    """The mass of an object: `kg`, or if that is None, by `density` (kg/m^3).

    center: (3,) m in O, and inertia: (3, 3) kg m^2 about it; None takes those of a homogeneous body.
    """

    kg: float | None = None
    density: float = DENSITY
    center: Array | None = None
    inertia: Array | None = None


@dataclass(frozen=True)
class Added:
    """An object's description (object.json), its folder, and whether its results came from the cache."""

    meta: dict[str, Any]
    folder: Path
    cached: bool


def add_object(
    file: Path, to: Path, name: str, units: Units = "auto", mass: Mass | None = None, choice: Choice = "auto",
    threshold: float = OVERLAP, replace: bool = False, scale: float = 1.0,
) -> Added:
    """Make the object `name` from a mesh file, in the folder `to`/`name`.

    units, scale, choice, threshold: as `MeshFile.scaled` and `fit_shapes` take them. Raises `DataError` for a file
    that yields no object, for a mass that no body has, and for a folder that holds another object, unless `replace`.
    """
    mesh = read_mesh_file(file)
    vertices, unit = mesh.scaled(units, scale)
    made, cached = _made(mesh, vertices, unit, choice, threshold, scale)
    meta = _describe(name, mesh, made, mass or Mass(), scale)
    folder = Path(to) / name
    if os.path.isfile(folder / store.META_FILE):
        try:
            before = store.read_meta(folder)
        except DataError:
            before = {}
        if before.get("id") == meta["id"]:
            return Added(before, folder, cached)
    if os.path.lexists(folder) and not (replace and os.path.isfile(folder / store.META_FILE)):
        raise DataError(f"{file}: {folder} exists already and is another object; choose another --name, or --replace "
                        "it")
    _write(folder, made[1], meta)
    return Added(meta, folder, cached)


def _key(mesh: MeshFile, unit: str, choice: str, threshold: float, scale: float) -> str:
    by = {"version": _VERSION, "libraries": [version(name) for name in ("trimesh", "manifold3d", "scipy")],
          "file": mesh.sha256, "format": mesh.path.suffix.lower(), "units": unit, "scale": scale, "shape": choice,
          "overlap": threshold}
    return hashlib.sha256(json.dumps(by, sort_keys=True).encode()).hexdigest()[:24]


Made = tuple[dict[str, Any], dict[str, bytes]]
"""The results for a file: figures as plain values, and the files of the object by name."""


def _made(mesh: MeshFile, vertices: Array, unit: str, choice: Choice, threshold: float, scale: float
          ) -> tuple[Made, bool]:
    """The results for a file, and whether they came from the cache. New results are written there if possible."""
    cache = user_cache_root() / "objects" / _key(mesh, unit, choice, threshold, scale)
    found = _load(cache)
    if found is not None:
        return found, True
    try:
        made = _make(mesh, vertices, unit, choice, threshold)
    except DataError as error:
        text = str(error)
        raise DataError(text if text.startswith(str(mesh.path)) else f"{mesh.path}: {text}") from None
    # A cache that cannot be written only costs time on the next run.
    with suppress(DataError):
        for name, content in made[1].items():
            write_atomic(cache / name, content)
        digests = {name: hashlib.sha256(content).hexdigest() for name, content in made[1].items()}
        write_atomic(cache / _MADE, json.dumps({"figures": made[0], "files": digests}, indent=1) + "\n")
    return made, False


def _load(cache: Path) -> Made | None:
    """An entry of the cache; None if it is absent, incomplete or damaged."""
    try:
        entry = json.loads((cache / _MADE).read_text(encoding="utf-8"))
        files = {name: (cache / name).read_bytes() for name in entry["files"]}
        whole = all(hashlib.sha256(files[name]).hexdigest() == digest for name, digest in entry["files"].items())
        return (entry["figures"], files) if whole else None
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return None


def _make(mesh: MeshFile, vertices: Array, unit: str, choice: Choice, threshold: float) -> Made:
    import trimesh

    solid = simplified(repair(vertices, mesh.faces), SURFACE_FACES)
    points, faces = solid.mesh
    whole = trimesh.Trimesh(points, faces, process=False)
    volume = float(solid.solid.volume())
    bounds = np.stack([points.min(axis=0), points.max(axis=0)])
    if volume < 1e-9:
        raise DataError(f"the volume is {volume * 1e9:.2g} mm3; expected at least 1 mm3; check the units")
    with tempfile.TemporaryDirectory(prefix="dgrasp-") as temporary:
        folder = Path(temporary) / mesh.path.stem
        write_atomic(folder / store.MESH_FILE, obj_text(points, faces))
        fit = fit_shapes(solid, folder, choice, threshold)
        title = f"{fit.kind}: {len(fit.shapes)}, {fit.gaps.share_close:.0%} within 2 mm"
        files = {store.MESH_FILE: (folder / store.MESH_FILE).read_bytes(),
                 store.PICTURE_FILE: picture(folder / store.MESH_FILE, fit.shapes, bounds, (mesh.path.stem, title))}
        shapes = []
        for index, shape in enumerate(fit.shapes):
            entry = store.plain_shape(shape)
            if shape.file is not None:
                content = shape.file.read_bytes()
                # Named by its content, because PyBullet reads a name only once and would miss a replaced object.
                entry["file"] = f"{fit.kind}_{index:02d}_{hashlib.sha256(content).hexdigest()[:8]}.obj"
                files[entry["file"]] = content
            shapes.append(entry)
    low, high = bounds.tolist()
    side = 1000 * min(fit.shapes[0].size, default=np.inf)
    thin = [f"only {side:.2g} mm thick"] if fit.kind == "box" and side < _THIN else []
    return {
        "units": unit, "remarks": [*mesh.notes, *solid.notes, *thin, *fit.gaps.remarks()], "faces": len(faces),
        "bounds_m": [low, high], "volume_m3": volume,
        "center_m": np.asarray(whole.center_mass).tolist(),
        "inertia_per_density": np.asarray((whole.moment_inertia + whole.moment_inertia.T) / 2).tolist(),
        "kind": fit.kind, "overlap": fit.overlap, "share_close": fit.gaps.share_close, "farthest_m": fit.gaps.largest,
        "tried": fit.tried, "shapes": shapes,
    }, files  # fmt: skip


def _describe(name: str, mesh: MeshFile, made: Made, mass: Mass, scale: float) -> dict[str, Any]:
    """The content of object.json."""
    figures, files = made
    volume = figures["volume_m3"]
    kg = mass.density * volume if mass.kg is None else mass.kg
    center = np.array(figures["center_m"]) if mass.center is None else mass.center
    with np.errstate(invalid="ignore"):  # An infinite mass is refused below.
        solid = np.array(figures["inertia_per_density"]) * kg / volume
    inertia = solid if mass.inertia is None else mass.inertia
    try:
        store.check_mass(kg, center, inertia)
    except ValueError as error:
        raise DataError(f"{mesh.path}: {error} (volume {volume * 1e6:.4g} cm3); state --mass or --density, and in "
                        "the right units") from None
    low, high = np.array(figures["bounds_m"])
    if ((center < low) | (center > high)).any():
        raise DataError(f"{mesh.path}: the centre of mass {center.tolist()} lies outside the object, which reaches "
                        f"from {low.round(4).tolist()} to {high.round(4).tolist()} m; state --center in m, in the "
                        "mesh's frame")
    if mass.inertia is not None:
        _check_inertia(mesh.path, kg, inertia, solid, np.array([low, high]), center)
    body = {
        "mass_kg": float(kg), "center_of_mass_O": center.tolist(), "inertia": inertia.tolist(),
        "shapes": figures["shapes"],
        "files": {file: hashlib.sha256(content).hexdigest() for file, content in sorted(files.items())},
    }  # fmt: skip
    return {
        "format": store.FORMAT, "schema": store.SCHEMA, "name": name, "id": store.object_id({"name": name, **body}),
        "source": {"file": mesh.path.name, "sha256": mesh.sha256, "units": figures["units"], "scale": scale},
        "frame": "the file's own, in m", **body,
        "figures": {key: figures[key] for key in _SHOWN},
    }  # fmt: skip


def _check_inertia(path: Path, kg: float, inertia: Array, solid: Array, bounds: Array, center: Array) -> None:
    """Raise a `DataError` unless a body of this mass and size can have the stated inertia. Arguments as there."""
    moments, columns = np.linalg.eigh(inertia)
    least, most = moment_bounds(columns.T, kg, solid, bounds, center)
    wrong = np.flatnonzero((moments < least) | (moments > most))
    if len(wrong):
        i = wrong[0]
        raise DataError(f"{path}: --inertia has a principal moment of {moments[i]:.3g} kg m^2; expected "
                        f"{least[i]:.3g} to {most[i]:.3g} about that axis, for {kg:g} kg of this size (a homogeneous "
                        f"body has {least[i] / LEAST_SHARE:.3g}); state it in kg m^2, about the centre of mass")


def _write(folder: Path, files: dict[str, bytes], meta: dict[str, Any]) -> None:
    """Write the object's folder in one step; it replaces an existing one."""
    try:
        with replaced_folder(folder) as fresh:
            for name, content in files.items():
                (fresh / name).write_bytes(content)
            text = json.dumps(meta, indent=1) + "\n"
            (fresh / store.META_FILE).write_text(text, encoding="utf-8", newline="\n")
    except DataError as error:
        raise DataError(f"{error}; choose another folder with --to") from None
