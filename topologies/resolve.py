"""Drawing: what a file leaves to chance becomes numbers, and the resolved topology holds them all.

Each kind of draw has a stream of its own, seeded by (seed, what is drawn), and draws for every node in file
order whether the node needs it or not: to pin one node's number changes no other node's.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
import yaml

from topologies.base import Model
from topologies.errors import TopologyError
from topologies.faults import Fault, Jump
from topologies.graph import Array
from topologies.hinf import allowed_interval, smallest_eigenpair
from topologies.rules import broken_faults
from topologies.samples import columns
from topologies.schema import (
    Component,
    Constant,
    Defaults,
    Drawn,
    Node,
    Nothing,
    Samples,
    Topology,
    Uniform,
)
from topologies.source import FLOAT

M = TypeVar("M", bound=Model)


class _Draws:
    """Uniform numbers in [0, 1), one per node, by the name of what is drawn."""

    def __init__(self, seed: int, n: int) -> None:
        self._seed, self._n = seed, n
        self._drawn: dict[str, Array] = {}

    def of(self, what: str, node: int, width: int = 1) -> Array:
        if what not in self._drawn:
            stream = np.random.default_rng([self._seed, zlib.crc32(what.encode())])
            self._drawn[what] = stream.random((self._n, width))
        drawn: Array = self._drawn[what][node]
        return drawn


def resolve(topology: Topology, folder: Path = Path()) -> Topology:
    """The same network with every number drawn and every node spelled out; resolving it again changes nothing.

    `folder` is where the CSV files of `samples` lie. The topology must have passed the rules of `topologies.rules`.
    Raises TopologyError for a fault that breaks them; that of a jump may show only now, with the candidates drawn.
    """
    draws = _Draws(topology.seed, len(topology.ids))
    degree = topology.graph.degree
    tables: dict[str, dict[int | str, list[float]]] = {}
    nodes: dict[int | str, Node] = {}
    for k, node in enumerate(topology.ids):
        settings = topology.settings(node)
        interval = allowed_interval(topology.b, int(degree[k]))
        assert interval is not None, "rules.py refuses a node with no interval"
        candidates, a = _model(settings, interval, draws, k)
        parts = settings.disturbance if isinstance(settings.disturbance, tuple) else (settings.disturbance,)
        resolved: list[Component] = []
        for number, part in enumerate(parts):
            if isinstance(part, Samples) and part.file is not None:
                if part.file not in tables:
                    tables[part.file] = columns(part.file, folder, topology.ids)
                resolved.append(Samples(values=tuple(tables[part.file][node][: topology.steps])))
            elif part is not None:
                resolved.append(_numbers(part, f"disturbance {number}", draws, k))
        x0 = settings.x0
        nodes[node] = Node(
            a=a,
            candidates=candidates,
            x0=_value(x0, "x0", draws, k) if isinstance(x0, Uniform) else x0,
            nominal=settings.nominal,
            disturbance=resolved[0] if len(resolved) == 1 else tuple(resolved),
        )
    drawn = topology.model_copy(update={"nodes": nodes, "defaults": Defaults()})
    if problems := broken_faults(drawn):
        raise TopologyError(topology.name, problems)
    if any(isinstance(fault, Jump) and fault.a == "random" for fault in drawn.faults):
        drawn = drawn.model_copy(update={"faults": _jumps(drawn, draws)})
    return _worst_case(drawn) if topology.disturbance is not None else drawn


def _value(uniform: Uniform, what: str, draws: _Draws, k: int) -> float:
    return uniform.low + (uniform.high - uniform.low) * float(draws.of(what, k)[0])


def _numbers(part: M, what: str, draws: _Draws, k: int) -> M:
    drawn = {
        key: _value(value, f"{what} {key}", draws, k)
        for key in type(part).model_fields
        if isinstance(value := getattr(part, key), Uniform)
    }
    return part.model_copy(update=drawn) if drawn else part


def _model(settings: Node, interval: tuple[float, float], draws: _Draws, k: int) -> tuple[tuple[float, ...], float]:
    """The candidates and the truth; a truth that is given takes the place of one of the drawn candidates."""
    low, high = interval
    pick = float(draws.of("a", k)[0])
    candidates, a = settings.candidates, settings.a
    if isinstance(candidates, Drawn):
        drawn = low + (high - low) * draws.of(f"candidates {candidates.random}", k, candidates.random)
        candidates = tuple(float(value) for value in drawn)
        if isinstance(a, float) and a not in candidates:
            place = int(pick * len(candidates))
            candidates = (*candidates[:place], a, *candidates[place + 1 :])
    assert candidates, "the schema refuses an empty list"
    return candidates, a if isinstance(a, float) else candidates[int(pick * len(candidates))]


def _jumps(topology: Topology, draws: _Draws) -> tuple[Fault, ...]:
    """The faults, with jumps that lead away from the truth until then, where there is another candidate."""
    faults = list(topology.faults)
    position = {node: k for k, node in enumerate(topology.ids)}
    now = {node: own.a for node, own in topology.nodes.items()}
    for at, k in sorted((fault.at, k) for k, fault in enumerate(faults) if isinstance(fault, Jump)):
        jump = cast("Jump", faults[k])
        candidates = cast("tuple[float, ...]", topology.nodes[jump.node].candidates)
        if jump.a == "random":
            others = [a for a in candidates if a != now[jump.node]] or candidates
            pick = float(draws.of(f"jump {at}", position[jump.node])[0])
            faults[k] = jump = jump.model_copy(update={"a": others[int(pick * len(others))]})
        now[jump.node] = jump.a
    return tuple(faults)


def _worst_case(topology: Topology) -> Topology:
    assert topology.disturbance is not None
    _, direction = smallest_eigenpair(truth(topology), topology.b, topology.graph)
    values = np.sqrt(topology.disturbance.energy) * direction
    nodes = {
        node: own.model_copy(update={"disturbance": Constant(value=float(value)) if value else Nothing()})
        for (node, own), value in zip(topology.nodes.items(), values, strict=True)
    }
    return topology.model_copy(update={"nodes": nodes, "disturbance": None})


def truth(topology: Topology) -> Array:
    """The true a of a resolved topology, (n,)."""
    return topology.network.a


def to_yaml(topology: Topology) -> str:
    """A topology as YAML text that `topologies.load` reads back to the same bits."""
    whole = topology.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
    whole["nodes"] = {node: own.model_dump(mode="json", exclude_none=True) for node, own in topology.nodes.items()}
    whole["edges"] = [list(edge) for edge in topology.edges]
    if topology.faults:
        whole["faults"] = [_lines(fault.written()) for fault in topology.faults]
    return yaml.dump(whole, Dumper=_Dumper, sort_keys=False, default_flow_style=None, width=10**6)


@dataclass(frozen=True)
class _Line:
    """What stands on one line of the file, whatever is in it."""

    value: Any


def _lines(fault: dict[str, Any]) -> _Line | dict[str, Any]:
    """A line for a fault, or one for each step of its table."""
    if isinstance(table := fault.get("at"), dict):
        return {**fault, "at": {step: _Line(struck) for step, struck in table.items()}}
    return _Line(fault)


class _Dumper(yaml.CSafeDumper):
    """Without aliases, and with floats that YAML 1.1 readers take for floats too."""

    def ignore_aliases(self, data: object) -> bool:  # noqa: ARG002
        return True


def _float(dumper: yaml.CSafeDumper, value: float) -> yaml.ScalarNode:
    text = repr(value)
    if "e" in text and "." not in text:
        text = text.replace("e", ".0e")
    return dumper.represent_scalar("tag:yaml.org,2002:float", text)


def _line(dumper: yaml.CSafeDumper, line: _Line) -> yaml.Node:
    node = cast("yaml.CollectionNode", dumper.represent_data(line.value))
    node.flow_style = True
    return node


_Dumper.add_representer(float, _float)
_Dumper.add_representer(_Line, _line)
# YAML 1.1 reads `1e5` and `08` as text and leaves them bare; to our reader they are numbers.
_Dumper.add_implicit_resolver("tag:yaml.org,2002:float", FLOAT, list("-+.0123456789"))
