"""Print and write a filled table: ours, paper, difference, interval, number of labels."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table

from dgrasp.files.atomic import write_atomic
from dgrasp.tables.fill import Cells
from dgrasp.tables.plan import Plan

_TITLES = {"success": ("success", "{:.2f}"), "sim_dist_mm_per_step": ("SimDist mm/step", "{:.1f}"),
           "interpenetration_shell_cm3": ("interpen. cm3", "{:.2f}"), "contact_ratio": ("contact ratio", "{:.2f}"),
           "label_distance_mm": ("to label mm", "{:.1f}"), "label_angles_deg": ("to label deg", "{:.1f}"),
           "mpe_m": ("MPE m", "{:.3f}"), "geodesic_rad": ("geodesic rad", "{:.2f}")}  # fmt: skip
NOT_THE_PAPERS = ("* hand, labels, targets or evaluation are not the paper's: not comparable, so the paper's numbers "
                  "are left out")


def cells_of(plan: Plan, cells: Cells) -> list[str]:
    """A row as text: labels, method, n, and per metric our mean with its interval, the paper's, and the difference."""
    apart = bool(cells.values) and not cells.comparable
    mark = " *" if apart else ""
    row = [cells.line.group, cells.line.name + mark, str(cells.n) if cells.values else "-"]
    for metric in plan.metrics:
        number, ours = _TITLES[metric][1], cells.values.get(metric)
        paper = None if apart else cells.line.paper.get(metric)
        low_high = cells.intervals.get(metric)
        shown = "-" if ours is None else number.format(ours)
        if ours is not None and low_high is not None:
            shown += f" [{number.format(low_high[0])}, {number.format(low_high[1])}]"
        difference = "" if ours is None or paper is None else f"{number.format(ours - paper):>5}"
        if difference.strip() and not difference.strip().startswith("-"):
            difference = f"+{difference.strip()}"
        row.append(shown)
        if plan.of_paper:
            row += ["" if paper is None else number.format(paper), difference.strip()]
    return row


def header_of(plan: Plan) -> list[str]:
    """The column titles of `cells_of`."""
    header = ["labels", "method", "n"]
    for metric in plan.metrics:
        header += [_TITLES[metric][0], *(["paper", "diff."] if plan.of_paper else [])]
    return header


def notices(plan: Plan, rows: Sequence[Cells]) -> list[str]:
    """Lines above a table: the meaning of *, if a row has one, and why."""
    apart = [cells for cells in rows if cells.values and not cells.comparable]
    if not apart:
        return []
    why = dict.fromkeys(difference for cells in apart for difference in cells.differences)
    text = NOT_THE_PAPERS if plan.of_paper else NOT_THE_PAPERS.rsplit(",", 1)[0]
    return [f"{text}: {'; '.join(why)}" if why else text]


def remarks(plan: Plan, rows: Sequence[Cells]) -> list[str]:
    """Lines under a table: values by seed, training runs, and how to train what is missing."""
    lines = []
    for cells in rows:
        for metric in plan.metrics:
            name, number = _TITLES[metric]
            values = {seed: found[metric] for seed, found in cells.seeds.items() if metric in found}
            if values:
                each = ", ".join(f"{seed}: {number.format(value)}" for seed, value in values.items())
                lines.append(f"{cells.line.group}, {cells.line.name}, {name} by seed: {each}")
    evaluated = dict.fromkeys(text for cells in rows for text in cells.evaluated)
    if evaluated:
        lines.append(f"evaluated on {'; on '.join(evaluated)}")
    lines += dict.fromkeys(note for cells in rows for note in cells.notes)
    missing = dict.fromkeys(reason for cells in rows for reason in cells.missing)
    if missing:
        lines.append(f"missing ({len(missing)}):")
        lines += [f"  {reason}" for reason in missing]
    return lines


def show(plan: Plan, rows: Sequence[Cells], console: Console | None = None) -> None:
    """Print a table."""
    console = console or Console()
    if not console.is_terminal:
        console = Console(width=220)
    _print(notices(plan, rows), console)
    table = Table(title=plan.title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    for i, name in enumerate(header_of(plan)):
        table.add_column(name, justify="left" if i < 2 else "right", no_wrap=True)
    for cells in rows:
        table.add_row(*cells_of(plan, cells))
    console.print(table)
    _print(remarks(plan, rows), console)


def _print(lines: Sequence[str], console: Console) -> None:
    for line in lines:
        console.print(line, markup=False, highlight=False, soft_wrap=True)


def write(plan: Plan, rows: Sequence[Cells], folder: Path) -> None:
    """Write NAME.md, NAME.csv and NAME.json into a folder."""
    header = header_of(plan)
    lines = [f"## {plan.title}", "", *(f"{line}\n" for line in notices(plan, rows))]
    lines += [f"| {' | '.join(header)} |", f"|{'---|' * 2}{'---:|' * (len(header) - 2)}"]
    lines += [f"| {' | '.join(cells_of(plan, cells))} |" for cells in rows]
    lines += ["", *(f"- {line.strip()}" for line in remarks(plan, rows))]
    write_atomic(folder / f"{plan.name}.md", "\n".join(lines) + "\n")
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(cells_of(plan, cells) for cells in rows)
    write_atomic(folder / f"{plan.name}.csv", stream.getvalue())
    plain = [
        {"labels": cells.line.group, "method": cells.line.name, "n": cells.n, "values": cells.values,
         "intervals": cells.intervals,
         "paper": dict(cells.line.paper) if cells.comparable or not cells.values else None,
         "comparable_with_paper": cells.comparable, "seeds": cells.seeds, "missing": cells.missing,
         "notes": cells.notes, "commands": cells.commands, "evaluated": cells.evaluated}
        for cells in rows
    ]  # fmt: skip
    content = {"schema": 1, "table": plan.name, "title": plan.title, "metrics": list(plan.metrics), "rows": plain}
    write_atomic(folder / f"{plan.name}.json", json.dumps(content, indent=2, allow_nan=False) + "\n")
