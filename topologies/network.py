"""A resolved network as columns: what 10^6 nodes are, without an object for each of them."""

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
"""Of so many nodes gamma* takes 0.1 s."""
PARAMETERS: dict[str, tuple[str, ...]] = {
    "sinusoid": ("amplitude", "omega", "phase"),
    "constant": ("value",),
    "white": ("std",),
    "ar1": ("phi", "std"),
    "confuse": ("candidate",),
    "impulse": ("at", "value"),
    "samples": ("values",),
}
"""By kind of disturbance: its numbers, as a file names them."""


@dataclass(frozen=True, eq=False)
class Group:
    """Disturbances of one kind, each of which stands at the same place of its node's list."""

    number: int
    """that place, from 0"""
    kind: str
    nodes: Index
    """positions of the nodes, ascending, (k,)"""
    values: Mapping[str, NDArray[Any]]
    """by parameter, (k,); of samples (k, T)"""


@dataclass(frozen=True, eq=False)
class Network:
    """n nodes, each array over them in network order."""

    ids: Sequence[int | str]
    graph: Graph
    b: Gain
    """one number if the gains of all nodes are the same"""
    a: Array
    """the truth at t = 0, (n,)"""
    x0: Array
    nominal: Array
    candidates: Array
    """a column a node, NaN behind the end of a list that is shorter than the longest, (M, n)"""
    disturbance: Sequence[Group]
    """ordered by place and then by kind, the order in which they are added up"""
    parts: Index
    """how many disturbances each node lists, those of the kind `none` among them, (n,)"""
    labels: Sequence[str] | None = None
    """a text for each node, empty where it has none; None if no node has one"""
    positions: Array | None = None
    """where pictures draw each node, (n, 2), NaN where the file does not say; None if no node has one"""

    def name(self, k: int) -> str:
        """The name of node k in pictures: its label, or its id if it has none."""
        return self.labels[k] if self.labels is not None and self.labels[k] else str(self.ids[k])

    def title(self, k: int) -> str:
        """The name of node k in tables: its id, by which commands know it, and its label if it has one."""
        label = self.labels[k] if self.labels is not None else ""
        return f"{self.ids[k]} {label}".rstrip()

    @cached_property
    def gamma_star(self) -> float:
        """gamma* of the truth at t = 0; 10^6 nodes take ten seconds: found when it is asked for."""
        return hinf.gamma_star(self.a, self.b, self.graph)

    @property
    def gamma_star_now(self) -> float:
        """The same for who shows a run that goes on; NaN where it takes so long that nobody can wait for it."""
        return self.gamma_star if len(self.a) <= QUICK else math.nan


def span(values: Gain) -> str:
    """Return one number, or the range of several, in words."""
    if isinstance(values, float):
        return f"{values:g}"
    low, high = float(values.min()), float(values.max())
    return f"{low:g}" if low == high else f"{low:.4g} to {high:.4g}"


def gains(values: Sequence[float] | Array) -> Gain:
    """Return b of each node, (n,), as one number if all of them are the same."""
    b = np.array(values, dtype=np.float64)
    return float(b[0]) if (b == b[0]).all() else b


def labels(given: Sequence[str | None]) -> Sequence[str] | None:
    """Return the labels of all nodes; None if no node has one."""
    return tuple(label or "" for label in given) if any(given) else None


def positions(given: Sequence[tuple[float, float] | None]) -> Array | None:
    """Return the positions of all nodes, (n, 2), NaN where a node has none; None if no node has one."""
    if all(place is None for place in given):
        return None
    return np.array([(np.nan, np.nan) if place is None else place for place in given], dtype=np.float64)


def padded(lists: Sequence[Sequence[float]]) -> Array:
    """Lists of candidates as an array, a column a list, NaN behind the end of the shorter ones, (M, k)."""
    lengths = np.fromiter(map(len, lists), dtype=np.int64, count=len(lists))
    columns = np.full((len(lists), int(lengths.max())), np.nan)
    columns[np.arange(columns.shape[1]) < lengths[:, None]] = [value for listed in lists for value in listed]
    return np.ascontiguousarray(columns.T)


def groups_of(components: Iterable[Sequence[Mapping[str, Any]]], steps: int) -> list[Group]:
    """Disturbances by kind and place; `components` are those of each node, as a topology file spells them.

    Of samples the first `steps` are taken.
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
