"""Disturbances w(t) of all nodes at once: a function of (specification, seed, t), never of earlier calls.

One kind, `confuse`, also depends on the state x(t) and the true a of its step.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hedgerow.topologies import lots
from hedgerow.topologies.graph import Array, Index
from hedgerow.topologies.network import Group

BLOCK = 2**14
"""the number of nodes per block, which fits the cache"""
AHEAD = 64
"""The number of steps of white noise in one draw, if the network is small."""

Component = Callable[[int, Array | None, Array | None], Array]
"""The values at step t of the nodes with this component, from x(t) and a of all nodes."""


class Disturbance:
    """The sum of all groups over n nodes, in the order of each node's list."""

    def __init__(
        self, groups: Iterable[Group], ids: Sequence[int | str] | NDArray[Any], seed: int | lots.Words
    ) -> None:
        """Prepare the groups; `seed` is one number, or one per node, (n,)."""
        self._n, self._ids = len(ids), ids
        self._groups: list[tuple[Index, Component]] = []
        self.sees_state = False
        """True if w(t) depends on x(t) and a: `at` then needs both"""
        for group in groups:
            self._groups.append((group.nodes, self._component(group, seed)))
            self.sees_state |= group.kind == "confuse"

    def at(self, t: int, x: Array | None = None, a: Array | None = None) -> Array:
        """Return w(t), (n,); x(t) and the true a, (n,), are needed if `sees_state`."""
        w = None
        for nodes, component in self._groups:
            if len(nodes) == self._n:  # the nodes are in order, so these are all of them
                w = component(t, x, a) + (0.0 if w is None else w)
            else:
                w = np.zeros(self._n) if w is None else w
                w[nodes] += component(t, x, a)
        return np.zeros(self._n) if w is None else w

    def _component(self, group: Group, seed: int | lots.Words) -> Component:
        columns = group.values
        match group.kind:
            case "samples":
                values = columns["values"]
                return lambda t, *_: np.asarray(values[:, t])
            case "sinusoid":
                amplitude, omega, phase = columns["amplitude"], columns["omega"], columns["phase"]
                return lambda t, *_: _sinusoid(amplitude, omega, phase, t)
            case "constant":
                return lambda *_: columns["value"]
            case "impulse":
                return lambda t, *_: np.where(columns["at"] == t, columns["value"], 0.0)
            case "confuse":
                return partial(_confuse, group.nodes, columns["candidate"])
            case kind:
                words = lots.words_of(self._ids)[group.nodes]
                own = seed if isinstance(seed, int) else seed[group.nodes]
                keys = noise_keys(kind, own, group.number, words)
                noise = (
                    _White(keys, columns["std"]) if kind == "white" else _Coloured(keys, columns["phi"], columns["std"])
                )
                return lambda t, *_: noise.at(t)


def _sinusoid(amplitude: Array, omega: Array, phase: Array, t: int) -> Array:
    """Return amplitude * sin(omega * t + phase), computed in place block by block within the cache."""
    w = np.empty_like(omega)
    if len(w) <= BLOCK:
        _fill(w, amplitude, omega, phase, t)
    else:
        for start in range(0, len(w), BLOCK):
            some = slice(start, start + BLOCK)
            _fill(w[some], amplitude[some], omega[some], phase[some], t)
    return w


def _fill(w: Array, amplitude: Array, omega: Array, phase: Array, t: int) -> None:
    """Write amplitude * sin(omega * t + phase) into w, all (k,)."""
    np.multiply(omega, t, out=w)
    w += phase
    np.sin(w, out=w)
    w *= amplitude


def _confuse(nodes: Index, candidate: Array, _: int, x: Array | None, a: Array | None) -> Array:
    """Return (a' - a_i) x_i of these nodes, (k,)."""
    if x is None or a is None:
        raise ValueError("a disturbance that sees the state needs x and a")
    return np.asarray((candidate - a[nodes]) * x[nodes])


def noise_keys(kind: str, seed: int | lots.Words, number: int, words: lots.Words) -> lots.Words:
    """Return the keys of a kind of noise at one place of the list of nodes with these words; docs/topology.md.

    `seed` is one, or an array that broadcasts with `words`: (S, 1) gives (S, n).
    """
    return lots.keys(seed, f"disturbance.{number}.{kind}", words)


class _White:
    """White noise of k nodes. One draw covers a block of steps, so a small network needs few calls per step."""

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


class _Coloured:
    """Noise of k nodes with w(t) = phi w(t - 1) + sqrt(1 - phi^2) std e(t), e(t) standard white noise, w(0) = std e(0).

    Every w(t) comes from all earlier steps in order. If an earlier step is requested, the sequence restarts at 0 and
    has the same bits.
    """

    def __init__(self, keys: lots.Words, phi: Array, std: Array) -> None:
        self._e = _White(keys, np.ones(len(keys)))
        self._phi, self._std = phi, std
        self._fresh = np.sqrt(1.0 - phi * phi) * std
        self._t, self._w = -1, np.empty(0)

    def at(self, t: int) -> Array:
        """Return w(t) of the nodes, (k,); the caller must not change it."""
        if t < self._t or self._t < 0:
            self._t, self._w = 0, self._std * self._e.at(0)
        while self._t < t:
            self._t += 1
            self._w = self._phi * self._w + self._fresh * self._e.at(self._t)
        return self._w
