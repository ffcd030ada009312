"""Networks that the tests share, and how they run in one process."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st

from hedgerow.orchestrator.ground.assignment import Layout, candidates_of, layout, truth_of, views_of
from hedgerow.orchestrator.metrics.observer import Batch, Observer
from hedgerow.orchestrator.runs.reference import run
from hedgerow.topologies.graph import Array
from hedgerow.topologies.hinf import allowed_interval
from hedgerow.topologies.load import parse
from hedgerow.topologies.resolve import resolve
from hedgerow.topologies.schema import Topology
from hedgerow.wire.message import End, Telemetry

VECTORS = sorted((Path(__file__).parents[1] / "vectors").glob("*.json"))


def read(text: str, *overrides: str, folder: Path = Path()) -> Topology:
    """The topology that `text` describes, checked and drawn."""
    return resolve(parse(text.encode(), "network.yaml", folder, overrides), folder)


def vector_file(path: Path) -> tuple[str, dict[str, Any]]:
    """Return the text of a topology file for the network of a vector, and the expected numbers."""
    vector = json.loads(path.read_text(encoding="utf-8"))
    nodes = {
        i: {
            "a": vector["a_true"][i],
            "candidates": vector["candidates"][i],
            "x0": vector["x0"][i],
            "disturbance": {"kind": "samples", "values": [w[i] for w in vector["w"]]},
        }
        for i in range(vector["N"])
    }
    for i, b in enumerate(vector.get("b_nodes", ())):
        nodes[i]["b"] = b
    edges = [
        ends if weight == 1 else {"ends": ends, "weight": weight}
        for ends, weight in zip(vector["edges"], vector.get("weights", [1] * len(vector["edges"])), strict=True)
    ]
    text = {"name": vector["name"], "b": vector.get("b", 0.1), "steps": vector["T"]}
    return json.dumps(text | {"nodes": nodes, "edges": edges}), vector["expected"]


def from_vector(path: Path) -> tuple[Topology, dict[str, Any]]:
    """Return the network of a vector, read from a topology file, and the expected numbers."""
    text, expected = vector_file(path)
    return read(text), expected


def listed(topology: Topology) -> list[list[float]]:
    """The models that each node chooses among."""
    return [column[~np.isnan(column)].tolist() for column in candidates_of(topology).T]


@dataclass(frozen=True)
class Trajectory:
    """The results of a run: its telemetry, and the same as arrays."""

    rows: list[Telemetry]
    end: End

    @property
    def x(self) -> Array:
        """(T + 1, n)"""
        return np.array([*(row.x for row in self.rows), self.end.x])

    @property
    def u(self) -> Array:
        """(T, n)"""
        return np.array([row.u for row in self.rows])

    @property
    def w(self) -> Array:
        """(T, n)"""
        return np.array([row.w for row in self.rows])

    @property
    def report(self) -> Array:
        """(T, 2, n)"""
        return np.array([row.report for row in self.rows])

    def same_bits(self, other: Trajectory) -> bool:
        """Every byte of every row is equal."""
        pairs = zip(self.rows, other.rows, strict=True)
        fields = [(a, b) for one, two in pairs for a, b in zip(one[1:], two[1:], strict=True)]
        fields.append((self.end.x, other.end.x))
        return all(np.asarray(a).tobytes() == np.asarray(b).tobytes() for a, b in fields)


def simulate(topology: Topology, shards: Layout | None = None) -> Trajectory:
    """A run in one process; without `shards`, one agent a node."""
    shards = layout(topology, None) if shards is None else shards
    return gathered(run(truth_of(topology, shards), views_of(topology, shards)))


def gathered(telemetry: Iterable[Telemetry | End]) -> Trajectory:
    """Return all messages of a run, to its end."""
    *rows, end = telemetry
    assert isinstance(end, End)
    return Trajectory([row for row in rows if isinstance(row, Telemetry)], end)


def observe(topology: Topology, ran: Trajectory) -> tuple[Observer, Batch]:
    """Return all metrics of a run, in one batch."""
    observer = Observer(topology)
    batch = observer.take(ran.rows)
    observer.finish(ran.end)
    return observer, batch


def floats(low: float, high: float) -> st.SearchStrategy[float]:
    """Numbers of a size that a person would write."""
    return st.integers(0, 1000).map(lambda k: low + (high - low) * k / 1000)


def disturbances(steps: int) -> st.SearchStrategy[Any]:
    """Draw a disturbance as in a file: one of each kind, or a sum of some."""
    value = floats(-3, 3)
    one = st.one_of(
        st.just("none"),
        st.builds(lambda v: {"kind": "constant", "value": v}, value),
        st.builds(lambda v: {"kind": "white", "std": abs(v)}, value),
        st.builds(lambda at, v: {"kind": "impulse", "at": at, "value": v}, st.integers(0, 9), value),
        st.builds(
            lambda a, o, p: {"kind": "sinusoid", "amplitude": a, "omega": o, "phase": p},
            value,
            value,
            value,
        ),
        st.builds(
            lambda v: {"kind": "samples", "values": v},
            st.lists(value, min_size=steps, max_size=steps),
        ),
    )
    return st.one_of(one, st.lists(one, min_size=1, max_size=3))


@st.composite
def networks(draw: st.DrawFn, most: int = 6, steps: int = 12, law: str = "minimax") -> Topology:
    """Any graph of up to `most` nodes, with a, b and candidate lists of any length within (3).

    In half of them the nodes' gains and the edges' weights differ.
    """
    n = draw(st.integers(1, most))
    pairs = st.sampled_from([*itertools.permutations(range(n), 2)]) if n > 1 else st.nothing()
    edges = draw(st.lists(pairs, unique_by=frozenset, max_size=2 * n)) if n > 1 else []
    unequal = draw(st.booleans())
    weights = [draw(floats(0.1, 5)) if unequal else 1 for _ in edges]
    degree = [sum(weight * (i in edge) for edge, weight in zip(edges, weights, strict=True)) for i in range(n)]
    b = draw(floats(0.1, 0.97)) / (8 * max(1, *degree)) ** 0.5
    nodes: dict[int, dict[str, Any]] = {}
    for i in draw(st.permutations(range(n))):
        own = draw(floats(0.1, 0.97)) / (8 * max(0.01, degree[i])) ** 0.5 if unequal else b
        interval = allowed_interval(own, degree[i])
        assert interval is not None
        low, high = interval
        inside = floats(low + 0.02 * (high - low), high - 0.02 * (high - low))
        listed = draw(st.lists(inside, min_size=1, max_size=4))
        nodes[i] = {
            "a": draw(st.sampled_from(listed)),
            "candidates": listed,
            "nominal": draw(inside),
            "x0": draw(floats(-20, 20)),
            "disturbance": draw(disturbances(steps)),
        }
        if unequal:
            nodes[i]["b"] = own
    seed = draw(st.integers(0, 2**63 - 1))
    head = {"name": "drawn", "b": b, "steps": steps, "seed": seed, "law": law}
    written = [
        {"ends": ends, "weight": weight} if unequal else ends for ends, weight in zip(edges, weights, strict=True)
    ]
    return read(json.dumps(head | {"nodes": nodes, "edges": written}))


@st.composite
def partitions(draw: st.DrawFn, n: int) -> Layout:
    """Draw any assignment of n nodes to agent processes."""
    home = draw(st.lists(st.integers(0, n - 1), min_size=n, max_size=n))
    return [[k for k in range(n) if home[k] == p] for p in sorted(set(home))]
