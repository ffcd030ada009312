"""The local data that a law may request: a record per shard, and a record per step.

A law asks by naming an argument. `local` of its constructor is a `Local`, `now` of `act` and `sample` of `learn` are
each a `Received`. A law without these arguments is called without them, at no extra cost.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from types import FunctionType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hedgerow.topologies import lots
from hedgerow.topologies.graph import Array, Index, Mask

Ids = NDArray[Any]


@dataclass(frozen=True, eq=False)
class Local:
    """The knowledge of a shard of k nodes with m incidences; an incidence is a node and one of its edges.

    Incidences are ordered by node, then by neighbour, in network order.
    """

    ids: Ids
    """the ids of the shard's nodes, (k,)"""
    b: float | Array
    """the input gain b of (1), or one per node, (k,)"""
    candidates: Array
    """the models of each node in list order, padded with NaN, (M, k)"""
    node: Index
    """per incidence: the node, as an index into `ids`, (m,)"""
    neighbour: Ids
    """per incidence: the id of the neighbour, (m,)"""
    weight: Array
    """per incidence: the weight of the edge, (m,); 1 unless the network has weights"""
    parameters: Mapping[str, Any]
    """the parameters of the law, by name"""
    seeds: int | lots.Words
    """`seed`, or for networks side by side that of each node, (k,)"""

    @property
    def seed(self) -> int:
        """Return a function of the seed of the run, which does not reveal the seed that the truth is drawn from."""
        if isinstance(self.seeds, int):
            return self.seeds
        raise AttributeError("the nodes of this shard have different seeds; use draw()")

    @cached_property
    def degree(self) -> Array:
        """Return the sum of the weights of each node's edges, (k,)."""
        degree: Array = np.bincount(self.node, self.weight, len(self.ids)).astype(float, copy=False)
        return degree

    def draw(self, t: int, field: str = "law") -> Array:
        """Return a number in [0, 1) per node, (k,): a function of (seed, field, node id, t), in every layout."""
        keys = self._keys.get(field)
        if keys is None:
            keys = self._keys[field] = lots.keys(self.seeds, field, lots.words_of(self.ids))
        return lots.uniforms(lots.at(keys, np.array([t])))

    @cached_property
    def _keys(self) -> dict[str, lots.Words]:
        return {}

    def sums(self, values: Array) -> Array:
        """Return the sum over each node's incidences, (k,), of values by incidence, (m,)."""
        return np.bincount(self.node, values, len(self.ids)).astype(float, copy=False)


class Received(NamedTuple):
    """The step of a call, its nodes, and the values of their neighbours from the links.

    `act(x, now)` at step t gets the newest values that have arrived by then, each with its step. `learn(x, flow,
    x_next, sample)` of the sample of step t gets the values of step t alone, over the edges that carried flow at t. A
    value that is missing is NaN, and its step is -1. A neighbour without a reading has no values of that step.
    """

    t: int
    nodes: Mask
    """True for the nodes that the call is for, (k,); the columns of the others must stay as they are"""
    x: Array
    """per incidence: the neighbour's state, (m,)"""
    u: Array
    """per incidence: the neighbour's input, (m,)"""
    step: Index
    """per incidence: the step of these values, (m,)"""

    def at(self, t: int) -> Received:
        """Return a copy for a call at step t; a law may change it."""
        return Received(t, self.nodes.copy(), self.x.copy(), self.u.copy(), self.step.copy())


def asks(call: Any, argument: str) -> bool:
    """Return True if a callable names an argument."""
    function = getattr(call, "__func__", call)
    try:
        named = _named if isinstance(function, FunctionType) else _named.__wrapped__
        return argument in named(function)
    except (TypeError, ValueError):  # a callable of C has no signature
        return False


@functools.lru_cache(maxsize=64)
def _named(call: Any) -> frozenset[str]:
    """Return the arguments of a callable; for a function of a law, forked agents know the answer from the start."""
    return frozenset(inspect.signature(call).parameters)
