"""The connected pieces of a graph, compared with those of scipy."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from hedgerow.topologies.graph import Graph
from hedgerow.topologies.partition import pieces


@st.composite
def graphs(draw: st.DrawFn) -> Graph:
    n = draw(st.integers(1, 30))
    ends = st.tuples(st.integers(0, n - 1), st.integers(0, n - 1)).filter(lambda pair: pair[0] != pair[1])
    some = draw(st.sets(ends.map(lambda pair: (min(pair), max(pair))), max_size=40)) if n > 1 else set()
    return Graph(n, np.array(sorted(some), dtype=np.int64).reshape(-1, 2))


def expected(graph: Graph) -> list[int]:
    i, j = graph.edges.T
    _, piece = connected_components(coo_array((np.ones(len(i)), (i, j)), (graph.n, graph.n)), directed=False)
    return [int(place) for place in np.unique(piece, return_index=True)[1]]


@given(graphs())
def test_every_piece_has_its_first_node(graph: Graph) -> None:
    assert pieces(graph).tolist() == expected(graph)


def test_a_long_path_in_any_order_takes_a_few_rounds() -> None:
    """One round per node would take minutes."""
    order = np.random.default_rng(1).permutation(100_000)
    for places in (order, np.arange(100_000), np.arange(100_000)[::-1]):
        edges = np.stack([places[:-1], places[1:]], axis=1)
        assert pieces(Graph(100_000, edges)).tolist() == [0]
