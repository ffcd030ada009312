"""The bound with one multiplier for all edges: never below the program with one matrix, and proved again."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hedgerow as hg
from hedgerow.orchestrator.metrics import gain_uniform
from hedgerow.orchestrator.metrics.gain_bound import Method, Premise, bound, method_for
from hedgerow.orchestrator.metrics.gain_plant import PlantModel
from hedgerow.orchestrator.metrics.gain_uniform import Edges, Nodes, least
from hedgerow.orchestrator.metrics.guarantee import guarantee, plant_of
from hedgerow.orchestrator.metrics.semidefinite import NoBoundError
from tests.orchestrator.metrics.test_gain_bound import TABLE, UNEQUAL, _oracle, plants
from tests.tools.examples import examples

CLOSED = (Premise.EDGES, Premise.JUMPS)


def network(kind: str, n: int) -> PlantModel:
    """Return a network of n nodes with the lists [0.2, 0.5, 0.8]."""
    shape = {"regular": {"kind": "random_regular", "degree": 3}, "tree": {"kind": "random_tree", "max_degree": 3}}
    graph = {**shape.get(kind, {"kind": kind}), "nodes": n}
    lists = {"candidates": [0.2, 0.5, 0.8]}
    text = {"name": kind, "b": 0.1, "steps": 1, "seed": 1, "graph": graph, "defaults": lists}
    return plant_of(hg.load(text).network)


@pytest.mark.parametrize("premise", CLOSED)
@pytest.mark.parametrize("plant", [row[0] for row in TABLE])
def test_it_is_at_most_three_per_cent_above_the_program_with_one_matrix(plant: PlantModel, premise: Premise) -> None:
    try:
        whole = bound(plant, premise, Method.WHOLE).gain
    except NoBoundError:
        with pytest.raises(NoBoundError):
            bound(plant, premise, Method.UNIFORM)
        return
    assert whole * (1 - 1e-3) <= bound(plant, premise, Method.UNIFORM).gain <= 1.03 * whole


@settings(max_examples=12, deadline=None)
@given(plants(), st.sampled_from(CLOSED))
def test_it_is_never_below_the_program_with_one_matrix(plant: PlantModel, premise: Premise) -> None:
    try:
        found = bound(plant, premise, Method.UNIFORM).gain
    except NoBoundError:
        return
    assert found >= _oracle(plant) * (1 - 1e-6)
    with contextlib.suppress(NoBoundError):  # the solver fails where numbers are large
        assert found >= bound(plant, premise, Method.WHOLE).gain * (1 - 1e-3)


@settings(max_examples=examples(40), deadline=None)
@given(
    st.floats(0.05, 0.9), st.floats(0.0, 0.3), st.floats(0.0, 0.9), st.floats(1.01, 30.0), st.floats(1.001, 1e4),
    st.booleans(),
)  # fmt: skip
def test_eta_is_the_least_of_a_node(
    low: float, width: float, place: float, nu: float, more: float, jumps: bool
) -> None:
    high = min(0.95, low + width)
    one = np.array([low]), np.array([high])
    plant = PlantModel(
        np.array([low + place * (high - low)]), np.ones(1), np.empty((0, 2), dtype=int), np.ones(0), *one
    )
    nodes = Nodes.of(plant, jumps)
    g = nodes.least_g * more
    found = least(nodes, g, nu)
    a, keep = float(nodes.middle[0]), float(1 - nodes.radius[0]) ** 2
    q = np.geomspace(1e-2, 1e6, 20_001)
    c = keep * q * g / (q + g) - 1 - a * a * q
    m = np.maximum(nu * nodes.alpha_high / 2 - a * q, a * q - nu * nodes.alpha_low / 2)
    grid = (q + m * m / np.where(c > 0, c, 1e-9))[c > 0].min(initial=np.inf)
    assert found.eta[0] <= grid * (1 + 1e-9)
    step = 1e-3 * nu
    slope = (least(nodes, g, nu + step).eta - least(nodes, g, nu - step).eta)[0] / (2 * step)
    assert found.by_nu[0] == pytest.approx(slope, rel=2e-2, abs=1e-3 * abs(found.eta[0]))


@settings(max_examples=examples(40), deadline=None)
@given(plants(), st.integers(0, 2**32 - 1), st.floats(0.9, 1.1), st.booleans())
def test_edges_are_proved_if_and_only_if_the_eigenvalue_leaves_room(
    plant: PlantModel, seed: int, share: float, factored: bool
) -> None:
    edges = Edges(plant.n, plant.edges, plant.b[plant.edges] * plant.root_weights[:, None])
    eta = np.random.default_rng(seed).uniform(0.1, 10.0, plant.n)
    B = edges.signed.toarray()
    room = share * float(np.linalg.eigvalsh(B.T @ (eta[:, None] * B))[-1]) if len(plant.edges) else 1.0
    proved = edges._factored(eta, room) if factored and len(plant.edges) else edges.proved(eta, room)
    if share < 1 and len(plant.edges):
        assert not proved
    if share > 1 + 1e-6 or not len(plant.edges):
        assert proved


def test_weights_prove_the_edges_of_odd_cycles_too_if_there_is_room(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gain_uniform, "FACTORED", 0)
    regular = network("regular", 400)
    by_weights = bound(regular, Premise.EDGES, Method.UNIFORM).gain
    monkeypatch.undo()
    factored = bound(regular, Premise.EDGES, Method.UNIFORM).gain
    assert factored <= by_weights <= 1.02 * factored


@pytest.mark.parametrize(("kind", "n"), [("tree", 10_000), ("regular", 4_000), ("ring", 10_000)])
def test_ten_thousand_nodes_take_seconds(kind: str, n: int) -> None:
    plant = network(kind, n)
    began = time.process_time()
    found = guarantee(plant)
    assert time.process_time() - began < 30
    assert {one.method for one in found.bounds.values()} == {Method.UNIFORM}
    gains = [found.bounds[premise].gain for premise in Premise]
    assert gains == sorted(gains)
    assert 5.3 < gains[0] < 5.7


@pytest.mark.parametrize("n", [300, 301])
def test_both_methods_agree_where_one_takes_over(n: int) -> None:
    plant = network("tree", n)
    split, uniform = (bound(plant, Premise.EDGES, method).gain for method in (Method.SPLIT, Method.UNIFORM))
    assert uniform == pytest.approx(split, rel=2e-3)
    assert method_for(plant, Premise.EDGES) == (Method.SPLIT if n == 300 else Method.UNIFORM)


def test_a_node_of_many_edges_and_nodes_without_edges_are_bounded() -> None:
    edges = np.array([[0, j] for j in range(1, 400)])
    hub = PlantModel.of(np.full(402, 0.5), 0.005, edges, None, np.full(402, 0.4), np.full(402, 0.6))
    found = guarantee(hub)
    assert not found.not_computed
    assert found.bounds[Premise.EDGES].gain == pytest.approx(bound(hub, Premise.EDGES, Method.UNIFORM).gain)
    for n in (1, 3):
        alone = PlantModel.of(
            np.full(n, 0.5), 0.1, np.empty((0, 2), dtype=np.int64), None, np.full(n, 0.2), np.full(n, 0.8)
        )  # fmt: skip
        assert bound(alone, Premise.EDGES, Method.UNIFORM).gain == pytest.approx(2.0, rel=1e-3)
        assert bound(alone, Premise.JUMPS, Method.UNIFORM).gain == pytest.approx(5.0, rel=1e-3)


def test_a_network_without_a_bound_is_said_to_have_none() -> None:
    with pytest.raises(NoBoundError):
        bound(TABLE[1][0], Premise.JUMPS, Method.UNIFORM)
    with pytest.raises(NoBoundError):
        bound(dataclasses.replace(UNEQUAL, a=np.array([0.6, 0.7, 0.8])), Premise.JUMPS, Method.UNIFORM)


def test_a_storage_that_is_too_small_is_not_proved() -> None:
    nodes = Nodes.of(UNEQUAL, jumps=False)
    edges = Edges(3, UNEQUAL.edges, UNEQUAL.b[UNEQUAL.edges] * UNEQUAL.root_weights[:, None])
    g, nu = gain_uniform.search(nodes, edges, math.inf)
    assert gain_uniform._proof(nodes, edges, least(nodes, g * 1.001, nu, 1e-9), 1e-9) is not None
    assert gain_uniform._proof(nodes, edges, least(nodes, g * 0.999, nu, 1e-9), 1e-9) is None
    smaller = dataclasses.replace(least(nodes, g * 1.001, nu, 1e-9), g=0.99 * g)
    assert gain_uniform._proof(nodes, edges, smaller, 1e-9) is None
