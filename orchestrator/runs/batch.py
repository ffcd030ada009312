"""Many runs of one network in one batch: sweeps and comparisons run S seeds as one network of S disjoint parts.

One by one, nearly all of the time of a small network is overhead of numpy calls on a few numbers. Here one plant and
one shard make the steps of all runs. This includes faults, unequal gains, generated graphs and all laws. States, inputs
and estimates equal those of single runs, bit for bit. So do the metrics: sums over nodes run along a row, and sums over
steps are added step by step. If the graphs of the runs have different numbers of edges, the edges of a step are added
one after another. Then the cost may differ in its last bit.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hedgerow.agents.law import control
from hedgerow.agents.loading import law_class
from hedgerow.agents.local import asks
from hedgerow.orchestrator.metrics.checks import ROUNDING, TINY
from hedgerow.orchestrator.metrics.estimates import switches
from hedgerow.orchestrator.metrics.fault_accounts import FaultAccounts, Observed, absent
from hedgerow.orchestrator.metrics.fault_schedule import Schedule
from hedgerow.orchestrator.metrics.observer import mean_error
from hedgerow.orchestrator.runs import reference
from hedgerow.orchestrator.runs.union import Union, of_seeds
from hedgerow.plant.world import dynamics
from hedgerow.topologies.graph import Array, Graph, Mask
from hedgerow.topologies.law_choice import LawChoice, is_listed
from hedgerow.topologies.schema import Topology
from hedgerow.wire.message import End, Telemetry

NODES = 20_000
"""the maximum number of nodes of all runs: the numbers of a step then fit the cache"""
LOSSY_NODES = 1_500
"""the maximum number of nodes of all runs with missing messages: every late one makes all nodes of the batch learn
again
"""
LARGEST = 400
"""the maximum number of nodes of a network in a batch; the time of a larger one is arithmetic anyway"""
STEPS, LOSSY_STEPS = 2 * 10**7, 10**6
"""the maximum number of steps times nodes of a batch, which takes a few seconds: a stopped sweep loses no more"""
TOLD_AT_ONCE = 32
"""the number of steps per judgement of the faults"""


def why_not(topology: Topology) -> str:
    """Return why a topology cannot be run in batches, in words; empty if it can."""
    return f"it has more than {LARGEST} nodes" if len(topology.ids) > LARGEST else ""


def needs_proof(topology: Topology) -> bool:
    """Return True if batches may differ from single runs: the user's law may look up nodes by their ids.

    The ids of a batch repeat. The caller compares some runs with single ones.
    """
    name = LawChoice.parse(topology.law).name
    return ":" in name and asks(law_class(name).__init__, "local")


def seeds_at_once(topology: Topology) -> int:
    """Return the best number of runs in one batch."""
    lossy = any(fault.LOSSY for fault in topology.faults)
    nodes, steps = (LOSSY_NODES, LOSSY_STEPS) if lossy else (NODES, STEPS)
    return max(1, min(nodes, steps // topology.steps) // len(topology.ids))


@dataclasses.dataclass(frozen=True)
class Runs:
    """The numbers of S runs."""

    metrics: dict[str, Array]
    """the metrics of verdict.json, (S,) each"""
    good: Mask
    """True for runs that pass every check, (S,)"""
    ahat: Array
    """the estimates of the last step, (S, n)"""
    a: Array
    """the truth of the last step, (S, n)"""
    candidates: Array
    """the candidates, (M, S, n), padded with NaN"""
    switches: Array
    """changes of the estimate per node, (S,)"""


def run(topology: Topology, seeds: Sequence[int], folder: Path = Path()) -> Runs:
    """Run a topology under every seed to its last step. `why_not` must be empty.

    Raises LawError if the law fails in one of the runs, and SizesError if they differ in size.
    """
    return _Batch(of_seeds(topology, seeds, folder)).run()


class _Batch:
    """The motion of a union, with both twins, all sums and all checks."""

    def __init__(self, union: Union) -> None:
        self._union, self._graph, self._b = union, union.graph, union.b
        self._shape = S, n = union.S, union.n
        self._edges = np.bincount(union.edge_part, minlength=S)
        self._a = union.a.copy()
        self._jumps = sorted((one for one in union.effects if one.changes_truth), key=lambda one: one.start)
        self._x_oracle = self._x_nominal = union.x0
        self._largest = np.nanmax(union.models, axis=0)
        self._rho_now = self._rho = self._contraction()
        self._v0 = self._over(union.x0)
        self._gamma_star, self._inverse = self._spectra()
        self._supply, self._sums = np.zeros(S), np.zeros((5, S))
        self._good, self._constant = ~np.array(union.idle, dtype=bool), np.ones(S, dtype=bool)
        self._bound: Array | None = None
        self._ahat, self._changed = np.full(S * n, np.nan), np.zeros(S)
        self._listed = is_listed(union.topology.law)
        self._fault_accounts: FaultAccounts | None = None
        self._rows: list[Telemetry] = []
        if any(one.lossy for one in union.effects):
            self._schedule = Schedule.of(union.graph, union.ids, union.words, len(union.topology.faults), union.effects)
            self._fault_accounts = FaultAccounts(union.graph, self._schedule)

    def run(self) -> Runs:
        """Make every step, and return the numbers."""
        union = self._union
        for row in reference.run(union.truth(), [union.view()], union.law()):
            if isinstance(row, End):
                self._finish(row)
            else:
                self._take(row)
        S, n = self._shape
        return Runs(
            self._metrics(),
            self._good,
            self._ahat.reshape(S, n),
            self._a.reshape(S, n),
            union.candidates.reshape(-1, S, n),
            self._changed / n,
        )

    def _take(self, row: Telemetry) -> None:
        t, x, u, w = row.t, row.x, row.u, row.w
        b, graph = self._b, self._graph
        closed = None if row.edge_open.all() else row.edge_open.view(np.bool_)
        self._jump(t)
        a = self._a
        before, self._ahat = self._ahat, row.report[0]
        if t:
            self._changed += switches(before.reshape(self._shape), self._ahat.reshape(self._shape))
        u_oracle, u_nominal = control(b, self._x_oracle, a), control(b, self._x_nominal, self._union.nominal)
        regret, gap = x - self._x_oracle, self._x_oracle - self._x_nominal
        cost, cost_oracle = (
            self._energy(one) + self._edge_cost(graph.edge_input(inputs, closed))
            for one, inputs in ((x, u), (self._x_oracle, u_oracle))
        )
        self._sums += [self._energy(regret), self._energy(gap), cost, cost_oracle, self._energy(w)]
        self._check(x)
        self._check_inputs(row)
        self._bound = self._rho_now * self._norm(x) + self._norm(w)
        self._x_oracle = dynamics(a, b, graph, self._x_oracle, u_oracle, w, closed)
        self._x_nominal = dynamics(a, b, graph, self._x_nominal, u_nominal, w, closed)
        self._check_certificate(w, row)
        if self._fault_accounts is not None:
            self._rows.append(row)
            if len(self._rows) == TOLD_AT_ONCE:
                self._account()

    def _finish(self, end: End) -> None:
        self._check(end.x)
        self._sums[0] += np.square((end.x - self._x_oracle).reshape(self._shape)).sum(axis=1)
        self._sums[1] += np.square((self._x_nominal - self._x_oracle).reshape(self._shape)).sum(axis=1)
        if self._fault_accounts is not None:
            self._account()
            self._fault_accounts.finish()
            # All runs share one account: if it fails, each run is judged alone.
            self._good &= all(worst.excess <= 0 for worst in self._fault_accounts.checks.values())

    def _account(self) -> None:
        """Judge the faults of the stored rows."""
        if not self._rows or self._fault_accounts is None:
            return
        names = ("u", "edge_open", "link_up", "used")
        u, edge_open, link_up, used = (np.array([getattr(row, name) for row in self._rows]) for name in names)
        missing = ~np.isfinite(u)
        silent = absent(missing, np.array([row.report for row in self._rows]))
        t = np.array([row.t for row in self._rows])
        self._fault_accounts.take(Observed(t, missing, silent, edge_open.astype(bool), link_up.astype(bool), used))
        self._rows.clear()

    def _jump(self, t: int) -> None:
        """Apply the jumps of step t."""
        if not self._jumps or self._jumps[0].start > t:
            return
        self._a = self._a.copy()
        while self._jumps and self._jumps[0].start <= t:
            jump = self._jumps.pop(0)
            self._a[jump.targets[0]] = jump.a
            self._constant[jump.targets[0] // self._shape[1]] = False
        self._rho_now = self._contraction()
        self._rho = np.maximum(self._rho, self._rho_now)

    # The checks.

    def _check(self, x: Array) -> None:
        """Check the contraction, for laws that act by (6) on a candidate."""
        if self._bound is not None and self._listed:
            self._good &= self._norm(x) / (self._bound + TINY) - 1 - ROUNDING <= 0

    def _check_inputs(self, row: Telemetry) -> None:
        """Check that every input is finite, or missing by a fault, and is (6) of a candidate where it should be."""
        u, ahat, x = row.u, row.report[0], row.x
        good = there = np.isfinite(u)
        if self._fault_accounts is not None:
            good = np.ones(len(u), dtype=bool)  # the accounts judge missing inputs
        if self._listed:
            listed = np.zeros(len(u), dtype=bool)
            for models in self._union.models:
                listed |= ahat == models
            good &= (listed & (control(self._b, x, ahat) == u)) | (listed & ~there)
            if self._fault_accounts is not None and not there.all():
                good |= self._schedule.absent(np.array([row.t]))[0]
        self._good &= good.reshape(self._shape).all(axis=1)

    def _check_certificate(self, w: Array, row: Telemetry) -> None:
        """Check the oracle's certificate in runs with open edges and the truth of t = 0 so far."""
        if not row.edge_open.all():
            closed = np.bincount(self._union.edge_part, row.edge_open == 0, self._shape[0])
            self._constant &= closed == 0
        ws = w.reshape(self._shape)
        self._supply += (ws * (self._inverse @ ws[:, :, None])[:, :, 0]).sum(axis=1)
        owed, spent = self._supply + self._v0, self._over(self._x_oracle) + self._sums[3]
        self._good &= (-(owed - spent) / (owed + TINY) - ROUNDING <= 0) | ~self._constant

    # The numbers.

    def _contraction(self) -> Array:
        S, n = self._shape
        return np.asarray(np.maximum(self._a, self._largest - self._a).reshape(S, n).max(axis=1))

    def _energy(self, values: Array) -> Array:
        return np.asarray((values * values).reshape(self._shape).sum(axis=1))

    def _over(self, x: Array) -> Array:
        """Return V(x) = sum x_i^2 / (1 - a_i) of every run, by the truth of t = 0."""
        return np.asarray((x * x / (1 - self._union.a)).reshape(self._shape).sum(axis=1))

    def _norm(self, x: Array) -> Array:
        """Return sum |x_i| min(b) / b_i of every run."""
        if isinstance(self._b, float):
            return np.asarray(np.abs(x).reshape(self._shape).sum(axis=1))
        b = self._b.reshape(self._shape)
        return np.asarray((np.abs(x).reshape(self._shape) * (b.min(axis=1, keepdims=True) / b)).sum(axis=1))

    def _edge_cost(self, u_edge: Array) -> Array:
        S = self._shape[0]
        squares = u_edge * u_edge
        if self._graph.weights is not None:
            squares *= self._graph.weights
        if (self._edges == self._edges[0]).all():
            return np.asarray(squares.reshape(S, -1).sum(axis=1))
        return np.bincount(self._union.edge_part, squares, S).astype(float, copy=False)

    def _spectra(self) -> tuple[Array, Array]:
        """Return gamma* and the inverse of Q of every run."""
        Q = _q(self._union.a, self._b, self._graph, *self._shape)
        least: Array = np.linalg.eigh(Q)[0][:, 0]
        inverse: Array = np.asarray(np.linalg.inv(Q), dtype=np.float64)
        return 1 / np.sqrt(least), inverse

    def _metrics(self) -> dict[str, Array]:
        regret, regret_nominal, cost, cost_oracle, energy = self._sums
        ahat, a = self._ahat.reshape(self._shape), self._a.reshape(self._shape)
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
                "gain_less_x0": np.where(energy > 0, np.sqrt(np.maximum(0.0, cost - self._v0) / energy), np.nan),
                "gamma_star": self._gamma_star,
                "rho": self._rho,
                "nodes_right": (ahat == a).sum(axis=1),
                "estimate_error": np.array([mean_error(row) for row in np.abs(ahat - a)]),
            }


def _q(a: Array, b: float | Array, graph: Graph, S: int, n: int) -> Array:
    """Return Q = (I - A)^2 + diag(b) L diag(b) of every part, (S, n, n)."""
    Q = np.zeros((S, n, n))
    Q[:, np.arange(n), np.arange(n)] = ((1 - a) ** 2 + b * b * graph.weighted_degree).reshape(S, n)
    beside = -b[graph.node] * b[graph.neighbour] if isinstance(b, np.ndarray) else -b * b
    if graph.weight is not None:
        beside = beside * graph.weight
    Q[graph.node // n, graph.node % n, graph.neighbour % n] += beside
    return Q
