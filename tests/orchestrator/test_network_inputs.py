"""Objects of Python that people have as networks: each is taken as it is meant, or refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import networkx as nx
import numpy as np
import pandas as pd
import polars as pl
import pytest
import scipy.sparse as sp

import hedgerow as hg
from tests.tools.importing import edges_of

A = np.array([[0, 0.5, 0], [0.5, 0, 2], [0, 2, 0]])
PATH = {frozenset(("x", "y")): 0.5, frozenset(("y", "z")): 2.0}
MATRICES: dict[str, Callable[[], Any]] = {
    "rows in another order than columns": lambda: pd.DataFrame(A, list("xyz"), list("xyz")).loc[["z", "x", "y"]],
    "rows with the numbers of pandas": lambda: pd.DataFrame(A, columns=list("xyz")),
    "objects": lambda: pd.DataFrame(A.astype(object), columns=list("xyz")),
    "sparse columns": lambda: pd.DataFrame.sparse.from_spmatrix(sp.csr_array(A), columns=list("xyz")),
    "polars": lambda: pl.DataFrame(A, schema=list("xyz")),
}
ENDS = {"source": ["x", "y"], "target": ["y", "z"], "weight": [0.5, 2.0]}
FRAMES: dict[str, Callable[[], Any]] = {
    "categories": lambda: pd.DataFrame(ENDS).astype({"source": "category", "target": "category"}),
    "texts": lambda: pd.DataFrame(ENDS).astype(str),
    "twice": lambda: pd.DataFrame({**ENDS, "weight": [0.25, 1.0]}).loc[[0, 0, 1, 1]],
    "polars": lambda: pl.DataFrame(ENDS),
    "array": lambda: np.array([["x", "y", "0.5"], ["y", "z", "2"]]),
}
REFUSED: dict[str, Callable[[], Any]] = {
    "an end is None": lambda: hg.from_edges(pd.DataFrame({"from": ["a", None], "to": ["b", "c"]})),
    "an end is NaN": lambda: hg.from_edges(pd.DataFrame({"from": [1, np.nan], "to": [2, 3]})),
    "an end is NA": lambda: hg.from_edges(pd.DataFrame({"from": pd.array([1, None], dtype="Int64"), "to": [2, 3]})),
    "an end is NaT": lambda: hg.from_edges([(pd.NaT, "a")]),
    "two columns of one name": lambda: hg.from_edges(pd.DataFrame([[1, 2, 3]], columns=["from", "to", "to"])),
    "no pairs": lambda: hg.from_edges([(1, 2, 3, 4)]),
    "NaN in a matrix": lambda: hg.from_adjacency(np.where(A == 0, np.nan, A)),
    "no graph": lambda: hg.from_networkx([1, 2]),
    "a missing weight": lambda: hg.from_edges(pd.DataFrame({**ENDS, "weight": [1, np.nan]})),
}
OPTIONS: list[dict[str, Any]] = [
    {"b": "x"}, {"b": float("nan")}, {"storage": float("nan")}, {"storage": "nan"}, {"storage": -1}, {"storage": "0"},
    {"max_degree": 1.5}, {"steps": "3"}, {"junction_storage": 0},
]  # fmt: skip


@pytest.mark.parametrize("what", MATRICES)
def test_a_matrix_keeps_its_names(what: str) -> None:
    assert edges_of(hg.from_adjacency(MATRICES[what]())) == PATH


@pytest.mark.parametrize("what", FRAMES)
def test_a_table_of_edges(what: str) -> None:
    assert edges_of(hg.from_edges(FRAMES[what]())) == PATH


def test_the_column_that_is_named_for_one_end_is_not_the_other_end() -> None:
    net = hg.from_edges(pd.DataFrame({"x": [1], "y": [2]}), source="y")
    assert edges_of(net) == {frozenset((1, 2)): 1.0}


@pytest.mark.parametrize("what", REFUSED)
def test_what_is_no_network_is_refused(what: str) -> None:
    with pytest.raises(hg.UserError) as raised:
        REFUSED[what]()
    assert raised.value.code == hg.Code.FILE_FORMAT


@pytest.mark.parametrize("options", OPTIONS, ids=str)
def test_an_option_that_is_no_number_above_0_is_refused(options: dict[str, Any]) -> None:
    with pytest.raises(hg.UserError) as raised:
        hg.from_edges([(1, 2), (2, 3)], **options)
    assert raised.value.code == hg.Code.OPTION


@pytest.mark.parametrize("kind", [sp.csr_matrix, sp.coo_array, sp.lil_array, sp.dok_array, sp.dia_array, np.matrix])
@pytest.mark.filterwarnings("ignore")
def test_every_kind_of_matrix_of_both_directions(kind: Any) -> None:
    one_way = kind(np.array([[0, 1, 0], [3, 0, 2], [0, 0, 0.0]]))
    assert edges_of(hg.from_adjacency(one_way)) == {frozenset((0, 1)): 2.0, frozenset((1, 2)): 2.0}


def test_parallel_and_opposite_edges_of_a_graph_are_counted() -> None:
    graph: nx.MultiDiGraph[int] = nx.MultiDiGraph()
    graph.add_weighted_edges_from([(1, 2, 1.0), (1, 2, 2.0), (2, 1, 4.0), (2, 2, 1.0), (2, 3, 0.1)])
    net = hg.from_networkx(graph)
    assert edges_of(net) == {frozenset((1, 2)): 3.5, frozenset((2, 3)): 0.1}
    assert sum(note.startswith("1 ") for note in net.notes) == 3
