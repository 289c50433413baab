"""Make triangles into a closed surface: merge vertices, cap holes, wind faces outwards."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dgrasp.errors import DataError
from dgrasp.types import Array

MERGE_DISTANCE = 1e-7
"""m. Vertices that agree to this precision are merged; files repeat a vertex for every face or texture."""


@dataclass(frozen=True, eq=False)
class ClosedMesh:
    """A surface whose faces pass every edge equally often in both directions.

    vertices (V, 3) m, faces (F, 3) wound outwards. holes: the number of capped holes.
    """

    vertices: Array
    faces: Array
    holes: int

    @property
    def volume(self) -> float:
        """Enclosed volume, m^3; what the surface encloses twice counts twice."""
        return signed_volume(self.vertices, self.faces)


def signed_volume(vertices: Array, faces: Array) -> float:
    """Volume (m^3) that closed faces, wound outwards, enclose; negative if they are wound inwards."""
    # Relative to the mean vertex, because a distant origin would cost digits.
    a, b, c = np.moveaxis(vertices[faces] - vertices.mean(axis=0), 1, 0)
    return float((a * np.cross(b, c)).sum() / 6.0)


def close_mesh(vertices: Array, faces: Array) -> ClosedMesh:
    """The closed surface of triangles: vertices (V, 3) m and faces (F, 3).

    A fan from its rim to the rim's mean caps every hole, which is exact for a flat hole. Two rims that share a vertex
    are one hole. Raises `DataError` for triangles that enclose nothing.
    """
    vertices, faces = _merged(np.asarray(vertices, dtype=float), np.asarray(faces, dtype=np.int64))
    rims = _open_edges(faces, len(vertices))
    holes = 0
    if len(rims):
        vertices, caps, holes = _fans(vertices, rims)
        faces = np.concatenate([faces, caps])
    volume = signed_volume(vertices, faces) if len(faces) else 0.0
    if volume == 0.0 or not np.isfinite(volume):
        raise DataError(f"a mesh of {len(faces)} faces encloses no volume; expected a closed surface, or one with "
                        "holes to cap")
    return ClosedMesh(vertices, faces if volume > 0.0 else faces[:, ::-1], holes)


def is_closed(faces: Array, n_vertices: int) -> bool:
    """Whether the faces (F, 3) pass every edge equally often in both directions."""
    return not len(_open_edges(np.asarray(faces, dtype=np.int64), n_vertices))


def _merged(vertices: Array, faces: Array) -> tuple[Array, Array]:
    """The same triangles on distinct vertices, without those that lose their area."""
    _, first, index = np.unique(np.round(vertices / MERGE_DISTANCE), axis=0, return_index=True, return_inverse=True)
    faces = index.reshape(-1)[faces]
    a, b, c = faces.T
    return vertices[first], faces[(a != b) & (b != c) & (c != a)]


def _open_edges(faces: Array, n_vertices: int) -> Array:
    """(E, 2) edges from a to b without a counterpart from b to a, each as often as a counterpart is missing."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    low, high = edges.min(axis=1), edges.max(axis=1)
    keys, index = np.unique(low * n_vertices + high, return_inverse=True)
    excess = np.bincount(index, np.where(edges[:, 0] == low, 1, -1), len(keys)).astype(int)
    ends = np.stack([keys // n_vertices, keys % n_vertices], axis=1)
    ends = np.where(excess[:, None] < 0, ends[:, ::-1], ends)
    return np.repeat(ends, np.abs(excess), axis=0)


def _fans(vertices: Array, rims: Array) -> tuple[Array, Array, int]:
    """Vertices with the fans' middles appended, the fans' faces, and the number of fans."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    on_rim, edges = np.unique(rims, return_inverse=True)
    edges = edges.reshape(-1, 2)
    links = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(len(on_rim), len(on_rim)))
    count, rim = connected_components(links, directed=False)
    middles = np.stack([vertices[on_rim[rim == k]].mean(axis=0) for k in range(count)])
    # A cap's edges run opposite to those of the faces that it meets.
    caps = np.column_stack([rims[:, 1], rims[:, 0], len(vertices) + rim[edges[:, 0]]])
    return np.concatenate([vertices, middles]), caps, int(count)
