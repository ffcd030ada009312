"""Many runs at once: S networks of one size side by side in one array, which never meet.

One by one, nearly all of the time of a small network is overhead of numpy calls on a few numbers. A law treats its
columns separately, so it sees the S networks as one shard of S n nodes. States, inputs and estimates are those of each
run by itself, to the bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hedgerow.agents.law import control
from hedgerow.agents.loading import new_law
from hedgerow.agents.local import Heard, asks
from hedgerow.agents.view import View
from hedgerow.orchestrator.experiments.compare.estimates import judged, switches
from hedgerow.orchestrator.ground.assignment import candidates_of, law_of, law_seed
from hedgerow.plant.disturbance import Disturbance
from hedgerow.topologies.archive import id_array
from hedgerow.topologies.effects import Effect
from hedgerow.topologies.faults import effects
from hedgerow.topologies.graph import Array, Graph
from hedgerow.topologies.law_choice import NAMES, LawChoice
from hedgerow.topologies.schema import Topology

LARGEST = 500
"""The maximum number of nodes in a batch; the time of a larger network is arithmetic anyway."""
_NOBODY = np.empty(0)
"""the neighbours' values for an asking law of the project, which uses only the step"""


def why_not(topologies: Sequence[Topology]) -> str:
    """Return why resolved topologies cannot be run at once, in words; empty if they can."""
    first = topologies[0]
    reasons = (
        (len(first.ids) > LARGEST, f"there are more than {LARGEST} nodes"),
        (any(len(one.ids) != len(first.ids) for one in topologies), "their sizes differ"),
        (any(one.network.b != first.network.b for one in topologies if not _unequal(one)), "their gains differ"),
        (any(map(_unequal, topologies)), "their gains or weights are unequal"),
        (any(one.kind != "jump" for topology in topologies for one in topology.faults), "there are faults"),
        (LawChoice.parse(first.law).name not in NAMES, "the law may ask for its neighbours' values"),
        (any(_paramless(one) != _paramless(first) for one in topologies), "their laws differ"),
    )
    return next((why for holds, why in reasons if holds), "")


def _unequal(topology: Topology) -> bool:
    return not isinstance(topology.network.b, float) or topology.network.graph.weights is not None


def _paramless(topology: Topology) -> str:
    """Return the law, but robust without its theta, which is each network's own."""
    return "robust" if topology.law.startswith("robust") else topology.law


class Many:
    """S networks of n nodes in motion, with the oracle's twin of each, and the sums of each."""

    def __init__(self, topologies: Sequence[Topology]) -> None:
        networks = [one.network for one in topologies]
        self._topologies = topologies
        self._shape = S, n = len(topologies), len(topologies[0].ids)
        self._b = networks[0].b
        self._graph = Graph(S * n, np.concatenate([one.graph.edges + k * n for k, one in enumerate(networks)]))
        edges = np.array([len(one.graph.edges) for one in networks])
        self._edge_of = np.repeat(np.arange(S), edges)
        self._a, self._x = (np.concatenate([getattr(one, name) for one in networks]) for name in ("a", "x0"))
        self._disturbances = [
            Disturbance(net.disturbance, net.ids, one.seed) for net, one in zip(networks, topologies, strict=True)
        ]
        self._jumps: dict[int, list[tuple[int, Effect]]] = {}
        for k, one in enumerate(topologies):
            for effect in effects(one.faults, one):
                self._jumps.setdefault(effect.start, []).append((k, effect))
        self._law: Any = self._of_all()
        self._learns_of, self._acts_on = asks(self._law.learn, "sample"), asks(self._law.act, "now")

    def _of_all(self) -> Any:
        S, n = self._shape
        lists = [candidates_of(one) for one in self._topologies]
        candidates = np.full((max(map(len, lists)), S * n), np.nan)
        for k, listed in enumerate(lists):
            candidates[: len(listed), k * n : (k + 1) * n] = listed
        none = np.empty(0, dtype=np.int64)
        words = np.array([law_seed(one) for one in self._topologies], dtype=np.uint64)
        seeds: Any = np.repeat(words, n)  # lots are drawn by the seed of each node's own network
        ids = [id_array(tuple(one.ids)) for one in self._topologies]
        law = new_law(
            View(
                shard=0,
                b=self._b,
                law=law_of(self._topologies[0]),
                ids=np.concatenate(ids),
                candidates=candidates,
                row=none,
                column=none,
                peers=[],
                heard=id_array([]),
                history=0,
                seed=seeds,
            )
        )
        if _paramless(self._topologies[0]) == "robust":
            return _Thetas(
                self._b, [float(LawChoice.parse(one.law).parameters["theta"]) for one in self._topologies], n
            )
        return law

    def run(self) -> list[dict[str, float | None]]:
        """Make every step; return the metrics of each network, all None where a number grew beyond all bounds."""
        (S, n), graph, b, law = self._shape, self._graph, self._b, self._law
        x = x_oracle = self._x
        nothing = Heard(0, np.ones(S * n, dtype=bool), _NOBODY, _NOBODY, np.empty(0, dtype=np.int64))
        regret, cost, cost_oracle, energy, changed = np.zeros((5, S))
        ahat, finite = np.full(S * n, np.nan), np.ones(S, dtype=bool)
        steps = self._topologies[0].steps
        for t in range(steps):
            for k, jump in self._jumps.get(t, ()):
                self._a[k * n + jump.targets[0]] = jump.a
            a, now = self._a, nothing._replace(t=t)
            u = np.array(law.act(x, now) if self._acts_on else law.act(x), dtype=float)
            before, ahat = ahat, np.array(law.report()[0], dtype=float)
            changed += switches(before.reshape(S, n), ahat.reshape(S, n)) if t else 0.0
            w = self._w(t, x)
            u_oracle = control(b, x_oracle, a)
            regret += self._energy(x - x_oracle)
            cost += self._energy(x) + self._edge_cost(u)
            cost_oracle += self._energy(x_oracle) + self._edge_cost(u_oracle)
            energy += self._energy(w)
            finite &= np.isfinite(u.reshape(S, n)).all(axis=1)
            flow = graph.flow(u)
            x_next = a * x + b * flow + w
            x_oracle = a * x_oracle + b * graph.flow(u_oracle) + w
            if t + 1 < steps:  # no step comes after the last sample
                law.learn(x, flow, x_next, *([now] if self._learns_of else []))
            x = x_next
        regret += self._energy(x - x_oracle)
        with np.errstate(invalid="ignore", divide="ignore"):
            gain = np.where(energy > 0, np.sqrt(cost / energy), np.nan)
        found = []
        for k, topology in enumerate(self._topologies):
            own = slice(k * n, (k + 1) * n)
            numbers = {"regret": regret[k], "cost_regret": cost[k] - cost_oracle[k], "gain": gain[k]}
            row = {name: float(value) if np.isfinite(value) else None for name, value in numbers.items()}
            row |= judged(ahat[own], self._a[own], topology.network.candidates)
            row["switches"] = float(changed[k]) / n
            found.append(row if finite[k] else dict.fromkeys(row))
        return found

    def _w(self, t: int, x: Array) -> Array:
        n = self._shape[1]
        return np.concatenate(
            [
                one.at(t, x[k * n : (k + 1) * n], self._a[k * n : (k + 1) * n]) if one.sees_state else one.at(t)
                for k, one in enumerate(self._disturbances)
            ]
        )

    def _energy(self, values: Array) -> Array:
        return np.asarray(np.square(values.reshape(self._shape)).sum(axis=1))

    def _edge_cost(self, u: Array) -> Array:
        squares = np.square(self._graph.edge_input(u))
        return np.asarray(np.bincount(self._edge_of, squares, self._shape[0]))


class _Thetas:
    """The law `robust` with the theta of each network."""

    def __init__(self, b: Any, thetas: Sequence[float], n: int) -> None:
        self._b, self._ahat = b, np.repeat(thetas, n)

    def act(self, x: Array) -> Array:
        return control(self._b, x, self._ahat)

    def learn(self, x: Array, flow: Array, x_next: Array) -> None:
        pass

    def report(self) -> Array:
        return self._ahat[None]
