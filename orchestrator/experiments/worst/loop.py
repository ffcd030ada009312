"""Many disturbances at once through one network and its law, and the adjoint of what happened."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hedgerow.topologies.graph import Array, Graph, Index, Mask

TIE = 1e-7
"""A model must win by this share of the disturbance's energy so far: else it may win by rounding, and not again."""
DENSE = 400
"""Number of nodes up to which a product with the dense Laplacian is quicker."""


@dataclass(frozen=True)
class Breaks:
    """Faults that last from a step to the end of the run."""

    cuts: tuple[tuple[int, int], ...] = ()
    """(edge, first step): the edge carries no flow"""
    drops: tuple[tuple[int, int], ...] = ()
    """(incidence, first step): its node no longer hears the neighbour, and learns nothing"""


NONE = Breaks()


@dataclass(frozen=True)
class Scene:
    """The network that is attacked."""

    graph: Graph
    a: Array
    b: float | Array
    candidates: Array
    """(M, n), NaN behind the end of a list"""
    law: Callable[[Any, Array], Any]
    """constructs the law of k nodes from their gains and candidates, as a shard does"""
    _laplacians: dict[Any, Any] = field(default_factory=dict, repr=False)

    def laplacian(self, cut: frozenset[int]) -> Any:
        """Return the weighted Laplacian without some edges."""
        if cut not in self._laplacians:
            self._laplacians[cut] = _laplacian(self.graph, cut)
        return self._laplacians[cut]

    def over(self, breaks: Breaks, steps: int) -> list[Any]:
        """Return the Laplacian of each step."""
        return [self.laplacian(frozenset(edge for edge, first in breaks.cuts if first <= t)) for t in range(steps)]


def _laplacian(graph: Graph, cut: frozenset[int]) -> Any:
    i, j = graph.edges.T
    k = np.ones(len(i)) if graph.weights is None else graph.weights.copy()
    k[list(cut)] = 0.0
    if graph.n <= DENSE:
        dense = np.zeros((graph.n, graph.n))
        np.add.at(dense, (i, i), k)
        np.add.at(dense, (j, j), k)
        np.add.at(dense, (i, j), -k)
        np.add.at(dense, (j, i), -k)
        return dense
    import scipy.sparse  # noqa: PLC0415 (half a second, and only large networks need it)

    rows, columns = np.concatenate([i, j, i, j]), np.concatenate([i, j, j, i])
    return scipy.sparse.coo_array((np.concatenate([k, k, -k, -k]), (rows, columns)), (graph.n, graph.n)).tocsr()


def product(laplacian: Any, u: Array) -> Array:
    """Return the flows of B inputs, (B, n)."""
    return np.asarray(u @ laplacian if isinstance(laplacian, np.ndarray) else (laplacian @ u.T).T)


@dataclass(frozen=True)
class Played:
    """B runs of T steps from x(0) = 0."""

    w: Array
    """(B, T, n)"""
    x: Array
    """(T + 1, B, n)"""
    theta: Array
    """z / x = 1/(1 - ahat) where the law acts by (6), (T, B, n)"""
    cost: Array
    """of each step, (T, B)"""
    sound: Mask
    """True while no model has won or lost by rounding, (T, B)"""

    def gains(self) -> tuple[Array, Index]:
        """Return the largest gain squared of a sound prefix, and its number of steps, both (B,)."""
        cost, energy = self.cost.cumsum(axis=0), np.square(self.w).sum(axis=2).T.cumsum(axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            gain = np.where(self.sound & (energy > 0), cost / energy, 0.0)
        best = gain.argmax(axis=0)
        return gain[best, np.arange(gain.shape[1])], best + 1


def play(scene: Scene, w: Array, breaks: Breaks = NONE, steps: int | None = None) -> Played:
    """Run the law under B disturbances w, (B, T, n); of one that is shorter than `steps` the last value stays."""
    count, given, n = w.shape
    steps = steps or given
    if steps > given:
        w = np.concatenate([w, np.repeat(w[:, -1:], steps - given, axis=1)], axis=1)
    b = np.asarray(scene.b, dtype=float)
    law = scene.law(scene.b if b.ndim == 0 else np.tile(b, count), np.tile(scene.candidates, (1, count)))
    single = (~np.isnan(scene.candidates)).sum(axis=0) < 2
    deaf = {}
    for incidence, first in breaks.drops:
        node = int(scene.graph.node[incidence])
        deaf[node] = min(first, deaf.get(node, first))
    over = scene.over(breaks, steps)
    x = np.zeros((steps + 1, count, n))
    theta, cost = np.full((steps, count, n), 2.0), np.empty((steps, count))
    sound = np.empty((steps, count), dtype=bool)
    energy, seen, fine = np.zeros(count), np.zeros((count, n)), np.ones(count, dtype=bool)
    with np.errstate(all="ignore"):
        for t in range(steps):
            now = x[t]
            u = np.asarray(law.act(now.reshape(-1))).reshape(count, n)
            margin = np.asarray(law.report())[1].reshape(count, n)
            tied = (margin < TIE * energy[:, None]) & (seen > 0) & ~single
            fine = fine & ~tied.any(axis=1) & np.isfinite(u).all(axis=1)
            sound[t] = fine
            flow = product(over[t], u)
            cost[t] = np.square(now).sum(axis=1) + (u * flow).sum(axis=1)
            acts = now != 0
            theta[t][acts] = (-u / b)[acts] / now[acts]
            x[t + 1] = scene.a * now + b * flow + w[:, t]
            energy += np.square(w[:, t]).sum(axis=1)
            seen += now * now
            heard = flow
            if lost := [node for node, first in deaf.items() if first <= t]:
                heard = flow.copy()
                heard[:, lost] = np.nan
            law.learn(now.reshape(-1), heard.reshape(-1), x[t + 1].reshape(-1))
    return Played(w, x, theta, np.nan_to_num(cost, nan=0.0, posinf=0.0), sound)


def ascend(scene: Scene, played: Played, lengths: Sequence[int] | Index, breaks: Breaks = NONE) -> Array:
    """Return the gradients of the costs of prefixes, scaled to the energy of w, with the switching frozen, (B, T, n).

    For a linear loop this is a step of the power method: lambda(t) = q(t) + (A - B B' Theta)' lambda(t+1), where q is
    half the gradient of the stage cost, and the new w(t) is along lambda(t+1).
    """
    steps, count, n = played.theta.shape
    b = np.asarray(scene.b, dtype=float)
    over = scene.over(breaks, steps)
    within = np.arange(steps)[:, None] < np.asarray(lengths)[None, :]
    found = np.zeros((count, steps, n))
    later = np.zeros((count, n))
    for t in reversed(range(steps)):
        found[:, t] = later
        theta, x = played.theta[t], played.x[t]
        stage = x + theta * b * product(over[t], b * theta * x)
        later = scene.a * later - theta * b * product(over[t], b * later) + stage * within[t][:, None]
    size = np.sqrt(np.square(found).sum(axis=(1, 2)))
    energy = np.sqrt(np.square(played.w).sum(axis=(1, 2)))
    with np.errstate(invalid="ignore", divide="ignore"):
        scaled = found * (energy / size)[:, None, None]
    return np.where(np.isfinite(scaled), scaled, played.w)
