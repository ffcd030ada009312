"""The differences between runs, and whether their numbers are comparable."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hedgerow.orchestrator.report.curves import letter
from hedgerow.orchestrator.runs.run import Run
from hedgerow.topologies.network import span


def other_network(one: Run, other: Run) -> list[str]:
    """Return the differences between the graphs of two runs: nodes, edges, weights, b; none if the numbers are
    comparable.
    """
    weights, of_other = (_weights(run) for run in (one, other))
    found = []
    if set(one.ids) != set(other.ids):
        found.append(f"nodes ({len(other.ids)}, not {len(one.ids)})" if len(one.ids) != len(other.ids) else "node ids")
    if weights.keys() != of_other.keys():
        found.append("edges")
    elif weights != of_other:
        found.append("weights of edges")
    if _gains(one) != _gains(other) and not found:
        found.append(f"b ({span(other.b)}, not {span(one.b)})")
    return found


def _weights(run: Run) -> dict[frozenset[int | str], float]:
    """Return the weight of each edge."""
    graph = run.topology.graph
    weights = np.ones(len(graph.edges)) if graph.weights is None else graph.weights
    return {frozenset(edge): weight for edge, weight in zip(run.topology.pairs, weights.tolist(), strict=True)}


def _gains(run: Run) -> dict[int | str, float]:
    """Return the gain of each node."""
    return dict(zip(run.ids, np.broadcast_to(run.b, len(run.ids)).tolist(), strict=True))


def differences(one: Run, other: Run) -> list[str]:
    """Return the other differences between two runs of one network, in words."""
    found = []
    if one.law != other.law:
        found.append(f"the law ({other.law}, not {one.law})")
    for name, words in (("a", "true a"), ("candidates", "candidates"), ("nominal", "nominal a"), ("x0", "x(0)")):
        if _settings(one, name) != _settings(other, name):
            found.append(words)
    steps = min(one.T, other.T)
    order = [other.ids.index(node) for node in one.ids]
    if not np.array_equal(one.w[:steps], other.w[:steps][:, order], equal_nan=True):
        found.append("the disturbances")
    if one.T != other.T:
        found.append(f"the steps ({other.T}, not {one.T})")
    if one.topology.faults != other.topology.faults:
        found.append("the faults")
    return found


def _settings(run: Run, name: str) -> dict[Any, Any]:
    return {node: getattr(own, name) for node, own in run.topology.nodes.items()}


def notices(runs: Sequence[Run]) -> tuple[bool, list[str]]:
    """Return True if all runs have one network, and a sentence per run about its difference from the first."""
    comparable, found = True, []
    for place, run in enumerate(runs[1:], 1):
        name = letter(place)
        if network := other_network(runs[0], run):
            comparable = False
            found.append(f"{name} is of another network than A: it has other {' and '.join(network)}.")
        elif differing := differences(runs[0], run):
            own_oracle = {"true a", "x(0)", "the disturbances"} & {*differing}
            found.append(
                f"{name} differs from A in {' and '.join(differing)}."
                + (" So it has a different oracle: its numbers are relative to that one." if own_oracle else "")
            )
        else:
            found.append(f"{name} repeats A: the same network, law, x(0), disturbances and faults.")
    return comparable, found
