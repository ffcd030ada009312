"""Disturbances w(t) of all nodes at once: a function of (specification, seed, t), never of what ran before."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hedgerow.topologies import lots
from hedgerow.topologies.graph import Array, Index
from hedgerow.topologies.network import Group

BLOCK = 2**14
"""nodes whose values stay in the cache while they are computed"""
AHEAD = 64
"""steps of white noise that are drawn at once, where the nodes are few"""

Component = Callable[[int], Array]
"""The values at step t of the nodes that have this component."""


class Disturbance:
    """The sum of all groups, over n nodes; they are ordered, so that a node's are added in the order of its list."""

    def __init__(
        self, groups: Iterable[Group], ids: Sequence[int | str] | NDArray[Any], seed: int | lots.Words
    ) -> None:
        """`seed` is one, or one per node, (n,)."""
        self._n, self._ids = len(ids), ids
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

    def _component(self, group: Group, seed: int | lots.Words) -> Component:
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
                words = lots.words_of(self._ids)[group.nodes]
                own = seed if isinstance(seed, int) else seed[group.nodes]
                return _White(white_keys(own, group.number, words), columns["std"]).at


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


def white_keys(seed: int | lots.Words, number: int, words: lots.Words) -> lots.Words:
    """Return the keys of the white noise at one place of the list of nodes with these words; docs/topology.md.

    `seed` is one, or an array that broadcasts with `words`: (S, 1) gives (S, n).
    """
    return lots.keys(seed, f"disturbance.{number}.white", words)


class _White:
    """White noise of k nodes: a block of steps is drawn at once, so that few nodes cost few calls a step."""

    def __init__(self, keys: lots.Words, std: Array) -> None:
        self._keys, self._std = keys, std
        self._steps = min(AHEAD, max(1, BLOCK // max(1, len(keys))))
        self._first, self._drawn = -self._steps, np.empty((0, len(keys)))

    def at(self, t: int) -> Array:
        """Return w(t) of the nodes, (k,); the caller must not change it."""
        if not 0 <= (row := t - self._first) < self._steps:
            row = t % self._steps
            self._first = t - row
            steps = np.arange(self._first, self._first + self._steps)
            self._drawn = self._std * lots.normals(lots.at(self._keys, steps[:, None]))
        return np.asarray(self._drawn[row])
