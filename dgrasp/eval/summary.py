"""Summarise evaluated episodes as one result: rows per label, means per object and overall, and the paper's numbers."""

from __future__ import annotations

import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from dgrasp.errors import DataError
from dgrasp.eval import failures, metrics
from dgrasp.eval.intervals import intervals
from dgrasp.eval.paper import Column, motion_column, paper_column
from dgrasp.files.paths import is_checkout, shipped_root
from dgrasp.types import EpisodeRecord
from dgrasp.version import __version__

SCHEMA = 1
MIN_OBJECTS = 3
"""Smallest number of objects for a correlation with the paper; with fewer it is meaningless."""

NO_METRICS = ("index", "lost_s", "target")
"""Numbers of a row that are not averaged. A row has `lost_s` only if the object was lost."""

Row = dict[str, Any]
Means = dict[str, float]


@dataclass(frozen=True)
class Result:
    """One evaluation; its fields are the keys of the JSON of `--json` (`as_dict`).

    method: "gt_pd", "gt_ik", "policy", ...
    window_s: the stability window, s.
    commit: the commit of the code, or its version.
    data: `comparison.data_stamp`.
    mean_over_objects, mean_over_labels: metric -> mean.
    per_object: object -> "n" and its means.
    per_label: rows in the label file's order, each with object, index, its metrics, and "terminated" with the reason if
    the episode ended early. A metric that was not computed is absent.
    paper: metric -> {object: the paper's value, "average": ...} for the evaluated objects. The average is the printed
    one if all of the paper's objects were evaluated, else the mean of those shown. None if the paper has no number for
    this method, labels and hand.
    correlation_with_paper: metric -> Pearson's r of the per-object means and the paper's; None if it is not defined.
    cost: control_steps, wall_s, physics_share.
    intervals: intervals of the means (see `dgrasp.eval.intervals`).
    interpenetration: how that metric was measured (`Interpenetration.report`); absent from the JSON if it was not.
    motion: the targets and the method of an experiment that moves objects (`dgrasp.eval.motion`), in which a row of
    `per_label` is one label and target; absent from the JSON for other experiments.
    """

    schema: int
    method: str
    engine: str
    window_s: float
    seed: int
    commit: str
    data: dict[str, Any]
    n_labels: int
    mean_over_objects: Means
    mean_over_labels: Means
    per_object: dict[str, dict[str, float]]
    per_label: list[Row]
    paper: dict[str, dict[str, float]] | None
    correlation_with_paper: dict[str, float] | None
    cost: dict[str, float]
    intervals: dict[str, Any]
    interpenetration: dict[str, Any] | None = None
    motion: dict[str, Any] | None = None

    def as_dict(self) -> dict[str, Any]:
        """Plain values in the order of the fields."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: value for name, value in values.items()
                if value is not None or name not in ("interpenetration", "motion")}


def label_row(record: EpisodeRecord, window_s: float) -> Row:
    """The metrics of one episode as a row. Callers may add further metrics under other names.

    The row of a lost object has `failure`, its class, and `lost_s`, the time of the loss (`failures.outcome`).
    """
    row: Row = {"object": record.label.object_id, "index": record.label.index}
    row["success"] = metrics.success(record, window_s)
    measured = {
        "sim_dist_mm_per_step": metrics.sim_dist_mm_per_step(record, window_s),
        "sim_dist_mm_per_s": metrics.sim_dist_mm_per_s(record, window_s),
        "sim_dist_wrist_mm_per_step": metrics.sim_dist_wrist_mm_per_step(record, window_s),
        "contact_ratio": metrics.contact_ratio(record),
        "label_distance_mm": metrics.label_distance_mm(record),
        "label_angles_deg": metrics.label_angles_deg(record),
    }
    if record.T_WG is not None:
        measured["mpe_m"], measured["geodesic_rad"] = metrics.mpe_m(record), metrics.geodesic_rad(record)
    row.update({name: value for name, value in measured.items() if value is not None})
    end = failures.outcome(record, window_s)
    if end.lost_s is not None:
        row["failure"], row["lost_s"] = end.kind, end.lost_s
    if record.terminated:
        row["terminated"] = record.terminated
    return row


def summarise(
    episodes: Sequence[EpisodeRecord | Mapping[str, Any]], *, method: str, engine: str, window_s: float, seed: int,
    data: Mapping[str, Any], cost: Mapping[str, float], interpenetration: Mapping[str, Any] | None = None,
    motion: Mapping[str, Any] | None = None,
) -> Result:
    """The result of evaluated episodes, given as records or as rows like those of `label_row`, in file order.

    data: `comparison.data_stamp`; its comparable_with_paper, unseen_objects, source and split select the paper's
    column.
    Every number in a row except `NO_METRICS` is a metric and is averaged over the labels that have it.
    Raises `DataError` if there are no episodes, or if a metric is NaN or infinite.
    """
    rows = [label_row(e, window_s) if isinstance(e, EpisodeRecord) else _checked(e) for e in episodes]
    if not rows:
        raise DataError("no evaluated labels; expected at least one: check the choice of objects")
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(row["object"], []).append(row)
    object_means = {name: _means(group) for name, group in groups.items()}
    paper = None
    # These columns are of policies that were trained on the tested objects.
    if data.get("comparable_with_paper") and not data.get("unseen_objects"):
        labels = str(data.get("source")), str(data.get("split"))
        if motion is None:
            column = paper_column(*labels, method)
            paper = _beside(column, object_means) if column else None
        elif labels == ("dexycb", "train"):
            paper = motion_column(method, object_means, str(motion["targets"]))
    return Result(
        schema=SCHEMA, method=method, engine=engine, window_s=float(window_s), seed=seed, commit=code_version(),
        data=dict(data), n_labels=len({(row["object"], row["index"]) for row in rows}),
        mean_over_objects=_means(list(object_means.values())), mean_over_labels=_means(rows),
        per_object={name: {"n": len(groups[name]), **means} for name, means in object_means.items()},
        per_label=rows, paper=paper,
        correlation_with_paper=_correlations(paper, object_means) if paper else None,
        cost=dict(cost),
        intervals=intervals(_by_metric(groups), np.random.default_rng(seed)),
        interpenetration=None if interpenetration is None else dict(interpenetration),
        motion=None if motion is None else dict(motion),
    )


def code_version() -> str:
    """The commit of the running source tree, or the package's version if it is not a git checkout."""
    if is_checkout() and (shipped_root() / ".git").exists():
        try:
            done = subprocess.run(["git", "rev-parse", "HEAD"], cwd=shipped_root(), capture_output=True, text=True,
                                  timeout=10, check=True)
        except (OSError, subprocess.SubprocessError):
            return __version__
        return done.stdout.strip()
    return __version__


def is_metric(name: str, value: Any) -> bool:
    """Whether an entry of a row is a number to average."""
    return name not in NO_METRICS and isinstance(value, (bool, int, float, np.bool_, np.number))


def _checked(row: Mapping[str, Any]) -> Row:
    """The row with plain values and without None entries; raises `DataError` for a metric that is not finite."""
    place = f"{row['object']}[{row['index']}]"
    out: Row = {}
    for name, value in row.items():
        if value is None:
            continue
        out[name] = value.item() if isinstance(value, np.generic) else value
        if is_metric(name, value) and not np.isfinite(float(value)):
            raise DataError(f"{place}: metric {name} is {value}; expected a finite number, or no entry if it could not "
                            "be computed")
    return out


def _by_metric(groups: Mapping[str, Sequence[Row]]) -> dict[str, dict[str, list[float]]]:
    """Metric -> object -> the values of the rows that have it."""
    values: dict[str, dict[str, list[float]]] = {}
    for name, rows in groups.items():
        for row in rows:
            for metric, value in row.items():
                if is_metric(metric, value):
                    values.setdefault(metric, {}).setdefault(name, []).append(float(value))
    return values


def _means(rows: Sequence[Mapping[str, Any]]) -> Means:
    """Mean of each metric over the rows that have it."""
    values: dict[str, list[float]] = {}
    for row in rows:
        for name, value in row.items():
            if is_metric(name, value):
                values.setdefault(name, []).append(float(value))
    return {name: float(np.mean(column)) for name, column in values.items()}


def _beside(column: Column, ours: Mapping[str, Means]) -> dict[str, dict[str, float]] | None:
    """The paper's values of the evaluated objects: metric -> object, or "average" -> value; None if it has none."""
    shown = [name for name in ours if name in column]
    if not shown:
        return None
    complete = set(shown) == set(column) - {"average"}
    paper = {}
    for metric in column[shown[0]]:
        values = {name: column[name][metric] for name in shown}
        mean = column["average"][metric] if complete else float(np.mean(list(values.values())))
        paper[metric] = {**values, "average": mean}
    return paper


def _correlations(paper: Mapping[str, Mapping[str, float]], ours: Mapping[str, Means]) -> dict[str, float] | None:
    """Pearson's r over objects for each metric that both have; None if there is no such metric."""
    found = {}
    for metric, values in paper.items():
        shared = [name for name in values if metric in ours.get(name, {})]
        x = np.array([ours[name][metric] for name in shared])
        y = np.array([values[name] for name in shared])
        if len(shared) >= MIN_OBJECTS and np.ptp(x) > 0.0 and np.ptp(y) > 0.0:
            found[metric] = float(np.clip(np.corrcoef(x, y)[0, 1], -1.0, 1.0))
    return found or None
