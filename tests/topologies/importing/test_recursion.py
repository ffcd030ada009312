"""An imported network with weights and storages obeys (1), (6) and (7), written here with matrices of SciPy."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np
import pytest
import scipy.io
import scipy.linalg
import scipy.sparse as sp

import hedgerow as hg
from hedgerow.topologies.importing.options import Options
from hedgerow.topologies.importing.written import import_file
from tests.tools.networks import observe, simulate

Array = np.ndarray[Any, np.dtype[np.float64]]
EXAMPLES = int(os.environ.get("HEDGEROW_RECURSIONS", "3"))
STEPS = 40


def minimax(A: Array, B: Array, b: Array, lists: Array, x0: Array, w: Array) -> dict[str, Array]:
    """Return states, inputs, estimates and the last J of the law of the paper, with x+ = A x - B B' z + w."""
    J = np.zeros_like(lists)
    x, states, inputs, estimates = x0, [x0], [], []
    for t in range(w.shape[1]):
        ahat = lists[np.arange(len(x)), J.argmin(axis=1)]
        u = b * x / (ahat - 1)
        flow = B @ (B.T @ (u / b)) / b  # sum of k_e (u_i - u_j)
        after = A @ x + b * flow + w[:, t]
        J = J + (lists * x[:, None] + (b * flow - after)[:, None]) ** 2
        states.append(after)
        inputs.append(u)
        estimates.append(ahat)
        x = after
    return {"x": np.array(states), "u": np.array(inputs), "ahat": np.array(estimates), "J": J}


@pytest.mark.parametrize("seed", range(EXAMPLES))
def test_a_run_of_an_imported_network_gives_the_numbers_of_the_recursion(seed: int, here: Path) -> None:
    rng = np.random.default_rng(seed)
    graph = nx.connected_watts_strogatz_graph(int(rng.integers(4, 30)), 3, 0.5, seed=seed)
    n, edges = len(graph), np.array(graph.edges)
    k = 10 ** rng.uniform(-2, 1, len(edges))
    matrix = sp.coo_array((k, (edges[:, 0], edges[:, 1])), shape=(n, n))
    scipy.io.mmwrite("net.mtx", matrix + matrix.T, precision=17)
    import_file(Path("net.mtx"), Options(steps=STEPS, seed=seed)).save(Path("net.yaml"))
    storage = rng.uniform(0.5, 8, n)
    scale = hg.Network.of("net.yaml")["b"] * np.sqrt(storage.min())
    gains = {node: {"b": float(scale / np.sqrt(c))} for node, c in zip(range(1, n + 1), storage, strict=True)}
    net = hg.Network.of("net.yaml").replace(nodes=gains)
    topology = net.topology
    ran = simulate(topology)
    observer, batch = observe(topology, ran)

    b = scale / np.sqrt(storage)
    incidence = np.zeros((n, len(edges)))
    incidence[edges[:, 0], np.arange(len(edges))] = 1
    incidence[edges[:, 1], np.arange(len(edges))] = -1
    B = b[:, None] * incidence * np.sqrt(k)
    own = topology.network
    lists = np.where(np.isnan(own.candidates), np.inf, own.candidates).T
    assert np.isfinite(lists).all()
    sines = own.disturbance[0].values
    amplitude, omega, phase = (sines[key][:, None] for key in ("amplitude", "omega", "phase"))
    w = amplitude * np.sin(omega * np.arange(STEPS) + phase)
    ours = minimax(np.diag(own.a), B, b, lists, own.x0, w)

    np.testing.assert_allclose(ran.x, ours["x"], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(batch.ahat, ours["ahat"])
    Q = (np.eye(n) - np.diag(own.a)) @ (np.eye(n) - np.diag(own.a)) + B @ B.T
    star = 1 / np.sqrt(scipy.linalg.eigh(Q, eigvals_only=True, subset_by_index=[0, 0])[0])
    assert observer.gamma_star == pytest.approx(star, rel=1e-9)
    across = B.T @ (ours["u"] / b).T
    cost = (ours["x"][:-1] ** 2).sum() + (across**2).sum()
    assert observer.summary()["cost"] == pytest.approx(cost, rel=1e-9)
