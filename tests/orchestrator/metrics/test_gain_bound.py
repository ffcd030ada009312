"""The bounds on the gain of the adaptive law: known values, their order, and the proof of each."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hedgerow as hg
from hedgerow.orchestrator.metrics import gain_bound
from hedgerow.orchestrator.metrics.gain_bound import Bound, Method, Premise, bound, method_for
from hedgerow.orchestrator.metrics.gain_plant import PlantModel
from hedgerow.orchestrator.metrics.guarantee import fingerprint, guarantee, plant_of
from hedgerow.orchestrator.metrics.semidefinite import NoBoundError
from hedgerow.topologies.graph import Array, Graph
from hedgerow.topologies.hinf import gamma_star
from tests.tools.networks import VECTORS, from_vector

EAGER = PlantModel.of(
    np.array([0.3, 0.3]), 0.1, np.array([[0, 1]]), None, np.array([0.3, 0.3]), np.array([0.979, 0.979])
)  # fmt: skip
UNEQUAL = PlantModel.of(
    np.array([0.6, 0.5, 0.8]),
    np.array([0.1, 0.2, 0.05]),
    np.array([[0, 1], [1, 2]]),
    np.array([1.0, 0.25]),
    np.array([0.3, 0.35, 0.2]),
    np.array([0.9, 0.6, 0.9]),
)


def vector(name: str) -> PlantModel:
    (path,) = (path for path in VECTORS if path.stem == name)
    return plant_of(from_vector(path)[0].network)


TABLE = [
    (plant_of(hg.load("paper7").network), 3.654, 3.755),
    (EAGER, 19.585, 19.585),
    (vector("v1_path2"), 6.218, 7.289),
    (vector("v2_tree7"), 6.672, 7.672),
    (UNEQUAL, 5.002, 5.032),
    (vector("w1_path3"), 5.002, 5.032),
]


@st.composite
def plants(draw: st.DrawFn) -> PlantModel:
    """Networks with cycles, unequal gains and weights, lists of one or more, and isolated nodes."""
    n = draw(st.integers(1, 6))
    seed = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    pairs = np.array([(i, j) for i in range(n) for j in range(i + 1, n)], dtype=np.int64).reshape(-1, 2)
    edges = pairs[seed.random(len(pairs)) < draw(st.sampled_from([0.3, 0.6, 1.0]))]
    weights = seed.uniform(0.2, 2.0, len(edges))
    weighted = np.bincount(edges.ravel(), np.repeat(weights, 2), n)
    lowest = seed.uniform(0.1, 0.5, n)
    highest = np.where(seed.random(n) < 0.2, lowest, seed.uniform(lowest, 0.9))
    a = seed.uniform(lowest, highest)
    room = np.minimum(lowest * (1 - lowest), highest * (1 - highest))
    b = 0.95 * np.sqrt(room / (2 * np.maximum(weighted, 1e-9))).clip(max=1.0)
    return PlantModel.of(a, b, edges, weights, lowest, highest)


@pytest.mark.parametrize(("plant", "estimates", "edges"), TABLE)
def test_bounds_are_those_of_the_table(plant: PlantModel, estimates: float, edges: float) -> None:
    for method in (Method.WHOLE, Method.SPLIT):
        assert bound(plant, Premise.ESTIMATES, method).gain == pytest.approx(estimates, abs=6e-4)
        assert bound(plant, Premise.EDGES, method).gain == pytest.approx(edges, abs=6e-4)


def test_a_full_storage_bounds_paper7_by_less() -> None:
    assert bound(TABLE[0][0], Premise.ESTIMATES, Method.FULL).gain == pytest.approx(3.588, abs=6e-4)


@settings(max_examples=8, deadline=None)
@given(plants())
def test_bounds_are_ordered(plant: PlantModel) -> None:
    """A weaker premise, fewer unknowns or smaller matrices never give less; the oracle's gain is below all."""
    near = 1 + 1e-3  # the margin of a proof, where the storage is large
    whole = {premise: _or_inf(plant, premise, Method.WHOLE) for premise in Premise}
    assert whole[Premise.ESTIMATES] <= whole[Premise.EDGES] * near
    assert whole[Premise.EDGES] <= whole[Premise.JUMPS] * near
    for premise in Premise:
        assert _or_inf(plant, premise, Method.FULL) <= whole[premise] * near
        assert whole[premise] <= _or_inf(plant, premise, Method.SPLIT) * near
    assert whole[Premise.ESTIMATES] * near >= _oracle(plant)


def _or_inf(plant: PlantModel, premise: Premise, method: Method) -> float:
    try:
        return bound(plant, premise, method).gain
    except NoBoundError:
        return math.inf


def _oracle(plant: PlantModel) -> float:
    """Return gamma* from the weighted Laplacian."""
    incidence = np.zeros((plant.n, len(plant.edges)))
    for k, (i, j) in enumerate(plant.edges.tolist()):
        incidence[i, k], incidence[j, k] = plant.root_weights[k], -plant.root_weights[k]
    b = plant.b[:, None] * incidence
    return float(np.linalg.eigvalsh(np.diag((1 - plant.a) ** 2) + b @ b.T)[0] ** -0.5)


def test_one_candidate_per_node_gives_the_optimal_gain() -> None:
    plant = dataclasses.replace(UNEQUAL, lowest=UNEQUAL.a, highest=UNEQUAL.a)
    assert bound(plant, Premise.ESTIMATES).gain == pytest.approx(_oracle(plant), rel=1e-5)
    uniform = plant_of(hg.load("paper7").network)
    assert _oracle(uniform) == pytest.approx(
        gamma_star(uniform.a, 0.1, Graph(uniform.n, uniform.edges)), rel=1e-9
    )  # fmt: skip


def test_the_split_program_is_exact_on_trees_and_costs_little_on_cycles() -> None:
    triangle = PlantModel.of(
        np.array([0.3, 0.5, 0.7]), 0.15, np.array([[0, 1], [1, 2], [0, 2]]), None, np.full(3, 0.2), np.full(3, 0.8)
    )  # fmt: skip
    whole, split = (bound(triangle, Premise.EDGES, method).gain for method in (Method.WHOLE, Method.SPLIT))
    assert whole <= split <= 1.25 * whole
    assert method_for(triangle, Premise.EDGES) == Method.WHOLE
    assert method_for(UNEQUAL, Premise.EDGES) == Method.SPLIT


def test_a_ring_of_96_is_bounded_below_17_in_the_split_program() -> None:
    n = 96
    ring = PlantModel.of(
        np.random.default_rng(0).uniform(0.1, 0.9, n),
        0.1,
        np.array([[i, (i + 1) % n] for i in range(n)]),
        None,
        np.full(n, 0.1),
        np.full(n, 0.9),
    )
    assert bound(ring, Premise.EDGES).gain < 17


def test_an_answer_of_the_solver_that_is_a_little_too_small_is_not_proved() -> None:
    program, _ = gain_bound._split(UNEQUAL, Premise.EDGES)
    y = program.solve(gain_bound.MARGIN, 60)
    assert program.proof(y, gain_bound.MARGIN / 2) is not None
    y[0] *= 1 - 1e-4
    assert program.proof(y, 0.0) is None


def test_bounds_that_do_not_exist_name_a_reason() -> None:
    found = guarantee(EAGER)
    assert found.not_computed.keys() == {Premise.JUMPS}
    outside = dataclasses.replace(UNEQUAL, a=np.array([0.6, 0.7, 0.8]))
    assert guarantee(outside).not_computed.keys() == {Premise.JUMPS}


def test_storage_is_that_of_p() -> None:
    x = np.array([[1.0, 2.0], [0.0, -1.0]])
    for p in (np.array([2.0, 3.0]), np.array([[2.0, 0.5], [0.5, 3.0]])):
        one = Bound(Premise.EDGES, Method.WHOLE, 4.0, p, 1e-8, 1.0, 0.0)
        full: Array = np.diag(p) if p.ndim == 1 else p
        assert one.gain == 2.0
        np.testing.assert_allclose(one.storage(x), np.einsum("bi,ij,bj->b", x, full, x))


def test_the_facade_and_the_json_hold_the_same_numbers() -> None:
    found = hg.bound("paper7", full=True)
    document = json.loads(json.dumps(found.to_dict()))
    assert document["gamma_star"] == found.gamma_star == pytest.approx(2.974, abs=5e-4)
    assert document["bounds"]["estimates"]["gain"] == found.bounds[Premise.ESTIMATES].gain
    assert np.shape(document["bounds"]["edges"]["p"]) == (7, 7)
    assert "3.588" in found.text()


def test_the_fingerprint_is_of_what_the_gain_depends_on() -> None:
    paper = hg.load("paper7")
    same = hg.load("paper7", steps=99)
    assert fingerprint(plant_of(paper.network)) == fingerprint(plant_of(same.network))
    assert fingerprint(UNEQUAL) != fingerprint(dataclasses.replace(UNEQUAL, a=UNEQUAL.a + 1e-9))
