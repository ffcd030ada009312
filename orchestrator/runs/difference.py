"""The first difference of two runs, and a message that explains it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hedgerow.topologies.describe import describe
from hedgerow.topologies.graph import Mask

if TYPE_CHECKING:
    from hedgerow.orchestrator.runs.recorded import NodeId
    from hedgerow.orchestrator.runs.run import Run


class Estimates(dict["NodeId", "float | None"]):
    """The estimates of all nodes at one step, by node; None where an agent is absent."""

    def __init__(self, run: Run, t: int) -> None:
        values = run.ahat[t].tolist()
        super().__init__(
            (node, None if math.isnan(value) else value) for node, value in zip(run.ids, values, strict=True)
        )
        self.run, self.t = run, t


_COMPARED = ("x", "ahat", "index", "u", "w")
"""The compared arrays; within a step, each determines the next."""


def equal(left: Run, right: Run) -> bool:
    """Return True if all bits of the compared arrays of two runs are equal."""
    return left.ids == right.ids and all(
        np.array_equal(getattr(left, name), getattr(right, name), equal_nan=True) for name in _COMPARED
    )


def explain_estimates(left: Estimates, right: Estimates) -> list[str]:
    """Return lines that name the nodes with different estimates, and the first step with a difference."""
    if left.run.ids != right.run.ids:
        return [f"the nodes differ: {list(left)} and {list(right)}"]
    at = f"estimates at step {left.t}" + (f" and {right.t}" if left.t != right.t else "")
    differ = [f"node {node}: {left[node]} != {right[node]}" for node in left if left[node] != right[node]]
    return [f"{at} differ: {'; '.join(differ[:4])}{_more(differ, 4)}", *_first(left.run, right.run, ["ahat"])]


def explain_runs(left: Run, right: Run) -> list[str]:
    """Return lines that name the first step and the cells at which two runs differ."""
    if left.ids != right.ids:
        return [f"the nodes differ: {list(left.ids)} and {list(right.ids)}"]
    both = f"runs of {left.T} and {right.T} steps" if left.T != right.T else "runs"
    return [f"{both} differ", *_first(left, right, _COMPARED)]


def _first(left: Run, right: Run, names: Sequence[str]) -> list[str]:
    """Return lines on the first step at which the runs differ in one of these arrays, and the faults until then."""
    steps = min(left.T, right.T)
    found = [(t, name) for name in names if (t := _differs(left, right, name)) is not None]
    if not found:
        return [f"up to step {steps} they are equal"]
    t, name = min(found, key=lambda pair: (pair[0], names.index(pair[1])))
    one, other = getattr(left, name)[t], getattr(right, name)[t]
    return [
        f"first at step {t}: {'; '.join(_cells(left, name, one, other))}",
        f"left, until then: {_disturbed(left, t)}",
        f"right, until then: {_disturbed(right, t)}",
        f"folders: {left.folder} and {right.folder}",
    ]


def _disturbed(run: Run, t: int) -> str:
    """Return the faults that began by step `t`, and the messages lost until then; a cut loses no message."""
    faults = [f"fault {k}: {describe(one)}" for k, one in enumerate(run.topology.faults, 1) if one.window[0] <= t]
    return "; ".join(
        [*faults[:4], *([f"and {len(faults) - 4} more"] if len(faults) > 4 else []), lost_messages(run, t + 1)]
    )


def _differs(left: Run, right: Run, name: str) -> int | None:
    one, other = getattr(left, name), getattr(right, name)
    rows = min(len(one), len(other))
    found = np.flatnonzero(_unequal(one[:rows], other[:rows]).any(axis=1))
    return int(found[0]) if len(found) else None


def _unequal(one: NDArray[Any], other: NDArray[Any]) -> Mask:
    unequal: Mask = one != other
    return unequal & ~(np.isnan(one) & np.isnan(other)) if one.dtype.kind == "f" else unequal


def _cells(run: Run, name: str, one: Any, other: Any) -> list[str]:
    """Return a text for each cell that differs in one row of an array."""
    unequal = np.flatnonzero(_unequal(one, other))
    cells = [f"{name} of node {run.ids[k]} {one[k]} != {other[k]}" for k in unequal[:4]]
    return [*cells, f"and {len(unequal) - 4} more"] if len(unequal) > 4 else cells


def lost_messages(run: Run, until: int) -> str:
    """Return a line on the link messages that were lost or late before step `until`."""
    graph, ids = run.topology.graph, run.ids
    lost = ~run.received[:until]
    texts = [
        f"{ids[graph.neighbour[c]]}->{ids[graph.node[c]]} at {_ranges(np.flatnonzero(lost[:, c]).tolist())}"
        for c in np.flatnonzero(lost.any(axis=0))
    ]
    if not texts:
        return "no message lost or late"
    return f"messages lost or late: {', '.join(texts[:6])}{_more(texts, 6)}"


def _ranges(steps: list[int]) -> str:
    """Return steps as ranges: 3 10-19."""
    runs: list[list[int]] = []
    for t in steps:
        if runs and runs[-1][1] == t - 1:
            runs[-1][1] = t
        else:
            runs.append([t, t])
    texts = [f"{a}" if a == b else f"{a}-{b}" for a, b in runs]
    return " ".join(texts[:6]) + _more(texts, 6)


def _more(texts: Sequence[str], shown: int) -> str:
    return f", and {len(texts) - shown} more" if len(texts) > shown else ""
