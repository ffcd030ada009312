"""Many disturbances at once through one network and its law, and the adjoint of what happened."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from hedgerow.agents.law_lines import line_of, place_of
from hedgerow.agents.loading import LawError, new_law
from hedgerow.agents.local import Heard, asks
from hedgerow.agents.view import View
from hedgerow.orchestrator.ground.assignment import views_of
from hedgerow.topologies.graph import Array, Graph, Index, Mask
from hedgerow.topologies.hinf import smallest_eigenpair
from hedgerow.topologies.schema import Topology
from hedgerow.wire import crash

TIE = 1e-7
"""A model must win by this share of its node's sum of x^2 + w^2 over its samples so far: else it may win by rounding,
and not again."""
LEAD = 1e-12
"""Relative change of the lead of a model that is rounding."""
UNSCORED = 3
"""Up to this step a law that needs several samples, as notch does, has no scores, which is no tie."""
DENSE = 400
"""Number of nodes up to which a product with the dense Laplacian is quicker."""


@dataclass(frozen=True)
class Breaks:
    """Faults that last from a step to the end of the run."""

    cuts: tuple[tuple[int, int], ...] = ()
    """(edge, first step): the edge carries no flow"""
    drops: tuple[tuple[int, int], ...] = ()
    """(incidence, first step): its node gets no more messages from the neighbour, and learns nothing"""

    def __add__(self, other: Breaks) -> Breaks:
        return Breaks(self.cuts + other.cuts, self.drops + other.drops)

    def __len__(self) -> int:
        return len(self.cuts) + len(self.drops)


NONE = Breaks()


@dataclass(frozen=True)
class Scene:
    """The network that is attacked, and the view of one process that runs all of its nodes."""

    graph: Graph
    a: Array
    view: View
    _laplacians: dict[Any, Any] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, topology: Topology) -> Scene:
        """Return the scene of a topology, under its law."""
        (view,) = views_of(topology, [range(len(topology.ids))])
        return cls(topology.network.graph, topology.network.a, view)

    @cached_property
    def worst_of_oracle(self) -> Array:
        """Return the constant that is worst if every a is known, (n,)."""
        return smallest_eigenpair(self.a, self.b, self.graph)[1]

    @property
    def b(self) -> float | Array:
        """Return the gain, or the gains of the nodes."""
        return self.view.b

    def law(self, count: int) -> Any:
        """Return one law for `count` disjoint copies of the network: nodes never mix in a law."""
        n, view = self.graph.n, self.view
        first = n * np.arange(count)[:, None]
        return new_law(
            replace(
                view,
                b=view.b if np.ndim(view.b) == 0 else np.tile(view.b, count),
                ids=np.tile(view.ids, count),
                candidates=np.tile(view.candidates, (1, count)),
                row=(view.row + first).ravel(),
                column=(view.column + first).ravel(),
                weights=None if view.weights is None else np.tile(view.weights, count),
            )
        )

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
    margin: Array
    """by which the best model of a node leads, (T, B, n)"""
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

    def settled(self, rows: int, change: float) -> Mask:
        """Return True where no estimate changes in the last rows, and none is about to, (B,).

        A lead that a large disturbance has won shrinks step by step under the next ones, and then the estimate changes.
        """
        theta, margin = self.theta[-rows:], self.margin[-rows:]
        rests = np.ptp(theta, axis=0).max(axis=1) < change
        shrinks = (margin[-1] < margin[0] * (1 - LEAD)).any(axis=1)  # False for a law without one, which is NaN
        return np.asarray(rests & ~shrinks & self.sound[-1])


def play(scene: Scene, w: Array, breaks: Breaks = NONE, steps: int | None = None) -> Played:
    """Run the law under B disturbances w, (B, T, n); of one that is shorter than `steps` the last value stays."""
    count, given, n = w.shape
    steps = steps or given
    if steps > given:
        w = np.concatenate([w, np.repeat(w[:, -1:], steps - given, axis=1)], axis=1)
    b = np.asarray(scene.b, dtype=float)
    law = scene.law(count)
    neighbours = (scene.view.column + n * np.arange(count)[:, None]).ravel()
    act, learn = asks(law.act, "now"), asks(law.learn, "sample")
    single = (~np.isnan(scene.view.candidates)).sum(axis=0) < 2
    minimax = scene.view.law == "minimax"
    deaf = _deaf(scene, breaks, steps)
    over = scene.over(breaks, steps)
    x = np.zeros((steps + 1, count, n))
    theta, cost = np.full((steps, count, n), 2.0), np.empty((steps, count))
    leads = np.empty((steps, count, n))
    sound = np.empty((steps, count), dtype=bool)
    energy, seen, fine = np.zeros((count, n)), np.zeros((count, n)), np.ones(count, dtype=bool)
    none = np.full(len(neighbours), np.nan)
    heard = Heard(0, np.ones(count * n, dtype=bool), none, none, np.full(len(neighbours), -1))
    with np.errstate(all="ignore"):
        for t in range(steps):
            now = x[t]
            u = np.asarray(_called(scene, law, "act", now.reshape(-1), *([heard] if act else []))).reshape(count, n)
            margin = leads[t] = np.asarray(_called(scene, law, "report"))[1].reshape(count, n)
            tied = (margin < TIE * (energy + seen)) & (seen > 0) & ~single
            if t <= UNSCORED and not minimax:
                tied &= margin != 0
            fine = fine & ~tied.any(axis=1) & np.isfinite(u).all(axis=1)
            sound[t] = fine
            flow = product(over[t], u)
            cost[t] = np.square(now).sum(axis=1) + (u * flow).sum(axis=1)
            acts = now != 0
            theta[t][acts] = (-u / b)[acts] / now[acts]
            x[t + 1] = scene.a * now + b * flow + w[:, t]
            if act or learn:
                own = now.reshape(-1)[neighbours], u.reshape(-1)[neighbours]
                heard = Heard(t, np.ones(count * n, dtype=bool), *own, np.full(len(neighbours), t))
            known = flow
            lost = [node for node, first, end in deaf if first <= t < end]
            # A node that has learned nothing acts on its first candidate: its scores are equal exactly, which no
            # rounding breaks.
            learns = np.ones(n, dtype=bool)
            learns[lost] = False
            energy += np.square(w[:, t]) * learns
            seen += now * now * learns
            if lost:
                known = flow.copy()
                known[:, lost] = np.nan
            sample = now.reshape(-1), known.reshape(-1), x[t + 1].reshape(-1)
            _called(scene, law, "learn", *sample, *([heard] if learn else []))
            heard = heard._replace(t=t + 1)
    return Played(w, x, theta, leads, np.nan_to_num(cost, nan=0.0, posinf=0.0), sound)


def _deaf(scene: Scene, breaks: Breaks, steps: int) -> list[tuple[int, int, int]]:
    """Return the node of each drop, its first step, and the step from which its edge is cut: then nothing is lost."""
    cut = dict(sorted(breaks.cuts, reverse=True))
    return [
        (int(scene.graph.node[incidence]), first, cut.get(int(scene.graph.edge[incidence]), steps))
        for incidence, first in breaks.drops
    ]


def _called(scene: Scene, law: Any, method: str, *given: Any) -> Any:
    """Return the result of a method of the law; LawError with its line if the method raises."""
    try:
        return getattr(law, method)(*given)
    except (Exception, SystemExit) as error:
        if isinstance(error, SystemExit) and type(error) is not SystemExit:
            raise  # of a signal handler of ours, and not of the law
        where = place_of(error, type(law)) or line_of(type(law), method)
        said = f"{method}() raised {crash.summary(error)}. Correct the law."
        raise LawError(f"{where}law {scene.view.law}: {said}", method=method) from error


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
