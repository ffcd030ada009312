"""S networks of n nodes as one network of S disjoint parts, in plain numbers.

The parts do not interact: the plant, the shard and a law compute every node from its own numbers and those of its
neighbours. So one run of the union makes S runs, and states, inputs and estimates equal those of single runs, bit for
bit. Lots are drawn by the seed and the ids of each part.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from hedgerow.agents.law import Law
from hedgerow.agents.laws.robust import Robust
from hedgerow.agents.view import View
from hedgerow.orchestrator.ground.assignment import candidates_of, history_of, law_of, law_seed
from hedgerow.orchestrator.ground.laws import completed
from hedgerow.plant.truth import Truth
from hedgerow.topologies import lots
from hedgerow.topologies.archive import id_array
from hedgerow.topologies.edges import Edge
from hedgerow.topologies.effects import EDGES, INCIDENCES, NODES, Effect
from hedgerow.topologies.faults import Jump, effects
from hedgerow.topologies.graph import Array, Gain, Graph, Index
from hedgerow.topologies.law_choice import LawChoice
from hedgerow.topologies.network import Group
from hedgerow.topologies.resolve import copies, resolve
from hedgerow.topologies.schema import Topology


class SizesError(Exception):
    """Networks of a batch that differ in their numbers of nodes."""


@dataclass(frozen=True, eq=False)
class Union:
    """A union of S parts with n nodes each; arrays are over all S n nodes, part after part, unless noted."""

    S: int
    n: int
    topology: Topology
    """one of the parts, for everything that all parts share"""
    ids: Any
    graph: Graph
    edge_part: Index
    """the part of each edge, (E,)"""
    b: Gain
    a: Array
    x0: Array
    nominal: Array
    models: Array
    """the models of each node under the law, (M, S n), padded with NaN"""
    candidates: Array
    """the candidates of the file, (M, S n)"""
    disturbance: Sequence[Group]
    seeds: lots.Words
    """the seed of each part, (S,)"""
    law_seeds: lots.Words
    effects: Sequence[Effect]
    """the effects of faults; targets count over all parts"""
    idle: Sequence[bool]
    """by part: True if a fault cannot strike before the last step"""
    thetas: Array | None
    """theta of the law `robust` of each part, (S,)"""

    @property
    def steps(self) -> int:
        """Return the number of steps of every part."""
        return self.topology.steps

    @cached_property
    def words(self) -> lots.Words:
        """Return the seed of each node, (S n,)."""
        return np.repeat(self.seeds, self.n)

    def truth(self) -> Truth:
        """Return the plant's knowledge of the union."""
        return Truth(
            ids=self.ids,
            b=self.b,
            a=self.a,
            x0=self.x0,
            edges=self.graph.edges,
            weights=self.graph.weights,
            disturbance=self.disturbance,
            steps=self.steps,
            seed=self.words,
            shards=[np.arange(self.S * self.n)],
            effects=[effect.to_dict() for effect in self.effects],
            faults=len(self.topology.faults),
            history=history_of(self.topology),
        )

    def view(self) -> View:
        """Return the view of one process that runs all nodes."""
        return View(
            shard=0,
            b=self.b,
            law=law_of(self.topology),
            ids=self.ids,
            candidates=np.ascontiguousarray(self.models[~np.isnan(self.models).all(axis=1)]),
            row=self.graph.node,
            column=self.graph.neighbour,
            weights=self.graph.weight,
            peers=[],
            outside=id_array([]),
            history=history_of(self.topology),
            seed=np.repeat(self.law_seeds, self.n),
        )

    def law(self) -> Law | None:
        """Return the law of all parts if their parameters differ; None for the law of the view."""
        return None if self.thetas is None else Robust.of_nodes(self.b, np.repeat(self.thetas, self.n))


def of_seeds(topology: Topology, seeds: Sequence[int], folder: Path = Path()) -> Union:
    """Return the union of a topology under some seeds. Raises SizesError if the parts differ in size."""
    if not _is_drawn_at_once(topology):
        return _of_topologies(
            [completed(resolve(topology.model_copy(update={"seed": seed}), folder)) for seed in seeds]
        )
    S, n = len(seeds), len(topology.ids)
    network = copies(topology, seeds, folder)
    one = network.graph
    graph = _joined([one.edges] * S, n, None if one.weights is None else [one.weights] * S)
    of_one = effects(topology.faults, topology) if topology.faults else []
    return Union(
        S=S,
        n=n,
        topology=topology,
        ids=id_array(tuple(topology.ids) * S),
        graph=graph,
        edge_part=np.repeat(np.arange(S), len(one.edges)),
        b=network.b,
        a=network.a,
        x0=network.x0,
        nominal=network.nominal,
        models=_models(topology, network.a, network.nominal, network.candidates),
        candidates=network.candidates,
        disturbance=network.disturbance,
        seeds=np.array(seeds, dtype=np.uint64),
        law_seeds=np.array([law_seed(topology, seed) for seed in seeds], dtype=np.uint64),
        effects=_shifted([of_one] * S, [_Place(n * k, len(one.node) * k, len(one.edges) * k) for k in range(S)]),
        idle=[_is_idle(of_one, topology)] * S,
        thetas=None,
    )


def _is_drawn_at_once(topology: Topology) -> bool:
    """Return True if only gains, states, models and disturbances depend on the seed, each by a separate lot."""
    return (
        topology.disturbance is None
        and topology.generator is None
        and LawChoice.parse(topology.law).name != "robust"
        # A jump leads to a candidate, which may be drawn.
        and not any(isinstance(fault, Jump) for fault in topology.faults)
        and not any(isinstance(edge, Edge) and not isinstance(edge.weight, float) for edge in topology.edges)
    )


def _of_topologies(parts: Sequence[Topology]) -> Union:
    """Return the union of resolved topologies that differ only in their drawn numbers."""
    networks, first = [one.network for one in parts], parts[0]
    S, n = len(parts), len(first.ids)
    if any(len(one.ids) != n for one in parts):
        raise SizesError
    edges = [one.graph.edges for one in networks]
    weighted = any(one.graph.weights is not None for one in networks)
    weights = [np.ones(len(one.graph.edges)) if one.graph.weights is None else one.graph.weights for one in networks]
    gains: set[Any] = {one.b if isinstance(one.b, float) else None for one in networks}
    b = np.concatenate([np.broadcast_to(one.b, n) for one in networks])
    choice = LawChoice.parse(first.law).name
    stops = np.concatenate([[0], np.cumsum([len(own) for own in edges])]).tolist()
    own_effects = [effects(one.faults, one) if one.faults else [] for one in parts]
    return Union(
        S=S,
        n=n,
        topology=first,
        ids=np.concatenate([id_array(tuple(one.ids)) for one in parts]),
        graph=_joined(edges, n, weights if weighted else None),
        edge_part=np.repeat(np.arange(S), [len(own) for own in edges]),
        b=networks[0].b if len(gains) == 1 and None not in gains else b,
        a=np.concatenate([one.a for one in networks]),
        x0=np.concatenate([one.x0 for one in networks]),
        nominal=np.concatenate([one.nominal for one in networks]),
        models=_beside([candidates_of(one) for one in parts]),
        candidates=_beside([one.candidates for one in networks]),
        disturbance=_groups([one.disturbance for one in networks], n),
        seeds=np.array([one.seed for one in parts], dtype=np.uint64),
        law_seeds=np.array([law_seed(one) for one in parts], dtype=np.uint64),
        effects=_shifted(own_effects, [_Place(n * k, 2 * stops[k], stops[k]) for k in range(S)]),
        idle=[_is_idle(own, one) for own, one in zip(own_effects, parts, strict=True)],
        thetas=np.array([LawChoice.parse(one.law).parameters["theta"] for one in parts])
        if choice == "robust"
        else None,
    )


def _joined(edges: Sequence[Index], n: int, weights: Sequence[Array] | None) -> Graph:
    whole = np.concatenate([own + k * n for k, own in enumerate(edges)])
    return Graph(n * len(edges), whole, None if weights is None else np.concatenate(weights))


def _models(topology: Topology, a: Array, nominal: Array, candidates: Array) -> Array:
    return {"hinf": a[None], "nominal": nominal[None]}.get(topology.law, candidates)


def _beside(lists: Sequence[Array]) -> Array:
    """Return columns of several networks side by side, padded with NaN to the longest list."""
    n = lists[0].shape[1]
    whole = np.full((max(map(len, lists)), n * len(lists)), np.nan)
    for k, listed in enumerate(lists):
        whole[: len(listed), k * n : (k + 1) * n] = listed
    return whole


def _groups(of_parts: Sequence[Sequence[Group]], n: int) -> list[Group]:
    """Return the groups of all parts, joined by place and kind, in the order of their sum."""
    found: dict[tuple[int, str], list[Group]] = {}
    for k, groups in enumerate(of_parts):
        for group in groups:
            shifted = dataclasses.replace(group, nodes=group.nodes + n * k)
            found.setdefault((group.number, group.kind), []).append(shifted)
    return [
        Group(
            number,
            kind,
            np.concatenate([one.nodes for one in groups]),
            {key: np.concatenate([one.values[key] for one in groups]) for key in groups[0].values},
        )
        for (number, kind), groups in sorted(found.items())
    ]


@dataclass(frozen=True)
class _Place:
    """The first node, incidence and edge of a part."""

    node: int
    incidence: int
    edge: int

    def of(self, effect: Effect) -> int:
        """Return the shift of the targets of an effect."""
        return {INCIDENCES: self.incidence, EDGES: self.edge, NODES: self.node}[effect.of]


def _shifted(of_parts: Sequence[Sequence[Effect]], places: Sequence[_Place]) -> list[Effect]:
    """Return the effects of all parts in the order of the file; equal ones of several parts are one effect."""
    found: dict[Any, Effect] = {}
    for k, (own, place) in enumerate(zip(of_parts, places, strict=True)):
        for number, effect in enumerate(own):
            shift = place.of(effect)
            targets = tuple(target + shift for target in effect.targets)
            if effect.changes_truth:
                found[number, k] = dataclasses.replace(effect, targets=targets)
                continue
            key = number, effect.start, effect.stop, effect.probability, effect.by, effect.table is None
            table = None if effect.table is None else _table(effect.table, shift)
            if (before := found.get(key)) is None:
                found[key] = dataclasses.replace(effect, targets=targets, table=table)
            else:
                found[key] = dataclasses.replace(
                    before, targets=(*before.targets, *targets), table=_merged(before.table, table)
                )
    return [found[key] for key in sorted(found, key=lambda key: key[0])]


def _table(table: Mapping[int, Sequence[int]], shift: int) -> dict[int, tuple[int, ...]]:
    return {step: tuple(target + shift for target in struck) for step, struck in table.items()}


def _merged(
    one: Mapping[int, Sequence[int]] | None, other: Mapping[int, Sequence[int]] | None
) -> dict[int, tuple[int, ...]] | None:
    if one is None or other is None:
        return None
    return {step: (*one.get(step, ()), *other.get(step, ())) for step in sorted({*one, *other})}


def _is_idle(own: Sequence[Effect], topology: Topology) -> bool:
    """Return True if a fault of a part strikes nothing before the last step; the verdict reports such a fault."""
    able = {
        one.fault
        for one in own
        if one.start >= one.stop
        or (one.table is not None and any(struck and step < topology.steps for step, struck in one.table.items()))
        or (one.table is None and one.targets and one.start < min(topology.steps, one.stop))
    }
    return len(able) < len(topology.faults)
