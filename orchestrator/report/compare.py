"""What makes runs beside each other different, and whether their numbers may be compared at all."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hedgerow.orchestrator.report.curves import letter
from hedgerow.orchestrator.runs.run import Run


def other_network(one: Run, other: Run) -> list[str]:
    """In what the graphs of two runs differ: nodes, edges, b; nothing where their numbers may be compared."""
    edges, of_other = ({frozenset(edge) for edge in run.topology.edges} for run in (one, other))
    said = []
    if set(one.ids) != set(other.ids):
        said.append(f"nodes ({len(other.ids)}, not {len(one.ids)})" if len(one.ids) != len(other.ids) else "node ids")
    if edges != of_other:
        said.append("edges")
    if one.b != other.b:
        said.append(f"b ({other.b:g}, not {one.b:g})")
    return said


def differences(one: Run, other: Run) -> list[str]:
    """In what else two runs of one network differ, in words."""
    said = []
    if one.law != other.law:
        said.append(f"the law ({other.law}, not {one.law})")
    for name, words in (("a", "true a"), ("candidates", "candidates"), ("nominal", "nominal a"), ("x0", "x(0)")):
        if _settings(one, name) != _settings(other, name):
            said.append(words)
    steps = min(one.T, other.T)
    order = [other.ids.index(node) for node in one.ids]
    if not np.array_equal(one.w[:steps], other.w[:steps][:, order], equal_nan=True):
        said.append("the disturbances")
    if one.T != other.T:
        said.append(f"the steps ({other.T}, not {one.T})")
    if one.topology.faults != other.topology.faults:
        said.append("the faults")
    return said


def _settings(run: Run, name: str) -> dict[Any, Any]:
    return {node: getattr(own, name) for node, own in run.topology.nodes.items()}


def notices(runs: Sequence[Run]) -> tuple[bool, list[str]]:
    """Whether all runs are of one network; and a sentence a run on how it differs from the first."""
    comparable, said = True, []
    for place, run in enumerate(runs[1:], 1):
        name = letter(place)
        if network := other_network(runs[0], run):
            comparable = False
            said.append(f"{name} is of another network than A: it has other {' and '.join(network)}.")
        elif differing := differences(runs[0], run):
            own_oracle = {"true a", "x(0)", "the disturbances"} & {*differing}
            said.append(
                f"{name} differs from A in {' and '.join(differing)}."
                + (" So its oracle is another: what is said of it is measured against that." if own_oracle else "")
            )
        else:
            said.append(f"{name} repeats A: the same network, law, x(0), disturbances and faults.")
    return comparable, said
