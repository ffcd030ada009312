"""Many runs of one network in parallel: S independent copies with different seeds.

A sweep needs the metrics of thousands of small networks. One by one, nearly all of the time is overhead of numpy calls
on a few numbers. Here the copies are rows of the same arrays, (S, n). Every number results from the same operations in
the same order as in a single run, so states, inputs and metrics are equal bit for bit. Sums over nodes run along a row,
and sums over steps are added step by step.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hedgerow.agents.law import control
from hedgerow.agents.loading import new_law
from hedgerow.agents.local import asks
from hedgerow.agents.view import View
from hedgerow.orchestrator.ground.assignment import law_of
from hedgerow.orchestrator.metrics.checks import ROUNDING, TINY
from hedgerow.orchestrator.metrics.observer import mean_error
from hedgerow.plant.disturbance import Disturbance
from hedgerow.plant.world import dynamics
from hedgerow.topologies.archive import id_array
from hedgerow.topologies.graph import Array, Mask
from hedgerow.topologies.law_choice import LawChoice
from hedgerow.topologies.network import Network
from hedgerow.topologies.resolve import copies
from hedgerow.topologies.schema import LAWS, Topology

NODES = 20_000
"""the maximum number of nodes of all copies: the numbers of a step then fit the cache"""
LARGEST = 500
"""the maximum number of nodes of a network in a batch; the time of a larger one is arithmetic anyway"""


def why_not(topology: Topology) -> str:
    """Return why a topology cannot be run in batches, in words; empty if it can."""
    computed = LawChoice.parse(topology.law).name == "robust"
    reasons = (
        (bool(topology.faults), "it has faults"),
        (len(topology.ids) > LARGEST, f"it has more than {LARGEST} nodes"),
        (topology.disturbance is not None, "its worst-case disturbance depends on the numbers that are drawn"),
        (topology.generator is not None, "its graph is made by a rule"),
        (_unequal(topology), "its gains or weights differ"),
        (_sees_state(topology), "its disturbance sees the state"),
        (computed, "its law has a parameter that is computed for every seed"),
        (not computed and _asks(topology), "its law asks for local knowledge"),
    )
    return next((why for holds, why in reasons if holds), "")


def _unequal(topology: Topology) -> bool:
    given = topology.given
    own = topology.defaults.b is not None or any(node.b is not None for node in topology.nodes.values())
    return own or topology.graph.weights is not None or (given is not None and given.b is not None)


def _sees_state(topology: Topology) -> bool:
    written = [topology.defaults.disturbance, *(node.disturbance for node in topology.nodes.values())]
    parts = [part for one in written if one is not None for part in (one if isinstance(one, tuple) else (one,))]
    given = topology.given.disturbance if topology.given is not None else None
    return any(part.kind == "confuse" for part in (*parts, *(given or ())))


def _asks(topology: Topology) -> bool:
    law = new_law(_view(topology, np.full((1, 1), 0.5), id_array([0])))
    return asks(type(law).__init__, "local") or asks(law.act, "now") or asks(law.learn, "sample")


def seeds_at_once(topology: Topology) -> int:
    """Return the number of copies that one batch should have."""
    return max(1, NODES // len(topology.ids))


@dataclasses.dataclass(frozen=True)
class Runs:
    """The metrics of S runs, (S,) each, as verdict.json names them."""

    metrics: dict[str, Array]
    good: Mask
    """True for runs that pass every check"""


def run(topology: Topology, seeds: Sequence[int], folder: Path = Path()) -> Runs:
    """Run a topology under every seed to its last step. `why_not` must be empty."""
    network = copies(topology, seeds, folder)
    return _Batch(topology, network, seeds).run()


def _view(topology: Topology, candidates: Array, ids: Any) -> View:
    nothing = np.empty(0, dtype=np.int64)
    return View(
        shard=0,
        b=topology.b,
        law=law_of(topology),
        ids=ids,
        candidates=candidates,
        row=nothing,
        column=nothing,
        peers=[],
        heard=id_array([]),
        history=0,
    )


class _Batch:
    """The motion of S copies of n nodes, with both twins, all sums and all checks."""

    def __init__(self, topology: Topology, network: Network, seeds: Sequence[int]) -> None:
        self._topology, self._graph, self._b = topology, network.graph, topology.b
        S, n = len(seeds), len(topology.ids)
        self._shape = S, n
        of_copies = [array.reshape(S, n) for array in (network.a, network.x0, network.nominal)]
        self._a, self._x0, self._nominal = of_copies
        models = _models(topology, network)
        ids = id_array(tuple(topology.ids) * S)
        self._law = new_law(_view(topology, np.ascontiguousarray(models[~np.isnan(models).all(axis=1)]), ids))
        self._models = models
        largest = np.nanmax(models, axis=0).reshape(S, n)
        self._rho = np.maximum(self._a, largest - self._a).max(axis=-1)
        self._disturbance = Disturbance(network.disturbance, ids, np.repeat(np.array(seeds, dtype=np.uint64), n))
        Q = _q(self._a, self._b, self._graph)
        self._gamma_star = 1 / np.sqrt(np.linalg.eigh(Q)[0][:, 0])
        self._inverse = np.linalg.inv(Q)
        self._good = np.ones(S, dtype=bool)

    def run(self) -> Runs:
        """Make every step, and return the metrics."""
        shape, graph, b, a, law = self._shape, self._graph, self._b, self._a, self._law
        x = x_oracle = x_nominal = self._x0
        v0 = _energy_over(self._x0, 1 - a)
        sums = np.zeros((5, shape[0]))
        supply = np.zeros(shape[0])
        ahat = x
        for t in range(self._topology.steps):
            u = np.array(law.act(x.ravel()), dtype=float).reshape(shape)
            ahat = np.array(law.report()[0], dtype=float).reshape(shape)
            w = self._disturbance.at(t).reshape(shape)
            u_oracle, u_nominal = control(b, x_oracle, a), control(b, x_nominal, self._nominal)
            cost, cost_oracle = (
                _energy(one) + graph.edge_cost(graph.edge_input(inputs))
                for one, inputs in ((x, u), (x_oracle, u_oracle))
            )
            regret, gap = np.abs(x - x_oracle), np.abs(x_oracle - x_nominal)
            sums += np.stack([_energy(regret), _energy(gap), cost, cost_oracle, _energy(w)])
            self._check_inputs(x, u, ahat)
            flow = graph.flow(u)
            x_next = a * x + b * flow + w
            x_oracle = dynamics(a, b, graph, x_oracle, u_oracle, w)
            x_nominal = dynamics(a, b, graph, x_nominal, u_nominal, w)
            supply += (w * (self._inverse @ w[:, :, None])[:, :, 0]).sum(axis=1)
            self._check_bounds(x, w, x_next, supply + v0, _energy_over(x_oracle, 1 - a) + sums[3])
            if t + 1 < self._topology.steps:  # no step comes after the last sample
                law.learn(x.ravel(), flow.ravel(), x_next.ravel())
            x = x_next
        sums[0] += np.square(x - x_oracle).sum(axis=1)
        sums[1] += np.square(x_nominal - x_oracle).sum(axis=1)
        return Runs(self._metrics(sums, v0, ahat), self._good)

    def _check_inputs(self, x: Array, u: Array, ahat: Array) -> None:
        """Check that every input is finite and, for the paper's laws, equation (6) of a candidate."""
        good = np.isfinite(u)
        if self._topology.law in LAWS:
            listed = (ahat.ravel() == self._models).any(axis=0).reshape(self._shape)
            good &= listed & (control(self._b, x, ahat) == u)
        self._good &= good.all(axis=1)

    def _check_bounds(self, x: Array, w: Array, x_next: Array, owed: Array, spent: Array) -> None:
        """Check the contraction, for the paper's laws, and the oracle's certificate."""
        if self._topology.law in LAWS:
            bound = self._rho * np.abs(x).sum(axis=-1) + np.abs(w).sum(axis=-1)
            self._good &= np.abs(x_next).sum(axis=-1) / (bound + TINY) - 1 - ROUNDING <= 0
        self._good &= -(owed - spent) / (owed + TINY) - ROUNDING <= 0

    def _metrics(self, sums: Array, v0: Array, ahat: Array) -> dict[str, Array]:
        regret, regret_nominal, cost, cost_oracle, energy = sums
        with np.errstate(invalid="ignore", divide="ignore"):
            return {
                "regret": regret,
                "regret_nominal": regret_nominal,
                "cost": cost,
                "cost_oracle": cost_oracle,
                "cost_regret": cost - cost_oracle,
                "cost_ratio": np.where(cost_oracle > 0, cost / cost_oracle, np.nan),
                "disturbance_energy": energy,
                "gain": np.where(energy > 0, np.sqrt(cost / energy), np.nan),
                "gain_less_x0": np.where(energy > 0, np.sqrt(np.maximum(0.0, cost - v0) / energy), np.nan),
                "gamma_star": self._gamma_star,
                "rho": self._rho,
                "nodes_right": (ahat == self._a).sum(axis=1),
                "estimate_error": np.array([mean_error(row) for row in np.abs(ahat - self._a)]),
            }


def _models(topology: Topology, network: Network) -> Array:
    """Return the models of each node, (M, S n), padded with NaN."""
    if topology.law == "hinf":
        return network.a[None]
    if topology.law == "nominal":
        return network.nominal[None]
    return network.candidates


def _q(a: Array, b: float, graph: Any) -> Array:
    """Return Q = (I - A)^2 + b^2 L of every copy, (S, n, n)."""
    S, n = a.shape
    Q = np.zeros((S, n, n))
    Q[:, np.arange(n), np.arange(n)] = (1 - a) ** 2 + b * b * graph.weighted_degree
    Q[:, graph.node, graph.neighbour] += -b * b
    return Q


def _energy(values: Array) -> Array:
    return np.asarray((values * values).sum(axis=1))


def _energy_over(values: Array, scale: Array) -> Array:
    return np.asarray((values * values / scale).sum(axis=1))
