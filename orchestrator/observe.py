"""From telemetry to every metric of docs/theory.md: the twins, regret, costs and gains, as the run goes on.

A twin is the same network with the same w, x(0) and open edges, under another law: the oracle acts on the true
a (8), the nominal one on the nominal value. Both hold their model fixed, so neither needs an estimator.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agents.law import control
from orchestrator.assign import candidates_of
from plant.world import dynamics
from topologies.graph import Array, Graph
from topologies.hinf import contraction, gamma_star, q_solver
from topologies.resolve import truth
from topologies.schema import Topology
from wire.codec import End, Telemetry

Matrix = NDArray[np.float64]


@dataclass(frozen=True)
class Batch:
    """What some consecutive steps brought: B rows, n nodes, E edges; sums run from step 0 to the row's own."""

    t: NDArray[np.int64]
    x: Matrix
    """states, (B, n)"""
    u: Matrix
    """inputs, (B, n)"""
    w: Matrix
    """disturbances, (B, n)"""
    ahat: Matrix
    index: NDArray[np.int32]
    """which candidate ahat is, from 0 in list order, (B, n); -1 under a law that names none"""
    margin: Matrix
    """J_(2) - J_(1), infinite without a rival, (B, n)"""
    a_ls: Matrix
    """the least-squares a = truth + beta, NaN before there is a sample, (B, n)"""
    beta: Matrix
    """sum x w / sum x^2 over past samples: a_LS = a + beta, (B, n)"""
    identifiable: NDArray[np.bool_]
    """a + beta is nearest the truth among the candidates, (B, n)"""
    edge_open: NDArray[np.bool_]
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
    """the same of the nominal twin, (B,)"""
    cost: Array
    """c = |x|^2 + |u_e|^2, (B,)"""
    cost_oracle: Array
    cost_sum: Array
    cost_oracle_sum: Array
    energy_sum: Array
    """sum of |w|^2, (B,)"""
    slack: Array
    """how far the oracle's certificate is from being violated, (B,)"""
    right: NDArray[np.int64]
    """nodes whose ahat is the truth, (B,)"""

    @property
    def cost_regret(self) -> Array:
        """R = sum (c - c*), signed, (B,)."""
        return self.cost_sum - self.cost_oracle_sum

    @property
    def ratio(self) -> Array:
        """Sum c / sum c*, the hindsight ratio, (B,)."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return self.cost_sum / self.cost_oracle_sum

    def gain(self, less: float = 0.0) -> Array:
        """sqrt(max(0, sum c - less) / sum |w|^2), NaN until w is not 0, (B,)."""
        with np.errstate(invalid="ignore", divide="ignore"):
            gain = np.sqrt(np.maximum(0.0, self.cost_sum - less) / self.energy_sum)
        return np.where(self.energy_sum > 0, gain, np.nan)


class _Twins:
    """The network under laws whose models never change, side by side: row 0 the oracle's, row 1 the nominal one's."""

    def __init__(self, observer: Observer) -> None:
        self._network, self._models = observer, np.stack([observer.a, observer.nominal])
        self.x = np.stack([observer.x0, observer.x0])

    def step(self, w: Array, edge_open: NDArray[np.bool_] | None) -> tuple[Matrix, Matrix]:
        """x(t) and u(t) of both, (2, n); moves on to t + 1."""
        network, x = self._network, self.x
        u = control(network.b, x, self._models)
        self.x = dynamics(network.a, network.b, network.graph, x, u, w, edge_open)
        return x, u


@dataclass
class Worst:
    """One check over all steps: the largest excess seen, and the step where; a positive excess is a violation."""

    excess: float = -np.inf
    step: int = -1
    steps: int = 0

    def see(self, excess: Array, steps: Sequence[int]) -> None:
        """Take in the excess at each of `steps`; NaN counts as a violation."""
        if len(excess):
            excess = np.where(np.isnan(excess), np.inf, excess)
            k = int(np.argmax(excess))
            if excess[k] > self.excess:
                self.excess, self.step = float(excess[k]), steps[k]
            self.steps += len(excess)


def _running(before: Array | np.float64, increments: Matrix) -> Matrix:
    """Sums up to each row, added one after the other, so that they do not depend on how the rows were batched."""
    return np.asarray(np.cumsum(np.concatenate([np.asarray(before)[None], increments]), axis=0)[1:])


TINY = 1e-300
"""keeps 0 / 0 from being asked"""
ROUNDING = 1e-9
"""Relative slack of inequalities that are exact only in exact arithmetic."""


class Observer:
    """Takes telemetry in the order of its steps and computes all that is shown, recorded and judged."""

    def __init__(self, topology: Topology) -> None:
        own = list(topology.nodes.values())
        self.topology = topology
        self.graph: Graph = topology.graph
        self.b, self.a = topology.b, truth(topology)
        self.x0 = np.array([node.x0 for node in own], dtype=float)
        self.nominal = np.array([node.nominal for node in own], dtype=float)
        self.gamma_star = gamma_star(self.a, self.b, self.graph)
        self.v0 = self._v(self.x0[None, :])[0]
        """V(x(0)) = sum x_i(0)^2 / (1 - a_i): what the cost owes to x(0) at most."""
        models = [np.array(listed) for listed in candidates_of(topology)]
        self.rho = contraction(self.a, models)
        self._rivals = [np.array(node.candidates, dtype=float) for node in own]
        longest = max(map(len, models))
        self._padded = np.array([np.pad(listed, (0, longest - len(listed)), mode="edge") for listed in models])
        self._solve_q = q_solver(self.a, self.b, self.graph)
        self._twins = _Twins(self)
        n = self.graph.n
        self._sums = np.zeros(5)
        self._supply = np.float64(0)
        self._sxx, self._sxw = np.zeros(n), np.zeros(n)
        self._last: Telemetry | None = None
        self.next_step = 0
        self.end: End | None = None
        self.x_oracle_end = self.x_nominal_end = self.x0
        self.lost: list[int] = []
        """steps whose telemetry never came"""
        self.checks = {
            "dynamics": Worst(),
            "contraction": Worst(),
            "oracle_certificate": Worst(),
            "estimates": Worst(),
        }

    def _v(self, x: Matrix) -> Array:
        return np.asarray((x * x / (1 - self.a)).sum(axis=1))

    def take(self, rows: Sequence[Telemetry]) -> Batch:
        """The metrics of some rows, at least one, which must follow those taken before."""
        for row in rows:
            while self.next_step < row.t:
                self.lost.append(self.next_step)
                self.next_step += 1
            self.next_step = row.t + 1
        t = np.array([row.t for row in rows], dtype=np.int64)
        x, u, w = (np.array([getattr(row, name) for row in rows]) for name in ("x", "u", "w"))
        report = np.array([row.report for row in rows])
        edge_open = np.array([row.edge_open for row in rows], dtype=np.bool_).reshape(len(rows), -1)
        closed = None if edge_open.all() else edge_open
        twins = [self._twins.step(w_t, None if closed is None else on) for w_t, on in zip(w, edge_open, strict=True)]
        x_oracle, x_nominal = (np.array([pair[0][k] for pair in twins]) for k in (0, 1))
        u_oracle = np.array([pair[1][0] for pair in twins])
        u_edge = self.graph.edge_input(u, closed)
        flow_cost = self.graph.edge_input(u_oracle, closed)
        cost = (x * x).sum(axis=1) + (u_edge * u_edge).sum(axis=1)
        cost_oracle = (x_oracle * x_oracle).sum(axis=1) + np.square(flow_cost).sum(axis=1)
        regret, gap = np.abs(x - x_oracle), np.abs(x_oracle - x_nominal)
        energy = (w * w).sum(axis=1)
        nominal_regret = np.square(x_nominal - x_oracle).sum(axis=1)
        sums = _running(
            self._sums,
            np.stack([(regret**2).sum(axis=1), nominal_regret, cost, cost_oracle, energy], axis=1),
        )
        self._sums = sums[-1].copy()
        # Row by row: the bits of a product with many columns depend on how many there are.
        q_inverse_w = np.array([self._solve_q(w_t) for w_t in w])
        supply = _running(self._supply, (w * q_inverse_w).sum(axis=1))
        self._supply = supply[-1]
        beta = self._beta(x, w)
        slack = supply + self.v0 - self._v(np.vstack([x_oracle[1:], self._twins.x[:1]])) - sums[:, 3]
        self._check(rows, x, u, report[:, :, 0], -slack / (supply + self.v0 + TINY) - ROUNDING)
        return Batch(
            t=t, x=x, u=u, w=w,
            ahat=report[:, :, 0], index=np.nan_to_num(report[:, :, 1], nan=-1.0).astype(np.int32),
            margin=report[:, :, 2], a_ls=self.a + beta,
            beta=beta, identifiable=self._identifiable(beta),
            edge_open=edge_open, u_edge=u_edge,
            x_oracle=x_oracle, x_nominal=x_nominal, regret=regret, nominal_gap=gap,
            regret_sum=sums[:, 0], nominal_regret_sum=sums[:, 1], cost=cost, cost_oracle=cost_oracle,
            cost_sum=sums[:, 2], cost_oracle_sum=sums[:, 3], energy_sum=sums[:, 4], slack=slack,
            right=(report[:, :, 0] == self.a).sum(axis=1),
        )  # fmt: skip

    def finish(self, end: End) -> None:
        """Take in the final state, and close the last checks."""
        self.end = end
        while self.next_step < end.t:
            self.lost.append(self.next_step)
            self.next_step += 1
        self.x_oracle_end, self.x_nominal_end = self._twins.x
        self._sums[0] += np.square(end.x - self.x_oracle_end).sum()
        self._sums[1] += np.square(self.x_nominal_end - self.x_oracle_end).sum()
        if self._last is not None and self._last.t == end.t - 1:
            self._check_motion([(self._last, end.x)])

    @property
    def regret_sum(self) -> float:
        """D at the last state, the final one included once it is known."""
        return float(self._sums[0])

    @property
    def nominal_regret_sum(self) -> float:
        """The same of the nominal twin."""
        return float(self._sums[1])

    def _beta(self, x: Matrix, w: Matrix) -> Matrix:
        """beta(t) uses the samples before t, as ahat(t) does."""
        sxx, sxw = _running(self._sxx, x * x), _running(self._sxw, x * w)
        before_xx, before_xw = np.vstack([self._sxx, sxx[:-1]]), np.vstack([self._sxw, sxw[:-1]])
        self._sxx, self._sxw = sxx[-1], sxw[-1]
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(before_xw / before_xx)

    def _identifiable(self, beta: Matrix) -> NDArray[np.bool_]:
        found = np.zeros(beta.shape, dtype=np.bool_)
        for i, rivals in enumerate(self._rivals):
            nearest = rivals[np.abs(self.a[i] + beta[:, i, None] - rivals).argmin(axis=1)]
            found[:, i] = (nearest == self.a[i]) & np.isfinite(beta[:, i])
        return found

    def _check(self, rows: Sequence[Telemetry], x: Matrix, u: Matrix, ahat: Matrix, certificate: Array) -> None:
        steps = [row.t for row in rows]
        chain = rows if self._last is None else [self._last, *rows]
        # Where telemetry was lost, two rows that follow each other here are not of consecutive steps.
        self._check_motion([(p, q.x) for p, q in itertools.pairwise(chain) if q.t == p.t + 1])
        self._last = rows[-1]
        self.checks["oracle_certificate"].see(certificate, steps)
        listed = (self._padded == ahat[:, :, None]).any(axis=2).all(axis=1)
        acts = (control(self.b, x, ahat) == u).all(axis=1)
        self.checks["estimates"].see(np.where(listed & acts, -1.0, 1.0), steps)

    def _check_motion(self, pairs: Sequence[tuple[Telemetry, Array]]) -> None:
        """Equation (1) to the bit, and the contraction, for each row and the state after it."""
        if not pairs:
            return
        x, u, w = (np.array([getattr(past, name) for past, _ in pairs]) for name in ("x", "u", "w"))
        x_next = np.array([after for _, after in pairs])
        edge_open = np.array([past.edge_open for past, _ in pairs], dtype=np.bool_)
        steps = [past.t for past, _ in pairs]
        equal = (dynamics(self.a, self.b, self.graph, x, u, w, edge_open) == x_next).all(axis=1)
        self.checks["dynamics"].see(np.where(equal, -1.0, 1.0), steps)
        bound = self.rho * np.abs(x).sum(axis=1) + np.abs(w).sum(axis=1)
        norm = np.abs(x_next).sum(axis=1)
        self.checks["contraction"].see(norm / (bound + TINY) - 1 - ROUNDING, steps)

    def summary(self) -> dict[str, float | int | None]:
        """The metrics at the end, as verdict.json holds them; None for what is undefined."""
        _, _, cost, cost_oracle, energy = (float(value) for value in self._sums)
        gain = np.sqrt(cost / energy) if energy > 0 else None
        gain_x0 = np.sqrt(max(0.0, cost - float(self.v0)) / energy) if energy > 0 else None
        ahat = self._last.report[:, 0] if self._last is not None else np.full(self.graph.n, np.nan)
        return {
            "regret": self.regret_sum,
            "regret_nominal": self.nominal_regret_sum,
            "cost": cost,
            "cost_oracle": cost_oracle,
            "cost_regret": cost - cost_oracle,
            "cost_ratio": cost / cost_oracle if cost_oracle > 0 else None,
            "disturbance_energy": energy,
            "gain": gain,
            "gain_less_x0": gain_x0,
            "gamma_star": self.gamma_star,
            "rho": self.rho,
            "nodes_right": int((ahat == self.a).sum()),
        }
