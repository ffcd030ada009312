"""Simple figures of a run, for a notebook or a Python prompt; `orchestrator report` draws those for a paper."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from hedgerow.orchestrator.ground.colours import COLOURS
from hedgerow.topologies.errors import Code, UserError

if TYPE_CHECKING:
    from hedgerow.orchestrator.runs.run import Run

LEGEND_MOST = 12
"""The maximum number of nodes in a legend; more lines would hide the figure."""


def plot(run: Run, names: Sequence[str]) -> Figure:
    """Return a figure with one panel per named array of a run. Raises UserError for a name without rows per step."""
    figure = Figure(figsize=(7.0, 2.4 * len(names)), layout="constrained")
    axes = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
    for axis, name in zip(axes, names, strict=True):
        values = getattr(run, name, None) if not name.startswith("_") else None
        if not isinstance(values, np.ndarray) or not run.T <= len(values) <= run.T + 1:
            raise UserError(
                f"plot: {name}: is no array with one row per step; choose for example x, ahat or regret",
                code=Code.OPTION,
            )
        axis.set_prop_cycle(color=COLOURS)
        lines = axis.plot(np.arange(len(values)), values, linewidth=1.0)
        axis.set_ylabel(name)
        if values.ndim == 2 and values.shape[1] == len(run.ids) <= LEGEND_MOST:
            axis.legend(lines, [str(node) for node in run.ids], ncols=2, fontsize="x-small", loc="upper right")
    axes[0].set_title(f"{run.topology.name}, {run.law}", loc="left", fontsize="medium")
    axes[-1].set_xlabel("step")
    return figure
