"""The vectors: small cases with every number, each re-derived with 50-digit decimals."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest

from hedgerow.agents.law import Minimax
from hedgerow.orchestrator.ground.assignment import candidates_of, layout
from hedgerow.topologies.hinf import allowed_intervals
from tests.tools.networks import VECTORS, from_vector, observe, simulate

assert_near = partial(np.testing.assert_allclose, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("path", VECTORS, ids=lambda path: path.stem)
@pytest.mark.parametrize("processes", [1, 2, None], ids=["one shard", "two", "one a node"])
def test_a_run_gives_the_numbers_of_the_vector(path: Path, processes: int | None) -> None:
    """File text -> topology -> shards -> telemetry -> metrics, all of it against known numbers."""
    topology, expected = from_vector(path)

    ran = simulate(topology, layout(topology, processes))
    observer, batch = observe(topology, ran)

    assert_near(ran.x, expected["x"])
    assert_near(ran.u, expected["u"])
    if "edge_u" in expected:
        assert_near(batch.u_edge, expected["edge_u"])
    x_oracle = [*batch.x_oracle, observer.x_oracle_end]
    assert_near(x_oracle, expected["x_oracle"])
    assert batch.index.tolist() == expected["index"]
    if "ahat" in expected:
        assert batch.ahat.tolist() == expected["ahat"]

    assert observer.gamma_star == pytest.approx(expected["gamma_star"], rel=1e-12)
    summary = observer.summary()
    for key, name in {
        "cost": "cost_minimax",
        "cost_oracle": "cost_oracle",
        "regret": "trajectory_regret",
        "disturbance_energy": "w_energy",
    }.items():
        if name in expected:
            assert summary[key] == pytest.approx(expected[name], rel=1e-9), key
    if "rho" in expected:
        assert observer.rho == pytest.approx(expected["rho"], rel=1e-12)
    if "truth_index" in expected:
        truth = np.array(expected["truth_index"])
        assert batch.right.tolist() == (np.array(expected["index"]) == truth).sum(axis=1).tolist()
    assert all(check.excess <= 0 for check in observer.checks.values() if check.steps)


@pytest.mark.parametrize("path", VECTORS, ids=lambda path: path.stem)
def test_the_last_sample_gives_the_last_j(path: Path) -> None:
    """After the T samples of the run, a law has the vector's J(T), and its choice."""
    topology, expected = from_vector(path)
    ran = simulate(topology)
    law = Minimax(topology.network.b, candidates_of(topology))

    everything_open = np.ones(len(topology.edges), dtype=np.bool_)
    for row, x_next in zip(ran.rows, ran.x[1:], strict=True):
        law.learn(row.x, topology.graph.flow(row.u, everything_open), x_next)

    np.testing.assert_allclose(law.J.T, expected["J_final"], rtol=1e-9)
    if "index_final" in expected:
        assert law.ahat.tolist() == [own[i] for own, i in zip(law.candidates.T, expected["index_final"], strict=True)]


@pytest.mark.parametrize("path", VECTORS, ids=lambda path: path.stem)
def test_the_interval_of_condition_3_is_that_of_the_vector(path: Path) -> None:
    topology, expected = from_vector(path)
    if "condition_interval" in expected:
        interval = allowed_intervals(topology.network.b, topology.graph.weighted_degree)
        assert_near(interval, np.reshape(expected["condition_interval"], (2, -1)))


def test_there_are_vectors() -> None:
    """An empty folder would make every test above pass by running none."""
    assert {path.stem for path in VECTORS} >= {"v1_path2", "v2_tree7", "v5_tie", "w1_path3"}
