"""Cut the skin of a hand into one closed mesh per rigid part, by the largest skinning weight.

A face belongs to the part with the largest weight summed over its corners. Going from the fingertips to the palm,
each part is closed by a fan over every loop that is left open, and its parent gets the same fan from the other
side. So the parts share their cuts and overlap only where a fan bulges. Wherever parts meet, their volumes add up to
the hand's, to rounding.
"""

from __future__ import annotations

import numpy as np

from dgrasp.errors import DataError
from dgrasp.geometry.part_mesh import PartMesh, mesh_volume
from dgrasp.hand.mano.skeleton import N_PARTS, PART_PARENT, PARTS
from dgrasp.types import Array


def segment(vertices: Array, faces: Array, weights: Array, joints: Array) -> list[PartMesh]:
    """The 16 parts, order of `skeleton.PARTS`, of a hand's skin.

    vertices (V, 3) m and joints (16, 3) m at the zero pose, in one frame; faces (F, 3), wound outwards, open at the
    wrist or closed; weights (V, 16), order of the parts. A part's frame has its joint as origin and parallel axes.
    Raises `DataError` if the surface is not a hand's: an edge of more than two faces, inconsistent winding, a part
    without faces.
    """
    owner = weights[faces].sum(axis=1).argmax(axis=1)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    if len(np.unique(edges, axis=0)) < len(edges):
        raise DataError("the hand's surface has an edge of more than two faces, or faces wound both ways; "
                        "expected one skin, wound outwards")
    points = [np.asarray(vertices, dtype=float)]
    surfaces = [[faces[owner == part]] for part in range(N_PARTS)]
    parts: list[PartMesh] = []
    for part in reversed(range(N_PARTS)):
        if not (owner == part).any():
            raise DataError(f"no face of the hand belongs to {PARTS[part]}; expected weights for all 16 parts")
        open_faces = np.concatenate(surfaces[part])
        first = sum(len(p) for p in points)
        caps, centers = _fans(open_faces, np.concatenate(points), first)
        points.append(centers)
        if part:
            surfaces[PART_PARENT[part]].append(caps[:, ::-1])
        mesh = _compact(PARTS[part], np.concatenate(points), np.concatenate([open_faces, caps]), joints[part])
        if not mesh.volume > 0.0:
            raise DataError(f"{PARTS[part]} encloses no volume; expected faces wound outwards (and betas that leave "
                            "a hand)")
        parts.append(mesh)
    return parts[::-1]


def closed_volume(vertices: Array, faces: Array) -> float:
    """Volume in m^3 of the whole skin (V, 3) m, (F, 3), its wrist closed as `segment` closes it."""
    caps, centers = _fans(faces, vertices, len(vertices))
    return mesh_volume(np.concatenate([vertices, centers]), np.concatenate([faces, caps]))


def _fans(faces: Array, points: Array, first: int) -> tuple[Array, Array]:
    """Triangles (C, 3) that close `faces`, one fan per loop, and the fans' centres (L, 3), numbered from `first`."""
    caps: list[list[int]] = []
    centers: list[Array] = []
    for loop in _loops(faces):
        apex = first + len(centers)
        centers.append(points[loop].mean(axis=0))
        # A cap's edges run against those of the faces that it meets.
        caps += [[b, a, apex] for a, b in zip(loop, np.roll(loop, -1), strict=True)]
    return np.array(caps, dtype=np.int64).reshape(-1, 3), np.array(centers).reshape(-1, 3)


def _loops(faces: Array) -> list[list[int]]:
    """The open edges of `faces` as closed paths that visit no vertex twice."""
    directed = [tuple(map(int, edge)) for f in faces for edge in ((f[0], f[1]), (f[1], f[2]), (f[2], f[0]))]
    count: dict[tuple[int, int], int] = {}
    for a, b in directed:
        if count.get((b, a), 0):
            count[b, a] -= 1
        else:
            count[a, b] = count.get((a, b), 0) + 1
    following: dict[int, list[int]] = {}
    for a, b in directed:
        if count.get((a, b), 0):
            count[a, b] -= 1
            following.setdefault(a, []).append(b)
    loops: list[list[int]] = []
    for start in following:
        while following[start]:
            path = [start]
            while True:
                after = following[path[-1]].pop()
                if after in path:
                    # The path has come back to itself: the part since then is a loop of its own.
                    at = path.index(after)
                    loops.append(path[at:])
                    del path[at + 1 :]
                    if at == 0:
                        break
                else:
                    path.append(after)
    return loops


def _compact(name: str, points: Array, faces: Array, origin: Array) -> PartMesh:
    used, index = np.unique(faces, return_inverse=True)
    return PartMesh(name, points[used] - origin, index.reshape(faces.shape))
