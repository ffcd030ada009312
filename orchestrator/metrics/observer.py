"""The observer: it turns telemetry into every metric of docs/theory.md during the run: the twins, regret, costs and
gains.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hedgerow.agents.law import control
from hedgerow.orchestrator.ground.assignment import candidates_of
from hedgerow.orchestrator.metrics.certificate import Certificate, running
from hedgerow.orchestrator.metrics.checks import DynamicsCheck, Worst, norms
from hedgerow.orchestrator.metrics.fault_accounts import FaultAccounts, Observed, absent
from hedgerow.orchestrator.metrics.fault_schedule import Schedule
from hedgerow.orchestrator.metrics.gain_certificate import GainCertificate
from hedgerow.orchestrator.metrics.twins import Twins
from hedgerow.plant.world import dynamics
from hedgerow.topologies.graph import Array, Graph, Mask
from hedgerow.topologies.schema import Topology
from hedgerow.wire.message import End, Telemetry

Matrix = NDArray[np.float64]

ROWS = 512
BATCH_BYTES, ROW_BYTES = 2**26, 256
"""the maximum size of a batch, and the approximate size of a row per node [bytes]"""

QUIET = np.errstate(over="ignore", invalid="ignore")
"""Metrics of a run that diverges overflow; the verdict reports it, so numpy's warnings must not."""


@dataclass(frozen=True)
class Batch:
    """The metrics of consecutive steps: B rows, n nodes, E edges; sums run from step 0 to the row."""

    t: NDArray[np.int64]
    a: Matrix
    """the truth at each step, (B, n)"""
    x: Matrix
    """states, (B, n)"""
    u: Matrix
    """inputs, NaN where one is missing, (B, n)"""
    w: Matrix
    """disturbances, (B, n)"""
    ahat: Matrix
    """estimates, NaN where the node is absent, (B, n)"""
    index: NDArray[np.int32]
    """the index of the candidate that ahat equals, from 0, the first of equals, (B, n); -1 if there is none"""
    margin: Matrix
    """J_(2) - J_(1), infinite for a single candidate, (B, n)"""
    a_ls: Matrix
    """the least-squares a = sum x (a x + w) / sum x^2 over past samples, NaN without a sample, (B, n)"""
    beta: Matrix
    """a_LS minus the truth, (B, n)"""
    edge_open: NDArray[np.bool_]
    link_up: NDArray[np.bool_]
    """True if the link of each incidence delivered the row of the step in that step, (B, 2E)"""
    u_edge: Matrix
    """u_j - u_i of each edge (i, j), 0 where closed, (B, E)"""
    x_oracle: Matrix
    x_nominal: Matrix
    regret: Matrix
    """r_i = |x_i - x_i*|, (B, n); the paper's figure 4"""
    nominal_gap: Matrix
    """|x_i* - x_i^nom|, (B, n); figure 5"""
    regret_sum: Array
    """D = sum of r_i^2 so far, (B,)"""
    nominal_regret_sum: Array
    """the same for the nominal twin, (B,)"""
    cost: Array
    """c = |x|^2 + sum_e k_e u_e^2, (B,)"""
    cost_oracle: Array
    cost_sum: Array
    cost_oracle_sum: Array
    energy_sum: Array
    """sum of |w|^2, (B,)"""
    slack: Array
    """the slack of the oracle's certificate, NaN without a claim, (B,)"""
    right: NDArray[np.int64]
    """the number of nodes for which ahat is the truth, (B,)"""
    ceiling: Array
    """the claimed bound on the gain of the run, NaN without a claim or before it is known, (B,)"""
    ceiling_slack: Array
    """the slack of the certificate of that bound, (B,)"""

    @cached_property
    def missing(self) -> Mask:
        """Return True where the plant used no input, (B, n)."""
        return np.isnan(self.u)

    @cached_property
    def dead(self) -> Mask:
        """Return True where a missing input came without a report: the agent was absent, (B, n)."""
        return absent(self.missing, np.stack([self.ahat, self.margin], axis=1))

    @cached_property
    def wrong(self) -> Mask:
        """Return True where ahat is a candidate other than the truth, (B, n).

        An estimate that is not a candidate is a real number: it has an error, but is neither right nor wrong.
        """
        wrong: Mask = (self.index >= 0) & (self.ahat != self.a) & np.isfinite(self.ahat)
        return wrong

    @property
    def size(self) -> int:
        """Return the approximate size [bytes]."""
        return sum(getattr(self, one.name).nbytes for one in fields(self))

    @property
    def cost_regret(self) -> Array:
        """Return R = sum (c - c*), signed, (B,)."""
        return self.cost_sum - self.cost_oracle_sum

    @property
    def ratio(self) -> Array:
        """Return sum c / sum c*, the hindsight ratio, (B,)."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return self.cost_sum / self.cost_oracle_sum

    def gain(self, less: float = 0.0) -> Array:
        """Return sqrt(max(0, sum c - less) / sum |w|^2), NaN until w is not 0, (B,)."""
        return gain(self.cost_sum, self.energy_sum, less)


def gain(cost_sum: Array, energy_sum: Array, less: float = 0.0) -> Array:
    """Return sqrt(max(0, sum c - less) / sum |w|^2), NaN until w is not 0."""
    with np.errstate(invalid="ignore", divide="ignore"):
        found = np.sqrt(np.maximum(0.0, cost_sum - less) / energy_sum)
    return np.where(energy_sum > 0, found, np.nan)


def rows_at_once(n: int) -> int:
    """Return the best number of rows in one call for n nodes: the results must fit into memory."""
    return max(1, min(ROWS, BATCH_BYTES // (ROW_BYTES * n)))


class Observer:
    """The computer of all metrics that are shown, recorded and judged, from telemetry in the order of its steps."""

    def __init__(self, topology: Topology) -> None:
        network = topology.network
        self.topology = topology
        self.graph: Graph = network.graph
        self.b, self._a0 = network.b, network.a
        self._a = self._a0
        """the truth at the last recorded step"""
        self.x0, self.nominal = network.x0, network.nominal
        models = candidates_of(topology)
        self._largest = np.nanmax(models, axis=0)
        self.rho = float(self._contraction(self._a0))
        """the largest value so far"""
        self._models = models
        """the models of each node under the law of the run, (M, n), padded with NaN"""
        self._twins = Twins(self.b, self.graph, self.x0, self._a0, self.nominal)
        self._certificate = Certificate(self._a0, self.b, self.graph, self.x0)
        self.v0 = self._certificate.v0
        self.adaptive: GainCertificate | None = None
        """the certificate of the adaptive law, if its bounds are computed beside the run"""
        self.not_certified = "bounds are only computed for runs with a folder"
        """the reason why there is no certificate"""
        self._dynamics = DynamicsCheck(self.b)
        self._estimates = Worst()
        self._sums = np.zeros(5)
        self._sxx, self._sxd = np.zeros(self.graph.n), np.zeros(self.graph.n)
        self._right = 0
        self._error = np.full(self.graph.n, np.nan)
        """|ahat - a| of every node at the last step, (n,)"""
        self.real_estimates = False
        """True if an estimate is not a candidate: the law estimates real numbers"""
        self.next_step = 0
        self.end: End | None = None
        self.x_oracle_end = self.x_nominal_end = self.x0
        self.lost: list[int] = []
        """steps without telemetry"""
        self.refused = 0
        """The number of rows of steps that were recorded already."""
        self.schedule = Schedule(topology)
        self._jumps = deque(self.schedule.jumps(0))
        self._jumped = False
        self.fault_accounts = FaultAccounts(self.graph, self.schedule)
        self.checks = {
            "dynamics": self._dynamics.dynamics,
            "contraction": self._dynamics.contraction,
            "oracle_certificate": self._certificate.check,
            "estimates": self._estimates,
            **self.fault_accounts.checks,
        }

    def change(self, topology: Topology) -> None:
        """Change the faults from now on; earlier steps are not judged again."""
        self.topology = topology
        self.schedule = Schedule(topology)
        self._jumps = deque(self.schedule.jumps(self.next_step))
        self.fault_accounts.change(self.schedule)

    def in_order(self, rows: Sequence[Telemetry]) -> list[Telemetry]:
        """Return the rows that follow the recorded ones; refuse, and count, a row of an earlier step."""
        following, step = [], self.next_step
        for row in rows:
            if row.t < step:
                self.refused += 1
            else:
                following.append(row)
                step = row.t + 1
        return following

    @QUIET
    def take(self, rows: Sequence[Telemetry]) -> Batch:
        """Return the metrics of some rows, at least one, which must follow the recorded ones."""
        for row in rows:
            self._expect(row.t)
            self.next_step = row.t + 1
        t = np.array([row.t for row in rows], dtype=np.int64)
        x, u, w, report = (_rows(rows, name) for name in ("x", "u", "w", "report"))
        edge_open, link_up = (_rows(rows, name).astype(np.bool_) for name in ("edge_open", "link_up"))
        closed = None if edge_open.all() else edge_open
        a, turns = self._truth(t)
        (x_oracle, x_nominal), (u_oracle, _) = self._twins.run(w, closed, turns)
        u_edge = self.graph.edge_input(u, closed)
        regret, gap = np.abs(x - x_oracle), np.abs(x_oracle - x_nominal)
        cost, cost_oracle = (
            _energy(x) + self.graph.edge_cost(u_edge),
            _energy(x_oracle) + self.graph.edge_cost(self.graph.edge_input(u_oracle, closed)),
        )
        sums = running(self._sums, np.stack([_energy(regret), _energy(gap), cost, cost_oracle, _energy(w)], axis=1))
        self._sums = sums[-1].copy()
        a_ls, beta = self._least_squares(x, w, a)
        ahat, margin = report[:, 0], report[:, 1]
        right = (ahat == a).sum(axis=1)
        self._right = int(right[-1])
        self._error = np.abs(ahat[-1] - a[-1])

        rho = self._contraction(a) if turns else self._contraction(self._a)
        self.rho = max(self.rho, float(rho.max()))
        bound = rho * norms(x, self.b) + norms(w, self.b)
        x_next = dynamics(a, self.b, self.graph, x, u, w, closed)
        self._dynamics.take(t, x, x_next, bound)
        index = self._named(ahat)
        self._check_estimates(t, x, u, ahat, index)
        self.real_estimates |= bool((np.isfinite(ahat) & (index < 0)).any())
        is_open = np.asarray(edge_open.all(axis=1))
        ceiling, ceiling_slack = self._certified(t, x, u, x_next, is_open, turns, sums[:, [2, 4]])
        changed: NDArray[np.bool_] = ~is_open
        changed[list(turns)] = True
        x_oracle_next = np.vstack([x_oracle[1:], self._twins.x[:1]])
        slack = self._certificate.take(t, w, x_oracle_next, sums[:, 3], changed)
        missing = ~np.isfinite(u)
        silent = absent(missing, report)
        self.fault_accounts.take(Observed(t, missing, silent, edge_open, link_up, _rows(rows, "used")))
        return Batch(
            t=t, a=a, x=x, u=u, w=w, ahat=ahat, index=index, margin=margin,
            a_ls=a_ls, beta=beta, edge_open=edge_open, link_up=link_up, u_edge=u_edge,
            x_oracle=x_oracle, x_nominal=x_nominal, regret=regret, nominal_gap=gap,
            regret_sum=sums[:, 0], nominal_regret_sum=sums[:, 1], cost=cost, cost_oracle=cost_oracle,
            cost_sum=sums[:, 2], cost_oracle_sum=sums[:, 3], energy_sum=sums[:, 4], slack=slack, right=right,
            ceiling=ceiling, ceiling_slack=ceiling_slack,
        )  # fmt: skip

    @QUIET
    def finish(self, end: End) -> None:
        """Record the final state, and finish the last checks."""
        self.end = end
        self._expect(end.t)
        self.x_oracle_end, self.x_nominal_end = self._twins.x
        self._sums[0] += np.square(end.x - self.x_oracle_end).sum()
        self._sums[1] += np.square(self.x_nominal_end - self.x_oracle_end).sum()
        self._dynamics.finish(end.t, end.x)
        self.fault_accounts.finish()

    def _certified(
        self,
        t: NDArray[np.int64],
        x: Matrix,
        u: Matrix,
        x_next: Matrix,
        is_open: Mask,
        turns: dict[int, Array],
        sums: Matrix,
    ) -> tuple[Array, Array]:
        """Return the claimed bound on the gain at each step, and the slack of its certificate, (B,)."""
        certificate = self.adaptive  # another thread may set it to None
        if certificate is None:
            return np.full(len(t), np.nan), np.full(len(t), np.nan)
        return certificate.take(t, x, u, x_next, is_open, turns, sums)

    def _expect(self, t: int) -> None:
        """Expect step t next: all earlier steps that were not recorded are lost."""
        self.lost += range(self.next_step, t)
        self.next_step = t

    @property
    def gamma_star(self) -> float:
        """Return gamma* of the truth at t = 0."""
        return self.topology.network.gamma_star

    @property
    def regret_sum(self) -> float:
        """Return D at the last state, with the final one once it is known."""
        return float(self._sums[0])

    @property
    def nominal_regret_sum(self) -> float:
        """Return the same for the nominal twin."""
        return float(self._sums[1])

    def _truth(self, t: NDArray[np.int64]) -> tuple[Matrix, dict[int, Array]]:
        """Return the true a at some steps, (B, n), and the new a by row of a change, (n,)."""
        a, turns = np.broadcast_to(self._a, (len(t), self.graph.n)), {}
        while self._jumps and self._jumps[0].start <= t[-1]:
            jump = self._jumps.popleft()
            row = int(np.searchsorted(t, jump.start))
            self._a, self._jumped = self._a.copy(), True
            self._a[jump.targets[0]] = jump.a
            # Of repeated rows, `concatenate` makes columns, and a compiled loop takes rows only.
            a = np.ascontiguousarray(np.concatenate([a[:row], np.broadcast_to(self._a, (len(t) - row, self.graph.n))]))
            turns[row] = self._a
        return a, turns

    def _contraction(self, a: Matrix) -> Array:
        """Return the rho of each row of a; topologies.hinf.contraction."""
        return np.asarray(np.maximum(a, self._largest - a).max(axis=-1))

    def _least_squares(self, x: Matrix, w: Matrix, a: Matrix) -> tuple[Matrix, Matrix]:
        """Return a_LS(t) and beta(t), from the samples before t, like ahat(t): a(0) plus the excess, and that minus
        a(t).
        """
        moved = a - self._a0 if self._jumped else None
        sxx = running(self._sxx, x * x)
        sxd = running(self._sxd, x * w if moved is None else x * (moved * x + w))
        before_xx, before_xd = _before(self._sxx, sxx), _before(self._sxd, sxd)
        self._sxx, self._sxd = sxx[-1], sxd[-1]
        with np.errstate(invalid="ignore", divide="ignore"):
            excess = np.asarray(before_xd / before_xx)
        return self._a0 + excess, excess if moved is None else excess - moved

    def _named(self, ahat: Matrix) -> NDArray[np.int32]:
        """Return the index of the candidate that each ahat equals, the first of equals; -1 if there is none."""
        index = np.full(ahat.shape, -1, dtype=np.int32)
        for m in reversed(range(len(self._models))):
            index[ahat == self._models[m]] = m
        return index

    def _check_estimates(
        self, t: NDArray[np.int64], x: Matrix, u: Matrix, ahat: Matrix, index: NDArray[np.int32]
    ) -> None:
        """Check that every ahat of a present node is a candidate, and every u is equation (6) of it."""
        listed = index >= 0
        good = listed & (control(self.b, x, ahat) == u)
        if not good.all():
            good |= (listed & np.isnan(u)) | self.schedule.absent(t)
        self._estimates.see_exact(good.all(axis=1), t)

    def summary(self) -> dict[str, float | int | None]:
        """Return the metrics at the end as in verdict.json; None for undefined ones."""
        _, _, cost, cost_oracle, energy = (float(value) for value in self._sums)
        return {
            "regret": self.regret_sum,
            "regret_nominal": self.nominal_regret_sum,
            "cost": cost,
            "cost_oracle": cost_oracle,
            "cost_regret": cost - cost_oracle,
            "cost_ratio": cost / cost_oracle if cost_oracle > 0 else None,
            "disturbance_energy": energy,
            "gain": np.sqrt(cost / energy) if energy > 0 else None,
            "gain_less_x0": np.sqrt(max(0.0, cost - self.v0) / energy) if energy > 0 else None,
            "gamma_star": self.gamma_star,
            "rho": self.rho,
            "nodes_right": self._right,
            "estimate_error": error if math.isfinite(error := mean_error(self._error)) else None,
        }


def mean_error(error: Array) -> float:
    """Return the mean of |ahat - a|, (n,), over the nodes with an estimate; NaN if there is none."""
    known = np.isfinite(error)
    return float(error[known].mean()) if known.any() else math.nan


def _rows(rows: Sequence[Telemetry], name: str) -> NDArray[Any]:
    """Return one array of all rows, (B, ...); a single row is not copied."""
    return getattr(rows[0], name)[None] if len(rows) == 1 else np.array([getattr(row, name) for row in rows])


def _before(first: Array, sums: Matrix) -> Matrix:
    """Return the sums up to each row, without the row."""
    return first[None] if len(sums) == 1 else np.vstack([first, sums[:-1]])


def _energy(values: Matrix) -> Array:
    """Return the sum of squares of each row."""
    return np.asarray((values * values).sum(axis=1))
