"""Disturbances w(t) of all nodes at once: a function of (specification, seed, t), never of what ran before."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from topologies.graph import Array, Index

Component = Callable[[int], Array]
"""The values at step t of the nodes that have this component."""

_KEYS = {
    "sinusoid": ("amplitude", "omega", "phase"),
    "constant": ("value",),
    "white": ("std",),
    "impulse": ("at", "value"),
}


class Disturbance:
    """The sum of every node's components; `components[i]` are those of node i, as a topology file spells them."""

    def __init__(self, components: Sequence[Sequence[Mapping[str, Any]]], seed: int) -> None:
        self._n = len(components)
        groups: dict[tuple[int, str], list[tuple[int, Mapping[str, Any]]]] = defaultdict(list)
        for node, parts in enumerate(components):
            for number, part in enumerate(parts):
                groups[number, part["kind"]].append((node, part))
        # Sorted by number: a node's components are added in the order of its list.
        self._groups: list[tuple[Index, Component]] = [
            (
                np.array([node for node, _ in members], dtype=np.int64),
                self._component(kind, number, members, seed),
            )
            for (number, kind), members in sorted(groups.items(), key=lambda item: item[0])
            if kind != "none"
        ]

    def at(self, t: int) -> Array:
        """w(t), (n,)."""
        w = np.zeros(self._n)
        for nodes, component in self._groups:
            if len(nodes) == self._n:  # in order, so that they are all of them
                w += component(t)
            else:
                w[nodes] += component(t)
        return w

    def _component(
        self, kind: str, number: int, members: Sequence[tuple[int, Mapping[str, Any]]], seed: int
    ) -> Component:
        if kind == "samples":
            values = np.array([part["values"] for _, part in members], dtype=float)
            return lambda t: np.asarray(values[:, t])
        columns = {key: np.array([part[key] for _, part in members]) for key in _KEYS[kind]}
        match kind:
            case "sinusoid":
                amplitude, omega, phase = columns["amplitude"], columns["omega"], columns["phase"]
                return lambda t: amplitude * np.sin(omega * t + phase)
            case "constant":
                return lambda _: columns["value"]
            case "impulse":
                return lambda t: np.where(columns["at"] == t, columns["value"], 0.0)
            case _:
                nodes = np.array([node for node, _ in members], dtype=np.int64)
                return lambda t: columns["std"] * _gaussian(seed, number, t, self._n)[nodes]


def _gaussian(seed: int, number: int, t: int, n: int) -> Array:
    """Standard normal numbers for all n nodes at step t; a counter-based generator needs no memory of other steps."""
    bits = np.random.Philox(key=np.array([seed, number], dtype=np.uint64), counter=[0, 0, 0, t])
    return np.random.Generator(bits).standard_normal(n)
