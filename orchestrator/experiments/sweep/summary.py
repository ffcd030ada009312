"""The result of a sweep: by setting, the centre of each metric and its spread."""

from __future__ import annotations

import csv
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hedgerow.orchestrator.experiments.sweep.plan import Plan
from hedgerow.orchestrator.experiments.sweep.runs import METRICS, Row
from hedgerow.topologies.graph import Array

SHOWN = {"regret": "regret D", "regret_nominal": "nominal D", "cost_regret": "cost regret", "gain": "gain"}
"""The metrics with quartiles on the screen, and their names there."""


class Spread(NamedTuple):
    """The statistics of some numbers; NaN if there are too few."""

    runs: int
    """the number of runs with a value"""
    mean: float
    error: float
    """the standard error of the mean, over runs: the nodes of one run are not independent of each other"""
    q1: float
    median: float
    q3: float


def values_of(rows: Sequence[Row], metric: str) -> Array:
    """Return a metric of some runs, without undefined values."""
    return np.array([row[metric] for row in rows if row.get(metric) is not None], dtype=float)


def spread(values: Array) -> Spread:
    """Return mean, standard error and quartiles."""
    n = len(values)
    if not n:
        return Spread(0, *[np.nan] * 5)
    error = float(values.std(ddof=1)) / n**0.5 if n > 1 else np.nan
    return Spread(n, float(values.mean()), error, *np.quantile(values, [0.25, 0.5, 0.75]).tolist())


REPEATED = "every seed gave the same run, because nothing in this network is drawn by its seed"


def repeated(rows: Sequence[Row]) -> bool:
    """Return True if the runs of several seeds are one run, so that their number means nothing."""
    return len(rows) > 1 and all({**row, "seed": 0} == {**rows[0], "seed": 0} for row in rows)


def varied(plan: Plan) -> list[int]:
    """Return the places of the keys with more than one value."""
    return [k for k in range(len(plan.keys)) if len({one.values[k] for one in plan.settings}) > 1]


def write_csv(path: Path, plan: Plan, rows: Sequence[Sequence[Row]]) -> None:
    """Write one line per setting and metric; `rows` are the runs of each setting."""
    with path.open("w", newline="", encoding="utf-8") as file:
        write = csv.writer(file).writerow
        write([*plan.keys, "metric", *Spread._fields])
        for setting, own in zip(plan.settings, rows, strict=True):
            for metric in ("share_right", *METRICS):
                write([*setting.values, metric, *spread(values_of(own, metric))])


def table(plan: Plan, rows: Sequence[Sequence[Row]]) -> str:
    """Return the main metrics as a table for the screen."""
    places = varied(plan)
    lines = [
        [*(plan.keys[k] for k in places), "runs", "nodes right", *(f"{name} [quartiles]" for name in SHOWN.values())]
    ]
    for setting, own in zip(plan.settings, rows, strict=True):
        right = spread(values_of(own, "share_right"))
        cells = [setting.values[k] for k in places] + [str(len(own)), f"{right.mean:.3f} ± {right.error:.3f}"]
        for metric in SHOWN:
            of = spread(values_of(own, metric))
            cells.append(f"{of.median:.3g} [{of.q1:.3g}, {of.q3:.3g}]" if of.runs else "undefined")
        lines.append(cells)
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    padded = (itertools.starmap(str.ljust, zip(line, widths, strict=True)) for line in lines)
    return "\n".join("  ".join(cells).rstrip() for cells in padded)
