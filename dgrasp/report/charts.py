"""The report's charts as inline SVG: bars per object, success over time, outcomes.

Classes of the page's style sheet set the colours, so that the charts follow light and dark mode.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from dgrasp.eval.failures import KINDS
from dgrasp.eval.summary import Result
from dgrasp.types import Array

_LABELS, _ROW, _PANEL, _GAP = 178, 22, 232, 62
"""px: width of the names' column, height of a row, width of a panel of bars, gap between panels."""

PANELS = {
    "success": ("Success", "share of labels held", "{:.2f}"),
    "sim_dist_mm_per_step": ("SimDist", "mm per control step", "{:.1f}"),
    "interpenetration_cm3": ("Interpenetration", "cm\u00b3", "{:.2f}"),
    "interpenetration_shell_cm3": ("Interpenetration", "by the object's shell, cm\u00b3", "{:.2f}"),
    "mpe_m": ("Position error", "at the end, m", "{:.3f}"),
    "geodesic_rad": ("Angular error", "at the end, rad", "{:.2f}"),
}


def shown_metrics(result: Result) -> list[str]:
    """The metrics with bars.

    They include one interpenetration: by the shell, as in the paper (docs/metrics.md), if the result has the paper's
    numbers, else by volume.
    """
    other = "interpenetration_cm3" if "interpenetration_shell_cm3" in (result.paper or {}) else (
        "interpenetration_shell_cm3")
    return [name for name in PANELS if name in result.mean_over_objects and name != other]


def bars(result: Result) -> str:
    """Bars of each object's means with their intervals, and a diamond for the paper's number if there is one."""
    metrics = shown_metrics(result)
    names = [*result.per_object, "mean over objects"]
    top, height = 46, 46 + _ROW * len(names) + 14
    width = _LABELS + len(metrics) * (_PANEL + _GAP)
    parts = []
    for row, name in enumerate(names):
        y = _middle(top, row, len(names))
        weight = " strong" if row == len(names) - 1 else ""
        parts.append(_text(_LABELS - 12, y + 4, name, f"end{weight}"))
    for column, metric in enumerate(metrics):
        parts += _panel(result, metric, _LABELS + column * (_PANEL + _GAP), top, names, height)
    return _svg(width, height, "Bars of each object's means", parts)


def _panel(result: Result, metric: str, left: float, top: float, names: Sequence[str], height: float) -> list[str]:
    heading, unit, form = PANELS[metric]
    paper, spans = (result.paper or {}).get(metric, {}), result.intervals
    rows = [(means.get(metric), paper.get(name), spans["per_object"].get(name, {}).get(metric))
            for name, means in result.per_object.items()]
    rows.append((result.mean_over_objects[metric], paper.get("average"), spans["mean_over_objects"].get(metric)))
    highest = max(v for value, other, span in rows for v in (value, other, span[1] if span else None) if v is not None)
    limit = 1.0 if metric == "success" else _nice(highest)
    parts = [_text(left, 14, heading, "strong"), _text(left, 30, unit, "muted small")]
    for share in (0.0, 0.5, 1.0):
        x = left + share * _PANEL
        parts.append(_line(x, top - 4, x, height - 10, "grid"))
        parts.append(_text(x, height, f"{share * limit:g}", "mid muted small"))
    for row, (value, other, span) in enumerate(rows):
        y = _middle(top, row, len(names))
        if value is not None:
            strong = " strong" if row == len(rows) - 1 else ""
            said = f"{names[row]}: {form.format(value)}"
            said += "" if other is None else f", paper {form.format(other)}"
            parts.append(f'<rect class="ours{strong}" x="{left:.1f}" y="{y - 6:.1f}" height="12" rx="1.5" '
                         f'width="{_PANEL * value / limit:.1f}"><title>{escape(said)}</title></rect>')
            parts.append(_text(left + _PANEL + 44, y + 4, form.format(value), f"end{strong}"))
        if span:
            low, high = (left + _PANEL * min(v, limit) / limit for v in span)
            parts.append(_line(low, y, high, y, "whisker"))
        if other is not None:
            x = left + _PANEL * other / limit
            parts.append(f'<path class="paper" d="M{x:.1f} {y - 5.5:.1f}l5.5 5.5 -5.5 5.5 -5.5 -5.5z"/>')
    return parts


def _middle(top: float, row: int, rows: int) -> float:
    """y of a row's middle; the last row, the mean, is set apart."""
    return top + _ROW * row + _ROW / 2 + (6 if row == rows - 1 else 0)


def held(times: Array, shares: Mapping[str, Array], paper: float | None) -> str:
    """The share of grasps not yet lost over time (s): a thin line per object, a thick line for their mean."""
    left, right, top, width, height = 44, 92, 12, 560, 300
    inner, tall = width - left - right, height - top - 40
    mean = np.mean(list(shares.values()), axis=0)
    end = float(times[-1])
    parts = []
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        y = top + tall * (1.0 - share)
        parts += [_line(left, y, left + inner, y, "grid"), _text(left - 8, y + 4, f"{share:g}", "end muted small")]
    spacing = _nice(end / 5.0)
    for tick in np.arange(0.0, end + 1e-9, spacing):
        parts.append(_text(left + inner * float(tick) / end, top + tall + 18, f"{tick:g}", "mid muted small"))
    parts.append(_text(left + inner / 2, height - 4, "seconds after the table was taken away", "mid muted small"))

    def path(values: Array, kind: str, said: str) -> str:
        xs, ys = left + inner * times / end, top + tall * (1.0 - values)
        keep = [0, *(k for k in range(1, len(values)) if values[k] != values[k - 1]), len(values) - 1]
        steps = "".join(f"H{xs[k]:.1f}V{ys[k]:.1f}" for k in keep[1:])
        return f'<path class="{kind}" d="M{xs[0]:.1f} {ys[0]:.1f}{steps}"><title>{escape(said)}</title></path>'

    parts += [path(values, "thread", f"{name}: {values[-1]:.2f} at the end") for name, values in shares.items()]
    parts.append(path(mean, "curve", f"mean over objects: {mean[-1]:.2f} at the end"))
    y = top + tall * (1.0 - float(mean[-1]))
    parts.append(_text(left + inner + 10, y + 4, f"{mean[-1]:.2f} mean", "strong"))
    if paper is not None:
        at = top + tall * (1.0 - paper)
        parts.append(f'<path class="paper" d="M{left + inner:.1f} {at - 5.5:.1f}l5.5 5.5 -5.5 5.5 -5.5 -5.5z"/>')
        # Two close numbers must not overlap.
        shifted = at + (0 if abs(at - y) > 16 else 16 if at >= y else -16)
        parts.append(_text(left + inner + 10, shifted + 4, f"{paper:.2f} paper", "muted"))
    return _svg(width, height, "Share of grasps held over time", parts)


def failures(table: Mapping[str, Any]) -> str:
    """Outcomes per object as stacked bars of equal length, labelled with counts. table: from `failures.report`."""
    rows = {"all labels": table["all"], **table["per_object"]}
    left, width, top = _LABELS, 560, 4
    inner = width - left - 40
    parts = []
    for row, (name, found) in enumerate(rows.items()):
        y = top + _ROW * row + (8 if row else 0)
        total = sum(found.values())
        parts.append(_text(left - 12, y + 15, name, "end" + " strong" * (row == 0)))
        x = float(left)
        for kind in ("held", *KINDS):
            if not found[kind]:
                continue
            wide = inner * found[kind] / total
            parts.append(f'<rect class="k-{kind}" x="{x:.1f}" y="{y + 3:.1f}" width="{max(wide - 1, 0.5):.1f}" '
                         f'height="16"><title>{escape(name)}: {found[kind]} of {total} {kind}</title></rect>')
            if wide > 9 * len(str(found[kind])) + 4:
                parts.append(_text(x + wide / 2, y + 15, str(found[kind]), f"mid small on-{kind}"))
            x += wide
        parts.append(_text(width - 2, y + 15, str(total), "end muted small"))
    return _svg(width, top + _ROW * len(rows) + 14, "Outcomes of each object's labels", parts)


def _nice(value: float) -> float:
    """The smallest of 1, 2, 2.5, 4, 5 times a power of ten that is not below `value`; 1 if `value` is not positive."""
    if not value > 0.0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(step * power for step in (1, 2, 2.5, 4, 5, 10) if step * power >= value * (1 - 1e-9)))


def _text(x: float, y: float, text: str, kind: str) -> str:
    return f'<text class="{kind}" x="{x:.1f}" y="{y:.1f}">{escape(text)}</text>'


def _line(x1: float, y1: float, x2: float, y2: float, kind: str) -> str:
    return f'<line class="{kind}" x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}"/>'


def _svg(width: float, height: float, title: str, parts: Sequence[str]) -> str:
    return (f'<svg viewBox="0 0 {width:g} {height + 6:g}" width="{width:g}" role="img" aria-label="{escape(title)}">'
            f"{''.join(parts)}</svg>")
