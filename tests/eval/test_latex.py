from __future__ import annotations

from pathlib import Path

from dgrasp.eval.latex import escaped, latex_text, write_latex
from tests.eval.test_summary import FREE, PAPER, result, row

ROWS = [
    row("002_master_chef_can", 0, True, sim_dist_mm_per_step=1.25, interpenetration_cm3=2.0),
    row("002_master_chef_can", 1, False, sim_dist_mm_per_step=24.0, interpenetration_cm3=3.0),
    row("025_mug", 0, True, sim_dist_mm_per_step=0.5),
]


def body(text: str) -> list[str]:
    return [line for line in text.splitlines() if not line.startswith("%")]


def test_alone() -> None:
    assert body(latex_text(result(ROWS, FREE))) == [
        r"\begin{tabular}{lrrrr}",
        r"\toprule",
        r" &  & \multicolumn{1}{c}{Success $\uparrow$} & \multicolumn{1}{c}{SimDist [mm/step] $\downarrow$} & "
        r"\multicolumn{1}{c}{Interp.\ [cm$^3$] $\downarrow$} \\",
        r"Object & $n$ &  &  &  \\",
        r"\midrule",
        r"002\_master\_chef\_can & 2 & 0.50 & 12.6 & 2.50 \\",
        r"025\_mug & 1 & 1.00 & 0.5 &  \\",
        r"\midrule",
        r"Mean over objects & 2 & 0.75 & 6.6 & 2.50 \\",
        r"\bottomrule",
        r"\end{tabular}",
    ]


def test_beside_the_paper_every_row_has_as_many_cells_as_columns() -> None:
    rows = [{**one, "interpenetration_shell_cm3": 4.0} for one in ROWS]
    lines = body(latex_text(result(rows, PAPER)))
    assert lines[0] == r"\begin{tabular}{lrrrrrrrr}"
    assert r"\cmidrule(lr){3-4} \cmidrule(lr){5-6} \cmidrule(lr){8-9}" in lines
    # The paper's interpenetration is next to the shell's column, because the paper measured the shell.
    assert r"002\_master\_chef\_can & 2 & 0.50 & 0.19 & 12.6 & 18.0 & 2.50 & 4.00 & 5.68 \\" in lines
    assert all(line.count("&") == 8 for line in lines[4:] if "&" in line)


def test_what_it_rests_on_is_a_comment() -> None:
    lines = latex_text(result(ROWS, FREE)).splitlines()
    assert lines[0] == "% gt_pd, pybullet, window 5 s, 3 labels"
    assert lines[1] == "% not comparable with the paper: the hand is free, not the paper's"
    assert r"% \usepackage{booktabs}" in lines


def test_names_cannot_break_the_table(tmp_path: Path) -> None:
    assert escaped("a_b & 50% \\x {y} ~^#$") == (
        r"a\_b \& 50\% \textbackslash{}x \{y\} \textasciitilde{}\textasciicircum{}\#\$"
    )
    one = result([row("odd&name_1", 0, True)], {**FREE, "licence": "two\nlines"})
    write_latex(one, tmp_path / "a.tex")
    text = (tmp_path / "a.tex").read_text()
    assert r"odd\&name\_1 & 1 & 1.00 \\" in text and "licence two lines" in text
