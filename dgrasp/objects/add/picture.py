"""A picture of an added object: its mesh beside the shapes that collide for it, from two sides."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from dgrasp.types import Array
from raisim_like.shapes import Shape
from raisim_like.world import World

SIZE = 320
"""Edge of each of the four pictures, pixels."""
_MESH_COLOR = (0.25, 0.47, 0.75, 1.0)
_COLORS = ((0.86, 0.52, 0.24, 1.0), (0.93, 0.75, 0.35, 1.0), (0.73, 0.36, 0.27, 1.0), (0.80, 0.63, 0.52, 1.0),
           (0.62, 0.47, 0.20, 1.0))  # fmt: skip
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


def _views(solids: Sequence[tuple[Shape, tuple[float, ...]]], bounds: Array) -> list[Array]:
    """One picture (SIZE, SIZE, 3) uint8 per viewing side."""
    world = World("pybullet", 1.0)
    try:
        for shape, color in solids:
            world.add_body([shape], 0.0, np.eye(3)).set_color(color)
        middle = bounds.mean(axis=0)
        away = max(1.6 * float(np.linalg.norm(bounds[1] - bounds[0])), 0.05)
        eyes = [middle + away * np.array(side) / np.linalg.norm(side) for side in _SIDES]
        return [world.render(eye, middle, SIZE, SIZE).copy() for eye in eyes]
    finally:
        world.close()
