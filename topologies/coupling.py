"""The coupling b_i^2 d_i of each node, which condition (3) limits; with random numbers, the largest possible one.

A file is checked with the largest gains and weights that can be drawn. It is then valid for every seed, or for none.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hedgerow.topologies.edges import ends_of, largest, weight_of
from hedgerow.topologies.graph import Array, Index
from hedgerow.topologies.nodes import Nodes
from hedgerow.topologies.schema import Topology


@dataclass(frozen=True, eq=False)
class Couplings:
    """The gain b_i and the weighted degree d_i of each node, (n,), or the largest possible ones."""

    b: Array
    degree: Array

    @property
    def empty(self) -> Index:
        """Return the positions of nodes for which no a satisfies condition (3): 8 b_i^2 d_i is not below 1."""
        return np.flatnonzero(8 * self.b * self.b * self.degree >= 1)

    @property
    def largest_b(self) -> float:
        """Return the largest b, to 4 digits, for which every node has an interval; infinite if no node has an edge."""
        bound = 1 / math.sqrt(8 * float(self.degree.max())) if self.degree.max() > 0 else math.inf
        if math.isinf(bound):
            return bound
        unit = 10.0 ** (math.floor(math.log10(bound)) - 3)
        rounded = math.floor(bound / unit) * unit
        return rounded if rounded < bound else rounded - unit


def largest_couplings(topology: Topology, made: bool) -> Couplings:
    """Return the couplings of a topology that is not resolved.

    Edges that are `made`, by a rule or in columns, are all valid. Some edges in a file may be invalid: unknown nodes,
    loops, repetitions. These are not counted.
    """
    return Couplings(largest_gains(topology), _made_degrees(topology) if made else _written_degrees(topology))


def largest_gains(topology: Topology) -> Array:
    """Return the gain b_i of each node, (n,), or the largest possible one."""
    if isinstance(topology.nodes, Nodes):
        return np.full(len(topology.ids), topology.network.b)
    common = topology.b if topology.defaults.b is None else largest(topology.defaults.b)
    b = np.full(len(topology.ids), common)
    if topology.given is not None and topology.given.b is not None:
        b[:] = topology.given.b
    for node, own in topology.nodes.items():
        if own.b is not None and topology.has(node):
            b[topology.position(node)] = largest(own.b)
    return b


def _made_degrees(topology: Topology) -> Array:
    if topology.generator is not None:
        return (topology.graph.degree * largest(topology.generator.weight)).astype(np.float64)
    return topology.graph.weighted_degree.astype(np.float64)


def _written_degrees(topology: Topology) -> Array:
    weights: dict[frozenset[int | str], float] = {}
    for edge in topology.edges:
        i, j = ends_of(edge)
        if i != j:
            weights.setdefault(frozenset((i, j)), largest(weight_of(edge)))
    degree = np.zeros(len(topology.ids))
    for ends, weight in weights.items():
        for node in ends:
            if topology.has(node):
                degree[topology.position(node)] += weight
    return degree
