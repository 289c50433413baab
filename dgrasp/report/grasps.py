"""The report of `dgrasp grasp` as one HTML file that works offline: the ranking, and replays of grasps and motions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from dgrasp.report import replay
from dgrasp.report.page import document, replays_section
from dgrasp.types import EpisodeRecord
from dgrasp.view.meshes import DisplayMeshes

MOST = 40
"""Most replays on the page; each adds about 50 kB."""

Shown = Sequence[tuple[str, EpisodeRecord, dict[str, Any]]]
"""Episodes to replay: group, record, and row of the result."""


def grasps_page(
    title: str, lead: str, facts: Mapping[str, Any], table: tuple[Sequence[str], Sequence[Sequence[str]]], shown: Shown,
    meshes: Mapping[str, DisplayMeshes],
) -> str:
    """The HTML of the page.

    facts: what stands in its head, by name. table: header and rows. shown: the first `MOST` are replayed. meshes: by
    object.
    """
    replayed = shown[:MOST]
    items = "".join(f"<div><dt>{escape(name)}</dt><dd>{escape(str(value))}</dd></div>"
                    for name, value in facts.items())
    head = (f'<header><p class="over">D-Grasp grasps</p><h1>{escape(title)}</h1><p class="lead">{escape(lead)}</p>'
            f"<dl>{items}</dl></header>\n")
    header, rows = table
    cells = "".join(f'<th scope="col">{escape(name)}</th>' for name in header)
    body = "".join(f'<tr><th scope="row">{escape(row[0])}</th>' + "".join(f"<td>{escape(c)}</td>" for c in row[1:])
                   + "</tr>\n" for row in rows)
    ranking = ('<section id="ranking"><h2>Ranking</h2>\n<div class="scroll"><table id="results"><thead><tr>'
               f"{cells}</tr></thead>\n<tbody>{body}</tbody></table></div></section>\n")
    if not replayed:
        return document(title, [head, ranking], None)
    return document(title, [head, replays_section(replayed), ranking], replay.pack(replayed, meshes))
