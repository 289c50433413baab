"""Write a result as a LaTeX table in the paper's layout: metrics per object, ours beside the paper's."""

from __future__ import annotations

from pathlib import Path

from dgrasp.eval.output import notices, remarks, title
from dgrasp.eval.summary import Result
from dgrasp.files.atomic import write_atomic

_COLUMNS = {
    "success": (r"Success $\uparrow$", "{:.2f}"),
    "sim_dist_mm_per_step": (r"SimDist [mm/step] $\downarrow$", "{:.1f}"),
    "interpenetration_cm3": (r"Interp.\ [cm$^3$] $\downarrow$", "{:.2f}"),
    "interpenetration_shell_cm3": (r"Interp.\ by shell [cm$^3$] $\downarrow$", "{:.2f}"),
    "mpe_m": (r"MPE [m] $\downarrow$", "{:.3f}"),
    "geodesic_rad": (r"Geodesic [rad] $\downarrow$", "{:.2f}"),
}
_SPECIAL = {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
            **{character: f"\\{character}" for character in "&%$#_{}"}}


def escaped(text: str) -> str:
    """The text with LaTeX's special characters escaped."""
    return "".join(_SPECIAL.get(character, character) for character in text)


def latex_text(result: Result) -> str:
    """A `tabular` for `\\usepackage{booktabs}`, preceded by the title, notices and remarks as LaTeX comments."""
    metrics = [name for name in _COLUMNS if name in result.mean_over_labels]
    paper = result.paper or {}
    if "interpenetration_cm3" in metrics and "interpenetration_shell_cm3" in paper:
        # The paper measured the shell (docs/metrics.md), so its number is shown only beside the shell's column.
        paper = {name: values for name, values in paper.items() if name != "interpenetration_cm3"}
    else:
        metrics = [name for name in metrics if name != "interpenetration_shell_cm3"]
    upper, lower, rules, column = ["", ""], ["Object", "$n$"], [], 3
    for name in metrics:
        width = 2 if name in paper else 1
        upper.append(f"\\multicolumn{{{width}}}{{c}}{{{_COLUMNS[name][0]}}}")
        lower += ["ours", "paper"] if width == 2 else [""]
        if width == 2:
            rules.append(f"\\cmidrule(lr){{{column}-{column + 1}}}")
        column += width
    entries = [(escaped(name), name, means) for name, means in result.per_object.items()]
    mean = ("Mean over objects", "average", {"n": float(len(result.per_object)), **result.mean_over_objects})
    rows = []
    for shown, key, means in [*entries, mean]:
        cells = [shown, f"{means['n']:g}"]
        for name in metrics:
            cells.append(_number(name, means.get(name)))
            if name in paper:
                cells.append(_number(name, paper[name].get(key)))
        rows.append(" & ".join(cells) + r" \\")
    about = [f"% {' '.join(line.split())}" for line in (title(result), *notices(result), *remarks(result))]
    return "\n".join([
        *about, r"% \usepackage{booktabs}", f"\\begin{{tabular}}{{l{'r' * (column - 2)}}}", r"\toprule",
        " & ".join(upper) + r" \\", *([" ".join(rules)] if rules else []), " & ".join(lower) + r" \\", r"\midrule",
        *rows[:-1], r"\midrule", rows[-1], r"\bottomrule", r"\end{tabular}", "",
    ])  # fmt: skip


def write_latex(result: Result, path: Path) -> None:
    """Write `latex_text` atomically."""
    write_atomic(path, latex_text(result))


def _number(metric: str, value: float | None) -> str:
    return "" if value is None else _COLUMNS[metric][1].format(value)
