"""The selection of rows: some steps, some nodes, and the edges at these nodes, by `record:` of the topology."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hedgerow.topologies.graph import Graph, Index
from hedgerow.topologies.schema import Topology


@dataclass(frozen=True, eq=False)
class Selection:
    """The steps, nodes and edges with rows, in a network of n nodes."""

    graph: Graph
    every: int
    steps: int
    """T of the run, unless it is stopped"""
    nodes: Index
    """positions, ascending, (k,)"""

    @property
    def all_nodes(self) -> bool:
        return len(self.nodes) == self.graph.n

    @property
    def whole(self) -> bool:
        """Return True if everything is selected."""
        return self.every == 1 and self.all_nodes

    @cached_property
    def edges(self) -> Index:
        """Return the indices of the edges at one of the nodes, ascending, (e,)."""
        if self.all_nodes:
            return np.arange(len(self.graph.edges))
        selection = np.zeros(self.graph.n, dtype=np.bool_)
        selection[self.nodes] = True
        return np.flatnonzero(selection[self.graph.edges].any(axis=1))

    def rows(self, t: Index) -> Index:
        """Return a mask of the steps that have rows: every Nth step, and the last step with inputs."""
        if self.every == 1:
            return np.arange(len(t))
        return np.flatnonzero((t % self.every == 0) | (t == self.steps - 1))

    def __str__(self) -> str:
        steps = "every step" if self.every == 1 else f"every {self.every}th step and the last"
        n = self.graph.n
        nodes = f"all {n} nodes" if self.all_nodes else f"{len(self.nodes)} of {n} nodes and their edges"
        return f"{steps} of {nodes}"


def selection(topology: Topology) -> Selection:
    """Return the selection for a run of a resolved topology."""
    n, chosen = len(topology.ids), topology.record.nodes
    match chosen:
        case int():
            nodes = evenly(n, chosen)
        case tuple():
            nodes = np.unique(np.array([topology.position(node) for node in chosen], dtype=np.int64))
        case _:
            nodes = np.arange(n)
    return Selection(topology.graph, topology.record.every, topology.steps, nodes)


def evenly(n: int, some: int) -> Index:
    """Return `some` positions of n, evenly spread, the first included; all if n is smaller."""
    return np.arange(n) if some >= n else np.arange(some) * n // max(some, 1)


def notes(topology: Topology) -> Sequence[str]:
    """Return lines about the parts that are not recorded, and how to record them; empty if everything is."""
    what = selection(topology)
    if what.whole and topology.record.summary:
        return []
    also = "a summary of all at every step" if topology.record.summary else "no summary"
    return [f"recorded: {what}, and {also}; all of it with --set 'record={{nodes: all}}'"]
