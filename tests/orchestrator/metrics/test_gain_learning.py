"""The bound that counts learning: below the bound of any estimates, above what attacks reach, and proved."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hedgerow as hg
from hedgerow.orchestrator.experiments.worst.loop import Scene, play
from hedgerow.orchestrator.metrics import gain_learning
from hedgerow.orchestrator.metrics.gain_bound import Method, Premise, bound
from hedgerow.orchestrator.metrics.gain_learning import Learning, learning
from hedgerow.orchestrator.metrics.guarantee import plant_of
from hedgerow.orchestrator.metrics.semidefinite import NoBoundError
from hedgerow.topologies.schema import Topology
from tests.tools.networks import VECTORS, from_vector, read

EAGER = read(
    "{name: eager, b: 0.1, steps: 8, defaults: {a: 0.3, candidates: [0.3, 0.979]}, nodes: [1, 2], edges: [[1, 2]]}"
)


def of(topology: Topology) -> Learning:
    return learning(plant_of(topology.network), topology.network.candidates)


def test_learning_halves_the_bound_of_the_eager_network() -> None:
    found = of(EAGER)
    assert 8.54 < found.gain < 10.4
    assert found.models == 4
    assert found.gain < 0.6 * bound(plant_of(EAGER.network), Premise.ESTIMATES).gain


def test_v1_path2_is_bounded_between_its_attack_and_any_estimates() -> None:
    (path,) = (path for path in VECTORS if path.stem == "v1_path2")
    found = of(from_vector(path)[0])
    assert 5.6855 < found.gain < 6.03


def test_a_law_that_learns_nothing_has_the_bound_of_any_estimates() -> None:
    plant = plant_of(EAGER.network)
    models = np.array(list(itertools.product([0.3, 0.979], repeat=2)))
    deaf = math.sqrt(gain_learning._bound(plant, models, 1.0, 60.0)[0])
    assert deaf <= bound(plant, Premise.ESTIMATES, Method.FULL).gain * (1 + 1e-4)
    assert deaf == pytest.approx(19.585, abs=1e-3)


def test_one_model_is_the_oracle() -> None:
    network = {"name": "known", "b": 0.1, "steps": 1, "nodes": [1, 2, 3], "edges": [[1, 2], [2, 3]]}
    known = hg.load(network | {"defaults": {"a": 0.6, "candidates": [0.6]}})
    assert of(known).gain == pytest.approx(known.network.gamma_star, rel=1e-4)


@settings(max_examples=6, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_no_disturbance_exceeds_it(seed: int) -> None:
    """Random disturbances, and those that make another model look true, against the law itself."""
    rng = np.random.default_rng(seed)
    lists = [sorted(float(a) for a in rng.uniform(0.15, 0.85, 2)) for _ in range(2)]
    nodes = {k + 1: {"a": own[int(rng.integers(2))], "candidates": own} for k, own in enumerate(lists)}
    topology = hg.load({"name": "two", "b": 0.15, "steps": 1, "nodes": nodes, "edges": [[1, 2]]})
    try:
        found = of(topology)
    except NoBoundError:
        return
    w = rng.standard_normal((40, 12, 2)) * (rng.random((40, 12, 2)) < 0.5) * 10 ** rng.uniform(-2, 0, (40, 1, 2))
    w[:20] = np.abs(w[:20])
    played = play(Scene.of(topology), w)
    energy = np.square(w).sum(axis=2).T.cumsum(axis=0)
    assert (played.cost.cumsum(axis=0) <= found.g * energy * (1 + 1e-9) + 1e-12).all()


def test_a_smaller_g_is_not_proved() -> None:
    plant = plant_of(EAGER.network)
    models = np.array(list(itertools.product([0.3, 0.979], repeat=2)))
    program = gain_learning._program(plant, models, 0.65)
    y = program.solve(1e-8, 60.0)
    assert program.proof(y, 5e-9) is not None
    y[0] *= 1 - 1e-4
    assert program.proof(y, 0.0) is None


def test_networks_with_many_models_are_said_to_have_too_many() -> None:
    with pytest.raises(NoBoundError):
        of(hg.load("paper7"))
    found = hg.bound("paper7")
    assert found.to_dict()["bounds"]["learning"] == {"not_computed": found.not_computed["learning"]}
    assert "learning" not in hg.bound(EAGER).not_computed
    assert hg.bound(EAGER).to_dict()["bounds"]["learning"]["models"] == 4
