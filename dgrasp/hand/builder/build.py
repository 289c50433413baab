"""Build a folder that the physics loads (URDF, meshes, description) from a hand model in MANO's layout."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from dgrasp.errors import DataError
from dgrasp.files.atomic import replaced_folder
from dgrasp.geometry.approximate import Fit, fit_box, fit_capsule, fit_hull, part_properties
from dgrasp.geometry.inertia import MassProperties
from dgrasp.geometry.part_mesh import PartMesh
from dgrasp.hand import store
from dgrasp.hand.builder.limits import mirror_limits, table_limits
from dgrasp.hand.builder.segment import segment
from dgrasp.hand.builder.urdf_writer import LinkPart, hand_urdf
from dgrasp.hand.load import load_hand
from dgrasp.hand.mano.model import MIRROR, ManoModel, mirror_mano
from dgrasp.hand.mano.skeleton import DISTAL_PARTS, N_PARTS, PART_PARENT, PARTS
from dgrasp.types import Array

DENSITY = 1100.0
"""kg/m^3 of every part: soft tissue and bone together, as for the free hand."""

Shapes = Literal["primitives", "hulls"]


@dataclass(frozen=True)
class Provenance:
    """Where a hand comes from, for its description. name: the id's first part. file, sha256: of the model's file.

    limits: where the joint limits come from. licence: the terms of the model, which the built hand inherits.
    """

    name: str
    file: str
    sha256: str
    limits: str
    licence: str


def build_hand(
    model: ManoModel, betas: Array, limits: Array | None, shapes: Shapes, provenance: Provenance, out: Path,
    mirror: bool = False,
) -> str:
    """Write the hand of shape `betas` (S' <= S,) to the new folder `out`. Returns the hand's id.

    limits (45, 2) rad: of the model's side; None for the anatomical table. shapes: one capsule per finger part and one
    box for the palm, or convex hulls. mirror: make the other hand. Raises `DataError` for a folder that is not empty,
    and for a model or betas that give no hand.
    """
    if mirror:
        model, limits = mirror_mano(model), None if limits is None else mirror_limits(limits)
    out = Path(out)
    if os.path.exists(out) and not (os.path.isdir(out) and not any(out.iterdir())):
        raise DataError(f"{out} exists already; choose another --out, or remove it")
    vertices, joints = model.shaped(betas)
    tips = vertices[model.tip_vertices]
    parts = segment(vertices, model.faces, model.part_weights(), joints)
    solids = [part_properties(part) for part in parts]
    if limits is None:
        limits = _table(model, joints, tips)
    with replaced_folder(out) as folder:
        fits = [_fit(part, shapes, folder) for part in parts]
        for part in parts:
            write_obj(folder / f"{part.name}.obj", part)
        urdf = folder / store.URDF_FILE
        links = _links(parts, solids, fits, joints, limits)
        comment = "Written by `dgrasp hand build`; what it was made of stands in hand.json."
        text = hand_urdf(provenance.name, comment, links, tips - joints[DISTAL_PARTS], massless=False)
        urdf.write_text(text, encoding="utf-8", newline="\n")
        identity = store.hand_id(provenance.name, urdf)
        load_hand(urdf, identity, model.side, mano=True)
        meta = _describe(identity, model, betas, shapes, provenance, parts, fits)
        (folder / store.META_FILE).write_text(json.dumps(meta, indent=1) + "\n", encoding="utf-8", newline="\n")
    return identity


def primitive_links(model: ManoModel, limits: Array) -> list[LinkPart]:
    """The parts of the mean hand as primitives, without visual meshes. limits: (45, 2) rad."""
    vertices, joints = model.shaped(np.zeros(0))
    parts = segment(vertices, model.faces, model.part_weights(), joints)
    fits = [_primitive(part) for part in parts]
    links = _links(parts, [part_properties(part) for part in parts], fits, joints, limits)
    return [replace(link, visual="") for link in links]


def _table(model: ManoModel, joints: Array, tips: Array) -> Array:
    """(45, 2) rad: limits by the anatomical table, which is of a right hand, for a hand of either side."""
    if model.side == "right":
        return table_limits(joints, tips)
    return mirror_limits(table_limits(joints * MIRROR, tips * MIRROR))


def write_obj(path: Path, mesh: PartMesh) -> None:
    """Write a mesh as a Wavefront file, in m with six decimals."""
    lines = [f"v {x + 0.0:.6f} {y + 0.0:.6f} {z + 0.0:.6f}" for x, y, z in np.round(mesh.vertices, 6).tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (mesh.faces + 1).tolist()]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


def _fit(part: PartMesh, shapes: Shapes, folder: Path) -> Fit:
    if shapes == "hulls":
        fit, mesh = fit_hull(part, folder / f"{part.name}_hull.obj")
        assert fit.shape.file is not None
        write_obj(fit.shape.file, mesh)
        return fit
    return _primitive(part)


def _primitive(part: PartMesh) -> Fit:
    return fit_box(part) if part.name == "palm" else fit_capsule(part)


def _links(
    parts: list[PartMesh], solids: list[MassProperties], fits: list[Fit], joints: Array, limits: Array
) -> list[LinkPart]:
    links = []
    for index, (part, solid, fit) in enumerate(zip(parts, solids, fits, strict=True)):
        offset = joints[index] - joints[PART_PARENT[index]] if index else np.zeros(3)
        own = limits[3 * index - 3 : 3 * index] if index else np.tile([-np.pi, np.pi], (3, 1))
        mass = DENSITY * solid.volume
        links.append(LinkPart(offset, own, (fit.shape,), mass, solid.center_of_mass, solid.inertia_of(mass),
                              f"{part.name}.obj"))
    return links


def _describe(
    identity: str, model: ManoModel, betas: Array, shapes: Shapes, provenance: Provenance, parts: list[PartMesh],
    fits: list[Fit],
) -> dict[str, Any]:
    figures = {
        PARTS[i]: {"shape": fits[i].shape.kind, "overlap": round(fits[i].overlap, 4),
                   "mesh_volume_cm3": round(parts[i].volume * 1e6, 4)}
        for i in range(N_PARTS)
    }
    return {
        "format": store.FORMAT, "schema": store.SCHEMA, "id": identity, "name": provenance.name, "side": model.side,
        "model_file": provenance.file, "model_sha256": provenance.sha256, "licence": provenance.licence,
        "betas": [float(b) for b in betas], "shapes": shapes, "limits": provenance.limits, "density_kg_m3": DENSITY,
        "tip_vertices": [int(v) for v in model.tip_vertices], "parts": figures,
    }
