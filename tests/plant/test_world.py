"""The true network: equation (1), its disturbances, and the facts that hold for any estimates."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hedgerow.agents.law import control
from hedgerow.orchestrator.ground.assignment import layout, truth_of
from hedgerow.plant.disturbance import Disturbance
from hedgerow.plant.world import World, dynamics
from hedgerow.topologies.graph import Array, Gain, Graph
from hedgerow.topologies.hinf import contraction, gamma_star, q_solver
from hedgerow.topologies.network import groups_of, padded
from hedgerow.topologies.resolve import truth
from hedgerow.topologies.schema import Topology
from hedgerow.wire.message import REPORT_ROWS
from tests.tools.examples import examples
from tests.tools.networks import disturbances, networks, observe, read, simulate

SEED = 2**63 - 1


def disturbance(components: Sequence[Sequence[dict[str, Any]]], seed: int) -> Disturbance:
    """Return the disturbance of these nodes, each with its list."""
    return Disturbance(groups_of(components, 50), range(len(components)), seed)


def samples(*components: dict[str, Any], steps: int = 50, seed: int = SEED) -> Array:
    """w(0 .. steps-1) of one node with these components, (steps,)."""
    source = disturbance([components], seed)
    return np.array([source.at(t)[0] for t in range(steps)])


def test_each_kind_follows_its_formula() -> None:
    t = np.arange(50)
    sinusoid = {"kind": "sinusoid", "amplitude": 2.0, "omega": 0.7, "phase": -1.0}
    expected = [2.0 * math.sin(0.7 * k - 1.0) for k in range(50)]
    np.testing.assert_allclose(samples(sinusoid), expected, rtol=0, atol=1e-15)
    assert (samples({"kind": "constant", "value": -0.3}) == -0.3).all()
    assert (samples({"kind": "impulse", "at": 7, "value": 4.0}) == np.where(t == 7, 4.0, 0.0)).all()
    values = list(np.sqrt(np.arange(50)))
    assert samples({"kind": "samples", "values": values}).tolist() == values
    assert (samples({"kind": "none"}) == 0.0).all()
    assert (samples() == 0.0).all()


@given(st.lists(disturbances(12), min_size=1, max_size=5), st.integers(0, 2**63 - 1))
@settings(max_examples=examples(50))
def test_a_list_is_the_sum_of_its_members(written: list[Any], seed: int) -> None:
    """Each member at its place gives the same values as with only `none` around it."""
    nodes: list[list[dict[str, Any]]] = [
        [{"kind": part} if isinstance(part, str) else part for part in parts]
        for parts in (own if isinstance(own, list) else [own] for own in written)
    ]
    nothing: dict[str, Any] = {"kind": "none"}
    whole = disturbance(nodes, seed)
    alone = [
        disturbance([[part if k == m else nothing for k, part in enumerate(parts)] for parts in nodes], seed)
        for m in range(max(map(len, nodes)))
    ]
    for t in range(12):
        total = np.zeros(len(nodes))
        for part in alone:
            total += part.at(t)
        assert whole.at(t).tobytes() == total.tobytes()


def test_white_noise_is_a_function_of_seed_node_and_step() -> None:
    """In any order of calls, and beside other kinds, it is the same; another seed gives other values."""
    white = {"kind": "white", "std": 1.0}
    noise = disturbance([[white]] * 4, SEED)
    forwards = np.array([noise.at(t) for t in range(20)])
    backwards = np.array([disturbance([[white]] * 4, SEED).at(t) for t in reversed(range(20))])
    assert (forwards == backwards[::-1]).all()
    mixed = disturbance([[], [white], [{"kind": "constant", "value": 9.0}], [white]], SEED)
    assert all((mixed.at(t)[[1, 3]] == forwards[t, [1, 3]]).all() for t in range(20))
    other = disturbance([[white]] * 4, SEED - 1)
    assert not any((other.at(t) == forwards[t]).any() for t in range(20))
    assert len(np.unique(forwards)) == forwards.size, "nodes and steps share no number"
    twice = samples({"kind": "none"}, white) - samples(white)
    assert (twice != 0).all(), "two components of one node are two noises"


def test_white_noise_has_the_standard_deviation_asked_for() -> None:
    """20000 samples: moments within five standard errors, no correlation of nodes or steps."""
    noise = disturbance([[{"kind": "white", "std": 2.0}], [{"kind": "white", "std": 0.5}]], 3)
    w = np.array([noise.at(t) for t in range(20_000)])
    error = 1 / math.sqrt(len(w))
    z = w / [2.0, 0.5]
    assert (np.abs(z.mean(axis=0)) < 5 * error).all()
    assert (np.abs(z.std(axis=0) - 1) < 5 * error).all()
    assert abs((z[:, 0] * z[:, 1]).mean()) < 5 * error
    assert (np.abs((z[1:] * z[:-1]).mean(axis=0)) < 5 * error).all()
    assert abs((np.abs(z) < 1).mean() - 0.6827) < 5 * error


@given(networks())
@settings(max_examples=examples(60))
def test_the_world_moves_by_equation_1(topology: Topology) -> None:
    """Against matrices: x(t+1) = A x + diag(b) L u + w with the weighted Laplacian L."""
    world = World(truth_of(topology, layout(topology, None)))
    n, edges = len(topology.ids), topology.graph.edges
    laplacian = np.zeros((n, n))
    for (i, j), weight in zip(edges, weights_of(topology), strict=True):
        laplacian[[i, j], [i, j]] += weight
        laplacian[[i, j], [j, i]] -= weight
    report, took = np.zeros((REPORT_ROWS, n)), [b""] * n
    for t in range(topology.steps):
        x, u = world.x, np.cos(np.arange(n) + t)
        world.begin()
        row = world.step(u, report, took)
        expected = truth(topology) * x + topology.network.b * (laplacian @ u) + row.w
        np.testing.assert_allclose(world.x, expected, rtol=1e-12, atol=1e-12)
    assert world.t == topology.steps


@given(networks(), st.data())
@settings(max_examples=examples(60))
def test_the_flows_of_all_nodes_sum_to_zero(topology: Topology, data: st.DataObject) -> None:
    """A cut edge is closed at both ends: the flows of all nodes always sum to zero, for any weights."""
    edges = len(topology.edges)
    edge_open = np.array(data.draw(st.lists(st.booleans(), min_size=edges, max_size=edges)), bool)
    u = np.sin(np.arange(len(topology.ids)) * 7.0)
    flow, u_edge = topology.graph.flow(u, edge_open), topology.graph.edge_input(u, edge_open)
    assert abs(flow.sum()) <= 1e-11
    assert (u_edge[~edge_open] == 0).all()
    by_hand = np.zeros(len(u))
    for (i, j), on, weight in zip(topology.graph.edges, edge_open, weights_of(topology), strict=True):
        by_hand[i] += on * weight * (u[i] - u[j])
        by_hand[j] += on * weight * (u[j] - u[i])
    np.testing.assert_allclose(flow, by_hand, atol=1e-12)


@given(networks(), st.data())
@settings(max_examples=examples(80))
def test_stability_never_depends_on_the_estimates(topology: Topology, data: st.DataObject) -> None:
    """|x(t+1)| <= rho |x(t)| + |w(t)| in the norm sum |x_i| / b_i, ANY estimates from the lists, ANY cuts, rho < 1."""
    b = topology.network.b
    lists = [own.candidates for own in topology.nodes.values()]
    listed = [np.array(one, dtype=float) for one in lists]
    a, n, edges = truth(topology), len(lists), len(topology.edges)
    rho = contraction(a, padded([one.tolist() for one in listed]))
    assert rho < 1
    unit = st.integers(-100, 100).map(lambda k: k / 10)
    vectors = st.lists(unit, min_size=n, max_size=n).map(np.array)
    x = data.draw(vectors)
    for _ in range(6):
        ahat = np.array([data.draw(st.sampled_from(list(one))) for one in listed])
        on = np.array(data.draw(st.lists(st.booleans(), min_size=edges, max_size=edges)), bool)
        w = data.draw(vectors)
        u = control(b, x, ahat)
        x_next = dynamics(a, b, topology.graph, x, u, w, on)
        bound = rho * np.sum(np.abs(x) / b) + np.sum(np.abs(w) / b)
        assert np.sum(np.abs(x_next) / b) <= bound * (1 + 1e-12)
        x = x_next


def weights_of(topology: Topology) -> Array:
    """The weight of each edge."""
    weights = topology.graph.weights
    return np.ones(len(topology.edges)) if weights is None else weights


def test_rho_is_attained() -> None:
    """The bound is tight: states of one sign with right estimates shrink by exactly rho."""
    topology = read(
        "{name: n, b: 0.2, steps: 1, nodes: {1: {a: 0.6, candidates: [0.6]},"
        " 2: {a: 0.6, candidates: [0.6]}}, edges: [[1, 2]]}"
    )
    a = truth(topology)
    assert contraction(a, np.array([[0.6, 0.6]])) == 0.6
    x = np.array([3.0, 1.0])
    u = control(topology.b, x, a)
    x_next = dynamics(a, topology.b, topology.graph, x, u, np.zeros(2), np.ones(1, np.bool_))
    assert np.abs(x_next).sum() == pytest.approx(0.6 * np.abs(x).sum(), rel=1e-12)


@given(networks(steps=12))
@settings(max_examples=examples(60))
def test_the_oracles_certificate_holds_at_every_step(topology: Topology) -> None:
    """sum (|x*|^2 + |u*_e|^2) <= sum w'Q^-1 w + V(x(0)) - V(x*(t+1)), for any x(0) and any w."""
    observer, batch = observe(topology, simulate(topology))
    supply = float(observer.v0) + float(batch.energy_sum[-1]) * observer.gamma_star**2
    assert (batch.slack >= -1e-9 * (supply + 1e-300)).all()


@given(networks(steps=12, law="hinf"))
@settings(max_examples=examples(60))
def test_the_optimal_controller_keeps_its_gain(topology: Topology) -> None:
    """With the truth known, cost - V(x(0)) is at most gamma*^2 times the energy of w."""
    observer, batch = observe(topology, simulate(topology))
    gain = batch.gain(less=float(observer.v0))
    assert (gain[~np.isnan(gain)] <= observer.gamma_star * (1 + 1e-9)).all()
    assert (batch.regret == 0).all(), "the hinf law is the oracle"


def test_the_certificate_would_notice_a_controller_that_is_not_optimal() -> None:
    """At the worst disturbance, from rest, the slack stays a small part of the supply."""
    topology = read("{name: n, b: 0.2, steps: 400, nodes: {1: {a: 0.6, candidates: [0.6]}}, disturbance: worst_case}")
    observer, batch = observe(topology, simulate(topology))
    supply = batch.energy_sum[-1] * observer.gamma_star**2
    assert 0 <= batch.slack[-1] < 0.02 * supply


@pytest.mark.parametrize("unequal", [False, True])
def test_a_network_of_500_nodes_has_the_same_mathematics(unequal: bool) -> None:
    """Large networks use sparse algebra: gamma* and Q^-1 w agree with the paper's dense matrices."""
    n = 500
    a, edges = 0.3 + 0.4 * np.arange(n) / n, np.array([[i, i + 1] for i in range(n - 1)])
    b: Gain = 0.05 + 0.1 * np.arange(n) / n if unequal else 0.1
    graph = Graph(n, edges, 0.5 + np.arange(n - 1) / n if unequal else None)
    laplacian = np.zeros((n, n))
    for (i, j), weight in zip(edges, np.ones(n - 1) if graph.weights is None else graph.weights, strict=True):
        laplacian[[i, j], [i, j]] += weight
        laplacian[[i, j], [j, i]] -= weight
    gains = np.diag(np.full(n, b))
    q = np.diag((1 - a) ** 2) + gains @ laplacian @ gains
    assert gamma_star(a, b, graph) == pytest.approx(np.linalg.eigvalsh(q)[0] ** -0.5, rel=1e-9)
    w = np.sin(np.arange(n))
    np.testing.assert_allclose(q @ q_solver(a, b, graph)(w), w, rtol=0, atol=1e-9)
