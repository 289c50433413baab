"""A picture of an added object: its mesh beside the shapes that collide for it, from two sides."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from dgrasp.geometry.raster import Camera, draw, shaded
from dgrasp.geometry.shape_mesh import shape_mesh
from dgrasp.types import Array
from raisim_like.shapes import Shape

SIZE = 320
"""Edge of each of the four pictures, pixels."""
_MESH_COLOR = (0.25, 0.47, 0.75)
_COLORS = ((0.86, 0.52, 0.24), (0.93, 0.75, 0.35), (0.73, 0.36, 0.27), (0.80, 0.63, 0.52),
           (0.62, 0.47, 0.20))  # fmt: skip
_SIDES = ((1.0, -0.9, 0.7), (-0.5, -0.6, 1.2))


def picture(mesh: Path, shapes: Sequence[Shape], bounds: Array, titles: tuple[str, str]) -> bytes:
    """A PNG: the mesh file on the left and the shapes on the right, each under its title.

    bounds: (2, 3) m, lowest and highest corner of the mesh.
    """
    columns = [_views([(Shape("mesh", file=mesh), _MESH_COLOR)], bounds),
               _views([(shape, _COLORS[i % len(_COLORS)]) for i, shape in enumerate(shapes)], bounds)]
    sheet = Image.new("RGB", (2 * SIZE, 2 * SIZE), "white")
    for column, (views, title) in enumerate(zip(columns, titles, strict=True)):
        for row, view in enumerate(views):
            sheet.paste(Image.fromarray(view), (column * SIZE, row * SIZE))
        ImageDraw.Draw(sheet).text((column * SIZE + 8, 6), title, fill="black")
    stream = io.BytesIO()
    sheet.save(stream, "PNG")
    return stream.getvalue()


def _views(shapes: Sequence[tuple[Shape, tuple[float, ...]]], bounds: Array) -> list[Array]:
    """One picture (SIZE, SIZE, 3) uint8 per viewing side."""
    solids = [shaded(*shape_mesh(shape), color) for shape, color in shapes]
    middle = bounds.mean(axis=0)
    away = max(1.6 * float(np.linalg.norm(bounds[1] - bounds[0])), 0.05)
    eyes = [middle + away * np.array(side) / np.linalg.norm(side) for side in _SIDES]
    return [draw(solids, Camera(eye, middle, (SIZE, SIZE))) for eye in eyes]
