"""A resolved network as columns, so that 10^6 nodes need no objects."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hedgerow.topologies import hinf
from hedgerow.topologies.graph import Array, Gain, Graph, Index

QUICK = 10_000
"""Up to this number of nodes, gamma* takes at most 0.1 s."""
PARAMETERS: dict[str, tuple[str, ...]] = {
    "sinusoid": ("amplitude", "omega", "phase"),
    "constant": ("value",),
    "white": ("std",),
    "ar1": ("phi", "std"),
    "confuse": ("candidate",),
    "impulse": ("at", "value"),
    "samples": ("values",),
}
"""By kind of disturbance: the names of its numbers in a file."""


@dataclass(frozen=True, eq=False)
class Group:
    """Disturbances of one kind, all at the same place of their node's list."""

    number: int
    """that place, from 0"""
    kind: str
    nodes: Index
    """positions of the nodes, ascending, (k,)"""
    values: Mapping[str, NDArray[Any]]
    """the values by parameter, (k,); of samples (k, T)"""


@dataclass(frozen=True, eq=False)
class Network:
    """A network of n nodes; each array is over the nodes in network order."""

    ids: Sequence[int | str]
    graph: Graph
    b: Gain
    """one number if all nodes have the same gain"""
    a: Array
    """the truth at t = 0, (n,)"""
    x0: Array
    nominal: Array
    candidates: Array
    """one column per node, with NaN after the end of a shorter list, (M, n)"""
    disturbance: Sequence[Group]
    """ordered by place and then by kind, which is the order of the sum"""
    parts: Index
    """the number of disturbances of each node, those of the kind `none` included, (n,)"""
    labels: Sequence[str] | None = None
    """a text for each node, empty if it has none; None if no node has one"""
    positions: Array | None = None
    """the place of each node in pictures, (n, 2), NaN if the file gives none; None if no node has one"""

    def __repr__(self) -> str:
        return f"<Network: {len(self.ids)} nodes, {len(self.graph.edges)} edges>"

    def name(self, k: int) -> str:
        """Return the name of node k in pictures: its label, or its id if it has none."""
        return self.labels[k] if self.labels is not None and self.labels[k] else str(self.ids[k])

    def title(self, k: int) -> str:
        """Return the name of node k in tables: its id, which commands use, and its label if it has one."""
        label = self.labels[k] if self.labels is not None else ""
        return f"{self.ids[k]} {label}".rstrip()

    @cached_property
    def gamma_star(self) -> float:
        """Return gamma* of the truth at t = 0. It is computed on request, because 10^6 nodes take ten seconds."""
        return hinf.gamma_star(self.a, self.b, self.graph)

    @property
    def gamma_star_now(self) -> float:
        """Return gamma* for a display during the run; NaN for a large network, because it takes too long."""
        return self.gamma_star if len(self.a) <= QUICK else math.nan


def span(values: Gain) -> str:
    """Return one number, or the range of several, in words."""
    if isinstance(values, float):
        return f"{values:g}"
    low, high = float(values.min()), float(values.max())
    return f"{low:g}" if low == high else f"{low:.4g} to {high:.4g}"


def gains(values: Sequence[float] | Array) -> Gain:
    """Return b of each node, (n,), as one number if all are equal."""
    b = np.array(values, dtype=np.float64)
    return float(b[0]) if (b == b[0]).all() else b


def labels(given: Sequence[str | None]) -> Sequence[str] | None:
    """Return the labels of all nodes; None if no node has one."""
    return tuple(label or "" for label in given) if any(given) else None


def positions(given: Sequence[tuple[float, float] | None]) -> Array | None:
    """Return the positions of all nodes, (n, 2), NaN for a node without one; None if no node has one."""
    if all(place is None for place in given):
        return None
    return np.array([(np.nan, np.nan) if place is None else place for place in given], dtype=np.float64)


def padded(lists: Sequence[Sequence[float]]) -> Array:
    """Return lists of candidates as an array (M, k), one column per list, with NaN after the end of shorter ones."""
    lengths = np.fromiter(map(len, lists), dtype=np.int64, count=len(lists))
    columns = np.full((len(lists), int(lengths.max())), np.nan)
    columns[np.arange(columns.shape[1]) < lengths[:, None]] = [value for listed in lists for value in listed]
    return np.ascontiguousarray(columns.T)


def groups_of(components: Iterable[Sequence[Mapping[str, Any]]], steps: int) -> list[Group]:
    """Return disturbances by kind and place; `components` has the disturbances of each node, as a topology file spells
    them.

    Only the first `steps` samples are used.
    """
    members: dict[tuple[int, str], list[tuple[int, Mapping[str, Any]]]] = defaultdict(list)
    for node, parts in enumerate(components):
        for number, part in enumerate(parts):
            if part["kind"] != "none":
                members[number, part["kind"]].append((node, part))
    return [
        Group(
            number,
            kind,
            np.array([node for node, _ in found], dtype=np.int64),
            {key: np.array([_cut(part[key], steps) for _, part in found]) for key in PARAMETERS[kind]},
        )
        for (number, kind), found in sorted(members.items(), key=lambda item: item[0])
    ]


def _cut(value: Any, steps: int) -> Any:
    return value[:steps] if isinstance(value, Sequence) else value
