"""The first disturbances of a search: rest states, which runs confirm; and settled gains that longer runs keep."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import hedgerow as hg
from hedgerow.orchestrator.experiments.sweep.runs import run_here
from hedgerow.orchestrator.experiments.worst.hunt import Attack, Hunt
from hedgerow.orchestrator.experiments.worst.loop import Breaks, Scene, play
from hedgerow.orchestrator.experiments.worst.rest import LEAD, resting, steered
from hedgerow.orchestrator.experiments.worst.search import Island, Kind
from hedgerow.topologies.schema import Topology
from tests.orchestrator.experiments.test_worst import EAGER, vector
from tests.tools.networks import networks, read

TABLE = [
    (hg.load("paper7"), 3.388),
    (vector("v1_path2"), 5.63),
    (vector("v2_tree7"), 5.66),
    (vector("w1_path3"), 4.998),
]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("topology", "least"), TABLE)
def test_the_first_populations_have_the_gain_of_the_table(topology: Topology, least: float, seed: int) -> None:
    """96 runs of 150 steps are enough, so that a slow machine finds it too."""
    scene, rng = Scene.of(topology), np.random.default_rng(seed)
    islands = [Island.new(scene, kind, 48, rng) for kind in (Kind(1, True), Kind(4, True))]
    assert math.sqrt(max(island.judge(scene, island.members)[0].max() for island in islands)) > least


@settings(max_examples=20, deadline=None, suppress_health_check=list(HealthCheck))
@given(networks(), st.integers(0, 99), st.booleans())
def test_a_rest_state_stays_and_its_estimates_are_the_nearest(topology: Topology, seed: int, leads: bool) -> None:
    scene = Scene.of(topology)
    found = resting(scene, 12, np.random.default_rng(seed), leads)
    z = found.x / (1 - found.ahat)
    b = np.broadcast_to(np.asarray(scene.b), len(scene.a))
    after = scene.a * found.x - b * (b * z @ scene.laplacian(frozenset())) + found.w
    np.testing.assert_allclose(after, found.x, rtol=1e-6, atol=1e-9 * np.abs(found.x).max(initial=1))
    candidates = scene.view.candidates
    residuals = np.abs((candidates - scene.a) * found.x[:, None] - found.w[:, None])
    own = np.abs((found.ahat - scene.a) * found.x - found.w)
    assert (own <= np.nanmin(residuals, axis=1) * (1 + 1e-9)).all()


def test_a_run_is_led_to_a_rest_state() -> None:
    scene, rng = Scene.of(hg.load("paper7")), np.random.default_rng(0)
    found = resting(scene, 24, rng, steered=True)
    w = steered(scene, found, rng)
    assert w.shape == (len(found.w), LEAD + 1, 7)
    ends = play(scene, w, steps=400).x[-1]
    assert np.isclose(ends, found.x, rtol=1e-3).all(axis=1).mean() > 0.3


def test_an_estimate_that_a_large_disturbance_has_locked_is_not_settled() -> None:
    """The lead of the model shrinks at every step: the gain with it is not the limit of longer runs."""
    scene = Scene.of(EAGER)
    w = np.zeros((1, 8, 2))
    w[0, 0], w[0, -1] = 100.0, 1.0
    played = play(scene, w, steps=150)
    assert played.sound[-1, 0]
    np.testing.assert_allclose(played.theta[-50:], 1 / (1 - 0.3))
    assert not played.settled(50, 1e-6)[0]
    steady = play(scene, np.ones((1, 1, 2)), steps=150)
    assert steady.settled(50, 1e-6)[0]


@settings(max_examples=15, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_faults_that_overlap_on_one_edge_are_those_of_the_engine(data: st.DataObject) -> None:
    """Cuts of one edge, and drops on its links: twice on one link, in both directions, before and after a cut."""
    hunt = Hunt(data.draw(networks(most=4, steps=12)))
    graph, steps = hunt.scene.graph, 12
    if not len(graph.edges):
        return
    edge, first = data.draw(st.integers(0, len(graph.edges) - 1)), st.integers(0, steps - 1)
    links = st.sampled_from(np.flatnonzero(graph.edge == edge).tolist())
    cuts = data.draw(st.lists(st.tuples(st.just(edge), first), max_size=2))
    drops = data.draw(st.lists(st.tuples(links, first), min_size=1, max_size=3))
    breaks = Breaks(tuple(cuts), tuple(drops))
    w = np.random.default_rng(data.draw(st.integers(0, 99))).standard_normal((1, steps, graph.n))
    played = play(hunt.scene, w, breaks)
    if played.sound[-1, 0]:
        content = run_here(hunt.topology_of(Attack(w[0], False, breaks, 0.0, 0.0, steps)))
        gain = math.sqrt(played.cost.sum() / np.square(w).sum())
        assert content["metrics"]["gain"] == pytest.approx(gain, rel=1e-9)


def test_a_node_that_never_learns_is_on_no_tie() -> None:
    """It acts on its first candidate, which no rounding changes: the drop that hurts most may begin at step 0."""
    nodes = "{1: {a: 0.5, candidates: [0.8, 0.5]}, 2: {a: 0.5, candidates: [0.5]}}"
    hunt = Hunt(read(f"{{name: deaf, b: 0.1, steps: 9, nodes: {nodes}, edges: [[1, 2]]}}"))
    link = int(np.flatnonzero(hunt.scene.graph.node == 0)[0])
    w, breaks = np.ones((1, 9, 2)), Breaks(drops=((link, 0),))
    played = play(hunt.scene, w, breaks)
    assert played.sound.all()
    content = run_here(hunt.topology_of(Attack(w[0], False, breaks, 0.0, 0.0, 9)))
    gain = math.sqrt(played.cost.sum() / np.square(w).sum())
    assert content["metrics"]["gain"] == pytest.approx(gain, rel=1e-9)
