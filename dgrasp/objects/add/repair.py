"""Make triangles into a solid: merge vertices, turn normals outwards, close holes, unite bodies.

A mesh that cannot be repaired piece by piece, such as a scan with three faces at an edge, is rebuilt on a grid. A
surface without an inside is refused, because closing it would invent an object.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from dgrasp.errors import DataError
from dgrasp.geometry.closing import MERGE_DISTANCE, signed_volume
from dgrasp.geometry.intersection import Body, body
from dgrasp.geometry.winding import winding_grid
from dgrasp.objects.add.rebuild import rebuild
from dgrasp.types import Array

LARGEST_CAP = 0.2
"""Largest share of the surface that closed holes may make up. With more, the mesh is an open surface by design, such as
a bowl without thickness."""
LARGEST_LOSS = 0.1
"""Largest share of the surface that may be left out because it encloses nothing; above it the mesh is rebuilt."""
_SPECK = 0.005
"""Share of the surface below which a loose piece counts as scan noise."""
_LARGEST_LID = 0.45
"""Largest area of a piece's caps, as a share of the piece. A piece with a cap nearly as large as itself is a flap."""
_MAX_PIECES = 500
"""Most loose pieces; a file with more holds separate triangles, not solids."""


@dataclass(frozen=True, eq=False)
class RepairedSolid:
    """A solid in m. solid: the manifold for booleans. notes: the repairs, in a few words each."""

    solid: Any
    notes: tuple[str, ...]

    @property
    def mesh(self) -> tuple[Array, Array]:
        """Vertices (V, 3) m and faces (F, 3), closed and wound outwards."""
        triangles = self.solid.to_mesh64()
        return np.array(triangles.vert_properties[:, :3], order="C"), np.array(triangles.tri_verts, dtype=np.int64)


def repair(vertices: Array, faces: Array) -> RepairedSolid:
    """The solid that the triangles enclose: vertices (V, 3) m, faces (F, 3) in any winding.

    Overlapping pieces are united. A closed piece inside another with the opposite winding is a cavity. Raises
    `DataError`, without the file's name, if the triangles enclose no volume.
    """
    vertices, faces, notes = _cleaned(vertices, faces)
    if len(faces) < 4:
        raise DataError("fewer than four faces that have an area; expected a mesh that encloses a volume")
    spread = np.linalg.svd(vertices - vertices.mean(axis=0), compute_uv=False)
    if spread[2] < 1e-6 * spread[0]:
        raise DataError("the mesh is flat; expected one that encloses a volume: give the sheet a thickness")
    pieces, count = _pieces(vertices, faces)
    closed = _close(pieces)
    total = sum(piece.area for piece in pieces)
    reason = ""
    if not pieces:
        reason = f"{count} loose pieces"
    elif closed.capped > LARGEST_CAP * total:
        reason = f"holes make up {closed.capped / total:.0%} of the surface"
    elif closed.lost > LARGEST_LOSS * total:
        reason = f"{closed.lost / total:.0%} of the surface is of pieces that are open or enclose nothing"
    if reason:
        remade = rebuild(vertices, faces)
        if remade is None:
            raise DataError(f"{reason}, and no grid finds an inside: the surface has no thickness, or its opening "
                            "is too wide; give it a thickness, or close it first")
        return RepairedSolid(remade.solid, (*notes, f"built anew on a grid of {1000 * remade.pitch:.1f} mm ({reason})"))
    if closed.holes:
        what = "hole" if closed.holes == 1 else "holes"
        notes.append(f"{closed.holes} {what} closed ({closed.capped / total:.1%} of the surface)")
    if closed.lost:
        notes.append(f"{closed.lost / total:.1%} of the surface left out, it encloses nothing")
    solid, done = _united(closed.bodies)
    if solid.is_empty() or solid.volume() <= 0.0:
        raise DataError("the pieces enclose no volume; expected a solid")
    return RepairedSolid(solid, (*notes, *done))


def _area(vertices: Array, faces: Array) -> float:
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def _cleaned(vertices: Array, faces: Array) -> tuple[Array, Array, list[str]]:
    """Distinct vertices, distinct faces without empty ones and fins, and notes on what was done."""
    import trimesh

    notes: list[str] = []
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.remove_unreferenced_vertices()
    before = len(mesh.vertices)
    mesh.merge_vertices(merge_tex=True, merge_norm=True, digits_vertex=round(-np.log10(MERGE_DISTANCE)))
    if len(mesh.vertices) < before:
        notes.append(f"{before - len(mesh.vertices)} duplicate vertices merged")
    before = len(mesh.faces)
    a, b, c = mesh.faces.T
    mesh.update_faces((a != b) & (b != c) & (c != a))
    mesh.update_faces(mesh.unique_faces())
    if len(mesh.faces) < before:
        notes.append(f"{before - len(mesh.faces)} duplicate or empty faces removed")
    kept = _without_fins(np.asarray(mesh.faces))
    if len(kept) < len(mesh.faces):
        notes.append(f"{len(mesh.faces) - len(kept)} faces removed that stood off at an edge")
    return np.asarray(mesh.vertices, dtype=float), kept.astype(np.int64), notes


def _without_fins(faces: Array) -> Array:
    """Faces without fins, which have both an edge of three or more faces and a free edge; removed layer by layer."""
    while len(faces):
        edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]], axis=2).reshape(-1, 2)
        _, index, counts = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
        per_face = counts[index.reshape(-1)].reshape(-1, 3)
        fins = (per_face > 2).any(axis=1) & (per_face == 1).any(axis=1)
        if not fins.any():
            break
        faces = faces[~fins]
    return faces


@dataclass(frozen=True, eq=False)
class _Piece:
    """A connected piece: vertices, and faces in one winding if possible, the one of most faces in the file.

    area: m^2. outwards: whether that winding is outwards. mixed: whether the file winds the faces inconsistently.
    """

    vertices: Array
    faces: Array
    area: float
    outwards: bool
    mixed: bool


def _pieces(vertices: Array, faces: Array) -> tuple[list[_Piece], int]:
    """Connected pieces (none if there are more than `_MAX_PIECES`) and their number.

    Edges of three or more faces connect nothing.
    """
    import trimesh

    pieces: list[_Piece] = []
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    count = int(trimesh.graph.connected_component_labels(mesh.face_adjacency, node_count=len(faces)).max()) + 1
    if count > _MAX_PIECES:
        return pieces, count
    for part in mesh.split(only_watertight=False, repair=False):
        mixed = not part.is_winding_consistent
        if mixed:
            trimesh.repair.fix_winding(part)
        points, triangles = np.asarray(part.vertices, dtype=float), np.asarray(part.faces, dtype=np.int64)
        outwards = signed_volume(points, triangles) >= 0.0
        pieces.append(_Piece(points, triangles, _area(points, triangles), outwards, mixed))
    return pieces, count


@dataclass(eq=False)
class _Closed:
    """The pieces that are solids once their holes are closed, areas left out and capped (m^2), number of holes."""

    bodies: list[tuple[Body, _Piece]]
    lost: float = 0.0
    capped: float = 0.0
    holes: int = 0


def _close(pieces: list[_Piece]) -> _Closed:
    closed = _Closed([])
    total = sum(piece.area for piece in pieces)
    for piece in pieces:
        made = None
        if piece.area >= _SPECK * total:
            with contextlib.suppress(DataError):
                made = body([(piece.vertices, piece.faces)])
        cap = 0.0 if made is None else _area(made.vertices, made.faces) - piece.area
        if made is None or made.solid is None or cap > _LARGEST_LID * piece.area:
            closed.lost += piece.area
            continue
        closed.bodies.append((made, piece))
        closed.capped += max(cap, 0.0)
        closed.holes += made.holes
    return closed


def _united(closed: list[tuple[Body, _Piece]]) -> tuple[Any, list[str]]:
    """The union of the bodies minus their cavities, and notes on what was done."""
    notes = []
    ordered = sorted(closed, key=lambda entry: -entry[0].solid.volume())
    solid, cavities, turned = None, 0, 0
    for index, (own, piece) in enumerate(ordered):
        around = next((entry for entry in ordered[:index] if _within(own, entry[0])), None)
        if around is not None and piece.outwards != around[1].outwards:
            solid = solid - own.solid
            cavities += 1
            continue
        solid = own.solid if solid is None else solid + own.solid
        turned += piece.mixed or (around is None and not piece.outwards)
    if turned:
        notes.append("normals turned outwards")
    if len(ordered) - cavities > 1:
        notes.append(f"{len(ordered) - cavities} pieces united")
    if cavities:
        notes.append(f"{cavities} cavit{'ies' if cavities > 1 else 'y'} inside")
    return solid, notes


def _within(inner: Body, outer: Body) -> bool:
    """Whether a body lies inside another, judged by its box and some of its vertices."""
    if not ((inner.bounds[0] > outer.bounds[0]).all() and (inner.bounds[1] < outer.bounds[1]).all()):
        return False
    some = inner.vertices[:: max(1, len(inner.vertices) // 8)]
    return all(winding_grid(outer.vertices, outer.faces, point, 1.0, (1, 1, 1))[0, 0, 0] > 0 for point in some)
