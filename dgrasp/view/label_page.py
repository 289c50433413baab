"""A self-contained HTML page with a picture of every label, the worst first."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from PIL import Image

from dgrasp.geometry.raster import Camera
from dgrasp.hand.model import HandModel
from dgrasp.labels.quality.measure import Finding
from dgrasp.objects.model import ObjectModel
from dgrasp.scene.scene import TABLE_TOP
from dgrasp.types import Array, GraspLabel
from dgrasp.view.frames import Stage
from dgrasp.view.meshes import scene_meshes

SIZE = (280, 210)
_EYE = np.array([0.36, -0.32, 0.26])
"""m. The camera's place relative to the point that it looks at."""
_ASIDE = 0.06
"""m. The camera looks at most this far beside the object, towards the wrist."""
_STYLE = """
body { font: 14px/1.4 system-ui, sans-serif; margin: 2em; color: #222; } ul { padding-left: 1.2em; }
@media (max-width: 640px) { body { margin: 1em; } }
.labels { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(280px, 100%), 1fr)); gap: 1em; }
figure { margin: 0; border: 1px solid #ddd; } figure.bad { border-color: #c33; }
img { width: 100%; display: block; } figcaption { padding: .5em; } .problem { color: #c33; }
table { border-collapse: collapse; margin: 1em 0; } td, th { padding: .1em .8em; text-align: right; }
td:first-child, th:first-child { text-align: left; }
"""


def label_pictures(
    labels: Sequence[GraspLabel], hand: HandModel, objects: Mapping[str, ObjectModel], shapes: bool = False
) -> dict[int, Array]:
    """Pictures (height, width, 3) uint8 of the grasps, by label index; one stage per object draws all its labels.

    shapes: draw the collision shapes in place of the surfaces.
    """
    pictures: dict[int, Array] = {}
    for name in dict.fromkeys(label.object_id for label in labels):
        meshes = scene_meshes(hand, objects[name])
        stage = Stage(meshes.colliding() if shapes else meshes)
        for i, label in enumerate(labels):
            if label.object_id == name:
                R, t = hand.part_poses(label.T_WH[None], label.hand_pose[None])
                R, t = np.concatenate([R[0], label.T_WO[None, :3, :3]]), np.concatenate([t[0], label.T_WO[None, :3, 3]])
                middle = _middle(label)
                camera = Camera(middle + _EYE, middle, SIZE)
                pictures[i] = stage.picture(R, t, TABLE_TOP if label.on_table else None, camera)
    return pictures


def _middle(label: GraspLabel) -> Array:
    """(3,) m, world: a point between object and wrist, nearer to the object."""
    aside = 0.35 * (label.T_WH[:3, 3] - label.T_WO[:3, 3])
    return np.asarray(label.T_WO[:3, 3] + aside * min(1.0, _ASIDE / max(float(np.linalg.norm(aside)), 1e-9)))


def label_page(title: str, summary: Iterable[str], findings: Sequence[Finding], pictures: Mapping[int, Array]) -> str:
    """The HTML of the page. summary: lines above the pictures. pictures: by the findings' indices."""
    order = sorted(range(len(findings)), key=lambda i: -findings[i].badness)
    head = "".join(f"<li>{html.escape(line)}</li>" for line in summary)
    body = "\n".join(_figure(findings[i], pictures.get(i)) for i in order)
    return (f"<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">"
            f"<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">"
            f"<title>{html.escape(title)}</title><style>{_STYLE}</style></head>\n<body><h1>{html.escape(title)}</h1><ul>{head}</ul>\n"
            f"<div class=\"labels\">\n{body}\n</div></body></html>\n")


def _figure(finding: Finding, picture: Array | None) -> str:
    depth = "not measured" if finding.penetration_cm3 is None else f"{finding.penetration_cm3:.1f} cm3"
    table = "no table" if finding.table_mm is None else f"{round(finding.table_mm, 1) + 0.0:+.1f} mm above the table"
    text = (f"penetration {depth}, distance {finding.distance_mm:.1f} mm, {finding.contacts} goal contacts, "
            f"{finding.beyond_limits} angles beyond limits (by up to {finding.limit_excess_deg:.0f} degrees), {table}")
    problems = "".join(f"<div class=\"problem\">{html.escape(problem)}</div>" for problem in finding.problems)
    image = "" if picture is None else f"<img alt=\"the grasp\" src=\"{_data_url(picture)}\">"
    kind = "bad" if problems else "sound"
    return (f"<figure class=\"{kind}\">{image}<figcaption><b>{html.escape(finding.label.name)}</b>"
            f"{problems}<div>{html.escape(text)}</div></figcaption></figure>")


def _data_url(picture: Array) -> str:
    stream = io.BytesIO()
    Image.fromarray(picture).save(stream, "JPEG", quality=82)
    return "data:image/jpeg;base64," + base64.b64encode(stream.getvalue()).decode("ascii")
