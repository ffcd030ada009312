"""Edges with weights: their form in a file, and the draw of random weights."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from pydantic import Discriminator, Field, Tag

from hedgerow.topologies import lots
from hedgerow.topologies.base import Model, NodeId, Positive, PositiveUniform
from hedgerow.topologies.graph import Array, Index

Ends = tuple[int | str, int | str]
PositiveValue = Annotated[
    Annotated[Positive, Tag("number")] | Annotated[PositiveUniform, Tag("random")],
    Discriminator(lambda value: "random" if isinstance(value, dict | Model) else "number"),
]


class Edge(Model):
    """An edge with a weight k_e: its flow is k_e times the flow of an edge without a weight."""

    ends: tuple[NodeId, NodeId] = Field(description="the two node ids")
    weight: PositiveValue = Field(1.0, description="k_e of (1), above 0; or `{random: [low, high]}`")


WrittenEdge = Annotated[
    Annotated[tuple[NodeId, NodeId], Tag("pair")] | Annotated[Edge, Tag("edge")],
    Discriminator(lambda value: "edge" if isinstance(value, dict | Model) else "pair"),
]


def ends_of(edge: Ends | Edge) -> Ends:
    """Return the two node ids of an edge in a file."""
    return edge.ends if isinstance(edge, Edge) else edge


def weight_of(edge: Ends | Edge) -> float | PositiveUniform:
    """Return the weight of an edge in a file; 1 if it has none."""
    return edge.weight if isinstance(edge, Edge) else 1.0


def largest(value: float | PositiveUniform) -> float:
    """Return a number, or the largest possible value of a random one."""
    return value.high if isinstance(value, PositiveUniform) else value


def weights_of(
    written: Sequence[float | PositiveUniform] | float | PositiveUniform,
    seed: int,
    ids: Sequence[int | str],
    edges: Index,
) -> Array | None:
    """Return the weights of edges, (E,), with random ones drawn; None if all weights are 1.

    `written` has one member per edge, or is the same for all of them. `edges` (E, 2) are positions in `ids`. A lot is a
    function of the seed and of the ids of the two ends, in any order.
    """
    if not isinstance(written, Sequence):
        low = np.full(len(edges), written.low if isinstance(written, PositiveUniform) else written)
        high = np.full(len(edges), largest(written))
    else:
        low = np.array([value.low if isinstance(value, PositiveUniform) else value for value in written], dtype=float)
        high = np.array([largest(value) for value in written], dtype=float)
    weights = low
    if len(drawn := np.flatnonzero(low != high)):
        weights[drawn] += (high - low)[drawn] * _lots(seed, ids, edges[drawn])
    return None if (weights == 1).all() else weights


def _lots(seed: int, ids: Sequence[int | str], edges: Index) -> Array:
    words, found = lots.words_of(ids), np.empty(len(edges))
    for start in range(0, len(edges), lots.BLOCK):
        some = slice(start, start + lots.BLOCK)
        one, other = words[edges[some]].T
        found[some] = lots.uniforms(lots.at(lots.keys(seed, "weight", lots.edges_of(one, other)), np.array([0])))
    return found
