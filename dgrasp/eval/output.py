"""Print and write a result: a table on the terminal, JSON, CSV and Markdown."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from dgrasp.config.sections import INERTIA
from dgrasp.eval.summary import Result
from dgrasp.files.atomic import write_atomic

NOT_COMPARABLE = "not comparable with the paper"
UNSEEN_TABLE = "the paper's numbers for such objects are a table of their own (test --table unseen)"
NO_COLUMN = "the paper has no numbers for this method on these labels"

_TITLES = {
    "success": ("success", "{:.2f}"),
    "sim_dist_mm_per_step": ("SimDist mm/step", "{:.1f}"),
    "sim_dist_mm_per_s": ("SimDist mm/s", "{:.0f}"),
    "sim_dist_wrist_mm_per_step": ("SimDist to wrist mm/step", "{:.1f}"),
    "contact_ratio": ("contact ratio", "{:.2f}"),
    "interpenetration_cm3": ("interpen. cm3", "{:.2f}"),
    "interpenetration_shell_cm3": ("interpen. by shell cm3", "{:.2f}"),
    "label_distance_mm": ("distance to the label's grasp mm", "{:.1f}"),
    "label_angles_deg": ("finger angles off the label's deg", "{:.1f}"),
    "mpe_m": ("MPE m", "{:.3f}"),
    "geodesic_rad": ("geodesic rad", "{:.2f}"),
    "path_mpe_m": ("MPE on the way m", "{:.3f}"),
    "path_geodesic_rad": ("geodesic on the way rad", "{:.2f}"),
    "carried": ("carried", "{:.2f}"),
}

_WITH_INTERVAL = ("success", "sim_dist_mm_per_step", "interpenetration_cm3", "mpe_m", "geodesic_rad")
_FILES_ALONE = ("sim_dist_mm_per_s", "sim_dist_wrist_mm_per_step", "interpenetration_shell_cm3",
                "label_distance_mm", "label_angles_deg")


def print_table(result: Result, console: Console | None = None) -> None:
    """Print the result as a table, beside the paper's numbers if they are comparable, else below a line that says why.

    The table fits 80 columns: it shows SimDist only in the unit of the paper's tables, and the contact ratio only if
    there is room. The files hold all metrics.
    """
    console = console or Console()
    _print_lines(notices(result), console)
    crowded = result.paper is not None and "interpenetration_cm3" in result.mean_over_labels
    header, rows = table_cells(result, skip=(*_FILES_ALONE, "contact_ratio") if crowded else _FILES_ALONE)
    table = Table(title=escape(title(result)), title_justify="left", show_footer=False, box=box.SIMPLE_HEAD,
                  padding=(0, 1, 0, 0), pad_edge=False)
    for i, name in enumerate(header):
        table.add_column(escape(name), justify="left" if i == 0 else "right", no_wrap=i == 0)
    for i, row in enumerate(rows):
        table.add_row(*(escape(cell) for cell in row), end_section=i == len(rows) - 3)
    console.print(table)
    _print_lines(remarks(result), console)


def _print_lines(lines: Sequence[str], console: Console) -> None:
    for line in lines:
        console.print(line, markup=False, highlight=False)


def title(result: Result) -> str:
    """One line: method, engine, window or motion, number of labels."""
    if result.motion is not None:
        return (f"{result.method}, {result.engine}, motion: {result.motion['targets']}, {result.motion['steps']} "
                f"steps, {len(result.per_label)} motions of {result.n_labels} labels")
    return f"{result.method}, {result.engine}, window {result.window_s:g} s, {result.n_labels} labels"


def notices(result: Result) -> list[str]:
    """Lines above the table: why the paper's numbers are not beside ours. Empty if they are."""
    if not result.data.get("comparable_with_paper"):
        why = "; ".join(result.data.get("not_comparable") or ["hand or labels are not the paper's"])
        return [f"{NOT_COMPARABLE}: {why}"]
    if result.data.get("unseen_objects"):
        return [f"the policy was not trained on {', '.join(result.data['unseen_objects'])}; {UNSEEN_TABLE}"]
    return [NO_COLUMN] if result.paper is None else []


def remarks(result: Result) -> list[str]:
    """Lines under the table: the comparison with the paper, and the hand, labels, seed and code."""
    lines = []
    if result.correlation_with_paper:
        pairs = ", ".join(f"{_name(k)} {v:.2f}" for k, v in result.correlation_with_paper.items())
        lines.append(f"correlation with the paper over objects: {pairs}")
    means = result.intervals["mean_over_objects"]
    spans = ", ".join(f"{_name(k)} {_number(k, means[k][0])} to {_number(k, means[k][1])}" for k in _WITH_INTERVAL
                      if k in means)
    if spans:
        lines.append(f"95% intervals of the means over objects (bootstrap over their labels): {spans}")
    off = result.mean_over_objects
    if "label_distance_mm" in off:
        lines.append(f"finished grasps are {off['label_distance_mm']:.1f} mm from the labels' (key points, object's "
                     f"frame), finger angles {off['label_angles_deg']:.1f} degrees")
    lines += _about_interpenetration(result)
    if result.motion is not None and result.motion.get("left_out"):
        lines.append(f"{len(result.motion['left_out'])} of {result.motion['n_grasps']} grasps did not pass the "
                     f"stability test of {result.window_s:g} s and were left out, as in the paper")
    used = [f"{key} {result.data[key]}" for key in ("hand", "labels", "licence") if key in result.data]
    used += filter(None, [inertia(result)])
    return [*lines, "; ".join([*used, f"seed {result.seed}", f"code {result.commit}"])]


def inertia(result: Result) -> str:
    """The inertia that the objects had, in words; empty if the result does not say."""
    return INERTIA.get(result.data.get("inertia", ""), "")


def _about_interpenetration(result: Result) -> list[str]:
    """Lines about interpenetration: the meshes, doubtful measurements, and the paper's way of measuring."""
    about, mean = result.interpenetration, result.mean_over_objects
    if about is None or not about["measured"]:
        return []
    line = f"interpenetration: the hand's {about['hand_mesh']}, objects' {about['object_mesh']} meshes"
    line = line.replace("collision shapes meshes", "collision shapes")
    if not about["as_in_the_paper"]:
        line += "; the paper has MANO's skin and detailed object meshes"
    if about["holes_capped_in_objects"]:
        line += f"; {about['holes_capped_in_objects']} holes capped in the objects"
    if about["doubtful"] or about["failed"]:
        line += (f"; doubtful on {len(about['doubtful'])} labels (booleans and points differ), failed on "
                 f"{len(about['failed'])}")
    lines = [f"{line}; {about['seconds_per_episode']:.2f} s per label"]
    if result.paper is not None and "interpenetration_shell_cm3" in result.paper:
        lines.append("the paper's interpenetration counts 5 mm cubes of the object's surface (docs/metrics.md); "
                     f"counted that way: {mean['interpenetration_shell_cm3']:.2f} cm3, paper "
                     f"{result.paper['interpenetration_shell_cm3']['average']:.2f}")
    return lines


def table_cells(result: Result, skip: Collection[str] = ()) -> tuple[list[str], list[list[str]]]:
    """Header and rows of the table as text: objects, then the means over objects and over labels."""
    metrics = [*_TITLES, *(m for m in result.mean_over_labels if m not in _TITLES)]
    metrics = [m for m in metrics if m in result.mean_over_labels and m not in skip]
    paper = result.paper or {}
    header = ["object", "n"]
    for metric in metrics:
        header += [_name(metric)] + (["paper"] if metric in paper else [])
    entries = list(result.per_object.items())
    entries.append(("mean over objects", {"n": len(result.per_object), **result.mean_over_objects}))
    entries.append(("mean over labels", {"n": len(result.per_label), **result.mean_over_labels}))
    rows = []
    for name, means in entries:
        row = [name, f"{means['n']:g}"]
        for metric in metrics:
            row.append(_number(metric, means.get(metric)))
            if metric in paper:
                row.append(_number(metric, paper[metric].get("average" if name == "mean over objects" else name)))
        rows.append(row)
    return header, rows


def json_text(result: Result, extra: Mapping[str, Any] | None = None) -> str:
    """The JSON of the result, with the entries of `extra`; raises `ValueError` for NaN or infinity."""
    return json.dumps({**result.as_dict(), **(extra or {})}, indent=2, allow_nan=False) + "\n"


def csv_text(result: Result) -> str:
    """CSV with one line per label in the label file's order; the cell of a missing metric is empty."""
    columns = list(dict.fromkeys(key for row in result.per_label for key in row))
    stream = io.StringIO()
    writer = csv.DictWriter(stream, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(result.per_label)
    return stream.getvalue()


def markdown_text(result: Result) -> str:
    """The table as Markdown, between its notices and its remarks."""
    header, rows = table_cells(result)
    lines = [f"## {title(result)}", "", *(f"**{line}**\n" for line in notices(result))]
    lines += [_markdown_row(header), _markdown_row(["---"] + ["---:"] * (len(header) - 1))]
    lines += [_markdown_row(row) for row in rows]
    return "\n".join([*lines, "", *(f"- {line}" for line in remarks(result))]) + "\n"


def write_json(result: Result, path: Path, extra: Mapping[str, Any] | None = None) -> None:
    """Write `json_text` atomically."""
    write_atomic(path, json_text(result, extra))


def write_csv(result: Result, path: Path) -> None:
    """Write `csv_text` atomically."""
    write_atomic(path, csv_text(result))


def write_markdown(result: Result, path: Path) -> None:
    """Write `markdown_text` atomically."""
    write_atomic(path, markdown_text(result))


def _name(metric: str) -> str:
    return _TITLES.get(metric, (metric, ""))[0]


def _number(metric: str, value: float | None) -> str:
    return "" if value is None else _TITLES.get(metric, ("", "{:.3g}"))[1].format(value)


def _markdown_row(cells: list[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"
