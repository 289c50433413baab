"""The report of a test as one HTML file that works offline: numbers, charts, replays, and downloads of the data."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from dgrasp.eval import failures, output
from dgrasp.eval.latex import latex_text
from dgrasp.eval.summary import Result
from dgrasp.files.atomic import write_atomic
from dgrasp.report import charts, replay
from dgrasp.types import EpisodeRecord
from dgrasp.view.meshes import DisplayMeshes

_ASSETS = Path(__file__).parent
_POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:"
"""Content security policy: the browser enforces that the page loads nothing, so it stays self-contained."""

_METHODS = {"gt_pd": "PD control holds the pose of each label.", "policy": "A trained policy grasps from each label.",
            "gt_ik": "PD control holds the pose of each label after its contacts were moved to the object's surface."}


def write_report(
    path: Path, result: Result, records: Sequence[EpisodeRecord], meshes: Mapping[str, DisplayMeshes],
    extra: Mapping[str, Any] | None = None, shapes: bool = False,
) -> None:
    """Write `html_text` atomically."""
    write_atomic(path, html_text(result, records, meshes, extra, shapes))


def shown_episodes(result: Result, records: Sequence[EpisodeRecord]) -> list[tuple[str, EpisodeRecord, dict[str, Any]]]:
    """(group, record, row) of the replays: the worst episodes, worst first, then the best, best first."""
    places = [i for i, record in enumerate(records) if len(record.gc)]
    worst, best = replay.chosen([result.per_label[i] for i in places])
    groups = [("worst", i) for i in worst] + [("best", i) for i in best]
    return [(group, records[places[i]], result.per_label[places[i]]) for group, i in groups]


def html_text(
    result: Result, records: Sequence[EpisodeRecord], meshes: Mapping[str, DisplayMeshes],
    extra: Mapping[str, Any] | None = None, shapes: bool = False,
) -> str:
    """The HTML of the page.

    records: the records of the result's rows, in their order. meshes: by object, at least for the objects of
    `shown_episodes`. extra: further entries of the JSON. shapes: whether the replays begin with the collision shapes.
    """
    dt = records[0].dt
    shown = shown_episodes(result, records)
    used = {record.label.object_id for _, record, _ in shown}
    data = replay.pack(shown, {name: of for name, of in meshes.items() if name in used}) if shown else None
    sections = [
        _head(result),
        _figures(result),
        replays_section(shown, shapes) if data else "",
        _section("bars", "By object" + (", beside the paper" if result.paper else ""),
                 _key(result) + f'<div class="scroll">{charts.bars(result)}</div>'),
        _window(result, dt) if "success" in result.mean_over_labels else "",
        _section("numbers", "All numbers", _table(result) + _remarks(result)),
        _downloads(result, extra),
    ]
    return document(output.title(result), sections, data)


def document(title: str, sections: Sequence[str], data: Mapping[str, Any] | None) -> str:
    """The HTML of a page with these sections. data: from `replay.pack` if the page has `replays_section`, else None."""
    scripts = "".join(f"<script>{(_ASSETS / name).read_text(encoding='utf-8')}</script>\n"
                      for name in ("viewer.js", "page.js")) if data else ""
    # "<" could end the script element, so it is written as a JSON escape.
    packed = json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<title>{escape(title)} \u2013 D-Grasp</title>\n"
        f"<style>{(_ASSETS / 'report.css').read_text(encoding='utf-8')}</style>\n"
        f"</head>\n<body>\n<main>\n{''.join(sections)}</main>\n"
        f'<script type="application/json" id="replay-data">{packed}</script>\n{scripts}</body>\n</html>\n'
    )


def _window(result: Result, dt: float) -> str:
    """The sections that show when and how grasps were lost."""
    times, shares = failures.held_over_time(result.per_label, result.window_s, dt)
    paper = (result.paper or {}).get("success", {}).get("average")
    found = failures.report(result.per_label, result.window_s, dt)["failures"]
    about = ('<p class="lead">Share of grasps not yet lost: a thin line for each object, a thick line for their '
             "mean.</p>")
    over_time = _section("over-time", "Success over time", about + charts.held(times, shares, paper))
    kinds = _section("failures", "Where grasps fail", _kinds(found["all"]))
    return (f'<div class="two"><div>{over_time}{kinds}</div>'
            f'{_section("outcomes", "Outcomes by object", charts.failures(found))}</div>')


def _section(name: str, heading: str, content: str) -> str:
    return f'<section id="{name}"><h2>{escape(heading)}</h2>\n{content}</section>\n'


def _head(result: Result) -> str:
    data = result.data
    labels = data.get("labels", "")
    facts = {
        "Engine": result.engine, "Window": f"{result.window_s:g} s",
        "Labels": f"{result.n_labels}, of {len(result.per_object)} objects ({labels})", "Hand": data.get("hand"),
        "Inertia": output.inertia(result),
        "Seed": result.seed, "Code": str(result.commit)[:12], "Licence": data.get("licence"),
    }
    items = "".join(f"<div><dt>{name}</dt><dd>{escape(str(value))}</dd></div>"
                    for name, value in facts.items() if value)
    split = f"{data.get('source')} {data.get('split')}" if data.get("source") != "file" else labels
    notice = "".join(f'<p class="notice">{escape(line[0].upper() + line[1:])}.</p>' for line in output.notices(result))
    task = f"The table is taken away, and the object must stay in the hand for {result.window_s:g} s."
    if result.motion is not None:
        task = "The wrist then carries the object to its targets."
    lead = f"{_METHODS.get(result.method, '')} {task}".strip()
    return (f'<header><p class="over">D-Grasp evaluation</p><h1>{escape(result.method)} <span>on {escape(str(split))} '
            f'labels</span></h1><p class="lead">{escape(lead)}</p>{notice}<dl>{items}</dl></header>\n')


def _figures(result: Result) -> str:
    """Tiles with the main numbers in large type."""
    tiles = []
    for metric in charts.shown_metrics(result):
        heading, unit, form = charts.PANELS[metric]
        notes = []
        span = result.intervals["mean_over_objects"].get(metric)
        if span:
            notes.append(f"95% interval {form.format(span[0])} to {form.format(span[1])}")
        if metric in (result.paper or {}):
            assert result.paper is not None
            notes.append(f"paper <b>{form.format(result.paper[metric]['average'])}</b>")
        tiles.append(f'<div class="tile"><p>{escape(heading)}</p><p class="big">'
                     f"{form.format(result.mean_over_objects[metric])}</p><p>{escape(unit)}</p>"
                     f"{''.join(f'<p class=note>{note}</p>' for note in notes)}</div>")
    return f'<div class="tiles" aria-label="Means over objects">{"".join(tiles)}</div>\n'


def _key(result: Result) -> str:
    diamond = '<svg width="14" height="14"><path class="paper" d="M7 1.5l5.5 5.5-5.5 5.5-5.5-5.5z"/></svg>'
    whisker = '<svg width="18" height="14"><line class="whisker" x1="1" x2="17" y1="7" y2="7"/></svg>'
    return (f'<p class="key"><span><i class="ours"></i>here</span><span>{whisker}95% interval</span>'
            f'{f"<span>{diamond}paper</span>" if result.paper else ""}</p>')


def _kinds(found: Mapping[str, int]) -> str:
    """The table of outcomes with counts and meanings, which is also the key of the chart."""
    total = sum(found.values())
    meanings = {"held": "in the hand until the end of the window", **failures.MEANINGS}
    rows = "".join(
        f'<tr><th scope="row"><i class="k-{kind}"></i>{kind}</th><td>{found[kind]}</td>'
        f"<td>{100.0 * found[kind] / total:.0f}%</td><td>{escape(meaning)}</td></tr>"
        for kind, meaning in meanings.items()
    )
    return ('<table class="kinds"><thead><tr><th>outcome</th><th>labels</th><th>share</th><th></th></tr></thead>'
            f"<tbody>{rows}</tbody></table>")


def replays_section(shown: Sequence[tuple[str, EpisodeRecord, dict[str, Any]]], shapes: bool = False) -> str:
    """The viewer, and a button for each episode (group, record, row), in the order of `replay.pack`.

    shapes: whether the viewer begins with the collision shapes.
    """
    thumbs: dict[str, list[str]] = {}
    for place, (group, _, row) in enumerate(shown):
        said = replay.told(row)
        if "lost_s" in row:
            said += f" \u00b7 {row['lost_s']:.2f} s"
        elif "mpe_m" in row:
            said += f" \u00b7 {1000.0 * row['mpe_m']:.0f} mm off"
        elif "sim_dist_mm_per_step" in row:
            said += f" \u00b7 {row['sim_dist_mm_per_step']:.1f} mm/step"
        kind = escape(str(row.get("failure", "held" if row.get("carried", True) else "drop")), quote=True)
        thumbs.setdefault(group, []).append(
            f'<button class="thumb" data-replay="{place}" aria-pressed="false"><canvas></canvas>'
            f"<b>{escape(str(row['object']))} [{escape(str(row['index']))}]</b>"
            f'<span><i class="k-{kind}"></i>{escape(said)}</span></button>'
        )
    strips = "".join(
        f'<h3>{escape(group.capitalize())} {len(buttons)}</h3><div class="strip">{"".join(buttons)}</div>'
        for group, buttons in thumbs.items()
    )
    return _section("replays", "Replays", f"""
<noscript><p class="notice">The replays need JavaScript. All scripts are part of this file; it loads nothing else.</p>
</noscript>
<p class="notice" id="no-webgl" hidden>This browser does not support WebGL 2, so it cannot show the replays; all numbers
are below.</p>
<div id="viewer">
<div class="caption"><b id="replay-title"></b><span id="replay-facts"></span></div>
<div class="stage"><canvas id="stage" tabindex="0" role="img"></canvas>
<div class="corner"><button id="home" title="Return to the initial view">Reset view</button>
<button id="full" title="Fill the window (Escape to leave)">Full window</button></div>
<p class="legend"><span><i class="gl-hand"></i>hand</span><span><i class="gl-contact"></i>part in contact</span>
<span><i class="gl-object"></i>object</span><span id="ghost-key" hidden><i class="gl-ghost"></i>surface</span></p></div>
<div class="controls"><button id="play" aria-label="Play"></button>
<div class="timeline"><input type="range" id="scrub" min="0" max="1" step="any" value="0" aria-label="Time">
<i id="mark-table" ></i><i id="mark-loss" title="lost"></i></div>
<output id="time"></output><output id="phase"></output>
<label>speed <select id="speed"><option value="0.1">0.1\u00d7</option><option value="0.25">0.25\u00d7</option>
<option value="0.5">0.5\u00d7</option><option value="1" selected>1\u00d7</option>
<option value="2">2\u00d7</option></select></label>
<label class="of-shapes" title="What the physics collides (key s)"><input type="checkbox" id="shapes"
autocomplete="off"{" checked" if shapes else ""}> collision shapes</label></div></div>
<p class="hint">Drag to rotate, pinch or scroll (after a click) to zoom, arrow keys for single steps, space to play<span
class="of-shapes">, s to see the collision shapes</span>.</p>
{strips}""")


def _table(result: Result) -> str:
    header, rows = output.table_cells(result)
    head = "".join(f'<th scope="col"{" class=paper-column" if name == "paper" else ""}>{escape(name)}</th>'
                   for name in header)
    body = ""
    for place, row in enumerate(rows):
        cells = "".join(f"<td{' class=paper-column' if header[k] == 'paper' else ''}>{escape(cell)}</td>"
                        for k, cell in enumerate(row) if k)
        mean = ' class="mean"' if place >= len(rows) - 2 else ""
        body += f'<tr{mean}><th scope="row">{escape(row[0])}</th>{cells}</tr>\n'
    rows_html = f"<thead><tr>{head}</tr></thead>\n<tbody>{body}</tbody>"
    return f'<div class="scroll"><table id="results">{rows_html}</table></div>'


def _remarks(result: Result) -> str:
    return f'<ul class="remarks">{"".join(f"<li>{escape(line)}</li>" for line in output.remarks(result))}</ul>'


def _downloads(result: Result, extra: Mapping[str, Any] | None) -> str:
    files = [("csv", "text/csv", "CSV (one row per label)", output.csv_text(result)),
             ("json", "application/json", "JSON", output.json_text(result, extra)),
             ("tex", "application/x-tex", "LaTeX table", latex_text(result)),
             ("md", "text/markdown", "Markdown", output.markdown_text(result))]
    links = "".join(
        f'<a download="{escape(result.method)}.{kind}" href="data:{mime};base64,'
        f'{base64.b64encode(text.encode("utf-8")).decode("ascii")}">{name}</a> ' for kind, mime, name, text in files
    )
    return f'<footer><p>Save the numbers: {links}</p></footer>\n'
