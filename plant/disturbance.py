"""Disturbances w(t) of all nodes at once: a function of (specification, seed, t), never of what ran before."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from hedgerow.topologies.graph import Array, Index
from hedgerow.topologies.network import Group

BLOCK = 2**14
"""nodes whose values stay in the cache while they are computed"""

Component = Callable[[int], Array]
"""The values at step t of the nodes that have this component."""


class Disturbance:
    """The sum of all groups, over n nodes; they are ordered, so that a node's are added in the order of its list."""

    def __init__(self, groups: Iterable[Group], n: int, seed: int) -> None:
        self._n = n
        self._groups: list[tuple[Index, Component]] = [(group.nodes, self._component(group, seed)) for group in groups]

    def at(self, t: int) -> Array:
        """w(t), (n,)."""
        w = None
        for nodes, component in self._groups:
            if len(nodes) == self._n:  # in order, so that they are all of them
                w = component(t) + (0.0 if w is None else w)
            else:
                w = np.zeros(self._n) if w is None else w
                w[nodes] += component(t)
        return np.zeros(self._n) if w is None else w

    def _component(self, group: Group, seed: int) -> Component:
        columns = group.values
        match group.kind:
            case "samples":
                values = columns["values"]
                return lambda t: np.asarray(values[:, t])
            case "sinusoid":
                amplitude, omega, phase = columns["amplitude"], columns["omega"], columns["phase"]
                return lambda t: _sinusoid(amplitude, omega, phase, t)
            case "constant":
                return lambda _: columns["value"]
            case "impulse":
                return lambda t: np.where(columns["at"] == t, columns["value"], 0.0)
            case _:
                return lambda t: columns["std"] * _gaussian(seed, group.number, t, self._n)[group.nodes]


def _sinusoid(amplitude: Array, omega: Array, phase: Array, t: int) -> Array:
    """A sinusoid at step t, amplitude * sin(omega * t + phase), in place and while it is in the cache."""
    w = np.empty_like(omega)
    for start in range(0, len(w), BLOCK):
        some = slice(start, start + BLOCK)
        part = np.multiply(omega[some], t, out=w[some])
        part += phase[some]
        np.sin(part, out=part)
        part *= amplitude[some]
    return w


def _gaussian(seed: int, number: int, t: int, n: int) -> Array:
    """Standard normal numbers for all n nodes at step t; a counter-based generator needs no memory of other steps."""
    bits = np.random.Philox(key=np.array([seed, number], dtype=np.uint64), counter=[0, 0, 0, t])
    return np.random.Generator(bits).standard_normal(n)
