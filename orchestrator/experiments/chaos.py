"""Random networks under random faults, over Zenoh: every run must reach its end and equal the reference.

A trial is a function of its seed. A failing trial is reduced while it still fails; the result is a topology file that
everyone can run.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from hedgerow.orchestrator.ground.assignment import layout
from hedgerow.orchestrator.ground.signals import EndNowError
from hedgerow.orchestrator.launch.fork_client import ForkClient
from hedgerow.orchestrator.launch.options import Options
from hedgerow.orchestrator.launch.up import Network
from hedgerow.orchestrator.launch.watching import Watching
from hedgerow.orchestrator.runs.folder import create
from hedgerow.orchestrator.views.screen import Quiet
from hedgerow.topologies.describe import count
from hedgerow.topologies.errors import TopologyError
from hedgerow.topologies.faults import Actuator, Crash, Cut, Delay, Drop, FaultModel, Jump, Partition, Sensor
from hedgerow.topologies.hinf import allowed_interval
from hedgerow.topologies.load import parse
from hedgerow.topologies.resolve import resolve, to_yaml
from hedgerow.topologies.schema import Topology

MAX_STEPS = 30
SHRINK_S = 120.0
"""the time limit for the reduction of a failing trial [s]"""

Raw = dict[str, Any]
"""A topology as in a file."""


@dataclass(frozen=True)
class Finding:
    """A failing trial, reduced as far as possible."""

    seed: int
    wrong: str
    topology: Topology


def drawn(seed: int, most: int = 12) -> Raw:
    """Return a network of 2 to `most` nodes with some faults, as a file spells them: a function of `seed`."""
    lots = np.random.default_rng(seed)
    n, steps = int(lots.integers(2, most + 1)), int(lots.integers(8, MAX_STEPS + 1))
    edges = [[int(lots.integers(j)), j] for j in range(1, n)]  # a tree, and some additional edges
    for i, j in lots.integers(n, size=(n // 3, 2)).tolist():
        if i != j and [min(i, j), max(i, j)] not in edges:
            edges.append([min(i, j), max(i, j)])
    degree = np.bincount(np.array(edges).ravel(), minlength=n)
    b = float(0.9 * lots.uniform(0.2, 1) / np.sqrt(8 * degree.max()))
    nodes: dict[int, Raw] = {}
    for i in range(n):
        low, high = allowed_interval(b, int(degree[i])) or (0.5, 0.5)
        candidates = [float(a) for a in lots.uniform(low, high, size=3)]
        nodes[i] = {
            "candidates": candidates,
            "a": candidates[int(lots.integers(3))],
            "x0": float(lots.uniform(-15, 15)),
        }
    faults = [_fault(lots, nodes, edges, steps) for _ in range(int(lots.integers(1, 7)))]
    raw = {"name": f"chaos-{seed}", "b": b, "steps": steps, "seed": seed, "nodes": nodes, "edges": edges}
    raw |= {"defaults": {"disturbance": {"kind": "white", "std": 0.5}}, "faults": faults}
    if lots.random() < 0.5:
        raw["processes"] = int(lots.integers(1, n + 1))
    if lots.random() < 0.2:
        raw["backfill"] = False
    if lots.random() < 0.3:
        raw["history"] = int(lots.integers(1, 6))
    return raw


def _fault(lots: np.random.Generator, nodes: Mapping[int, Raw], edges: list[list[int]], steps: int) -> Raw:
    start = int(lots.integers(steps))
    window: Raw = {"steps": (start, start + int(lots.integers(1, steps)))}
    chance = window | ({"probability": 0.4} if lots.random() < 0.4 else {})
    i, j = edges[int(lots.integers(len(edges)))][:: int(lots.choice([1, -1]))]
    node = int(lots.integers(len(nodes)))
    kinds: list[FaultModel] = [
        Drop(link=(i, j), **chance),
        Drop(from_=i, to=j, **chance),
        Delay(from_=i, to=j, by=int(lots.integers(1, 6)), **chance),
        Cut(edge=(i, j), **chance),
        Partition(groups=((0,), tuple(range(1, len(nodes)))), cut=bool(lots.random() < 0.5), **window),
        Sensor(node=node, **chance),
        Actuator(node=node, **chance),
        Jump(node=node, at=start, a=nodes[node]["candidates"][int(lots.integers(3))]),
        Crash(node=node, at=start, restart_after=int(lots.integers(1, 8))),
        Crash(node=node, at=start, restart_after=int(lots.integers(1, 8))),
        Crash(node=node, at=start),
    ]
    return kinds[int(lots.integers(len(kinds)))].written()


def read(raw: Raw) -> Topology:
    """Return the resolved topology in `raw`; raise TopologyError if it is invalid."""
    return resolve(parse(_json(raw), "chaos", Path()))


def _json(raw: Raw) -> bytes:
    return json.dumps(raw).encode()


def trial(topology: Topology, folder: Path, fork_client: ForkClient) -> str:
    """Run a network over Zenoh; return the problem of the run, or an empty text."""
    options = Options(watching=Watching(record=False), verify=True)
    shards = layout(topology, topology.process_count)
    before = _children()
    network = Network(topology, create(topology, folder), shards, options, Quiet(), fork_client, time.monotonic())
    content = network.run().content
    if network.interrupted:
        raise EndNowError(network.interrupted)
    wrong = [reason for reason in content["reasons"] if "could not fire" not in reason]
    if content["steps_done"] < topology.steps:
        wrong.append(f"{content['steps_done']} of {topology.steps} steps done")
    if content["lost_rows"]:
        wrong.append(f"{content['lost_rows']} rows of telemetry lost")
    if left := _children() - before:
        wrong.append(f"processes left behind: {', '.join(map(str, left))}")
    return "; ".join(wrong)


def _children() -> set[int]:
    return {child.pid for child in psutil.Process().children(recursive=True)}


def smaller(raw: Raw) -> Iterator[Raw]:
    """Yield slightly simpler topologies, the boldest first."""
    faults = raw.get("faults", [])
    for k in range(len(faults)):
        yield {**raw, "faults": faults[:k] + faults[k + 1 :]}
    for node in raw["nodes"]:
        if not any(node in _named(fault) for fault in faults) and len(raw["nodes"]) > 1:
            nodes = {other: own for other, own in raw["nodes"].items() if other != node}
            yield {**raw, "nodes": nodes, "edges": [edge for edge in raw["edges"] if node not in edge]}
    for key in ("processes", "backfill", "history", "defaults"):
        if key in raw:
            yield {other: value for other, value in raw.items() if other != key}
    for steps in (raw["steps"] // 2, raw["steps"] - 1):
        if steps >= 1:
            yield {**raw, "steps": steps}
    for k, fault in enumerate(faults):
        for simpler in _simpler(fault):
            yield {**raw, "faults": [*faults[:k], simpler, *faults[k + 1 :]]}


def _named(fault: Raw) -> set[int]:
    groups = [node for group in fault.get("groups", []) for node in group]
    ends = [*fault.get("link", []), *fault.get("edge", []), *groups]
    return {*ends, *(fault[key] for key in ("from", "to", "node") if key in fault)}


def _simpler(fault: Raw) -> Iterator[Raw]:
    if "probability" in fault:
        yield {key: value for key, value in fault.items() if key != "probability"}
    start, stop = fault.get("steps", (0, 0))
    if stop - start > 1:
        yield {**fault, "steps": [start, start + (stop - start) // 2]}
        yield {**fault, "steps": [start + (stop - start) // 2, stop]}
    if fault.get("restart_after", 1) > 1:
        yield {**fault, "restart_after": 1}


def shrunk(raw: Raw, wrong: str, fails: Callable[[Raw], str]) -> tuple[Raw, str]:
    """Return the smallest topology found that still fails, and its problem."""
    by = time.monotonic() + SHRINK_S
    again = True
    while again and time.monotonic() < by:
        again = False
        for candidate in smaller(raw):
            if time.monotonic() > by:
                break
            try:
                found = fails(candidate)
            except TopologyError:
                continue
            if found:
                raw, wrong, again = candidate, found, True
                break
    return raw, wrong


def hunt(seeds: Iterable[int], most: int, scratch: Path, say: Callable[[str], None]) -> Finding | None:
    """Run one trial per seed until one fails; return that one, reduced, or None."""
    count = itertools.count(1)
    with contextlib.closing(ForkClient()) as fork_client:

        def fails(raw: Raw) -> str:
            return trial(read(raw), scratch / f"{next(count):05}", fork_client)

        for seed in seeds:
            raw = drawn(seed, most)
            wrong = fails(raw)
            say(f"seed {seed}: {_sketch(raw)}: {wrong or 'fine'}")
            if wrong:
                say("making it smaller")
                raw, wrong = shrunk(raw, wrong, fails)
                return Finding(seed, wrong, read(raw))
    return None


def _sketch(raw: Raw) -> str:
    kinds = ", ".join(fault["kind"] for fault in raw["faults"])
    nodes = len(raw["nodes"])
    return f"{count(nodes, 'node')} in {count(raw.get('processes', nodes), 'process', 'es')}, {kinds}"


def write(finding: Finding, path: Path) -> None:
    """Write the topology of a finding to a file, with the problem in its first line."""
    path.write_text(f"# seed {finding.seed}: {finding.wrong}\n{to_yaml(finding.topology)}", encoding="utf-8")
