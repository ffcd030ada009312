"""Changes of the fault list during a run.

The resolved file contains added and ended faults as if they had been there from the start, so the run can be repeated
from its folder.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError

from hedgerow.topologies.effects import FOREVER
from hedgerow.topologies.errors import HedgerowError
from hedgerow.topologies.faults import Crash, Fault, Jump, effects
from hedgerow.topologies.partition import layout_of
from hedgerow.topologies.rules import broken_faults
from hedgerow.topologies.schema import Topology


def with_fault(topology: Topology, entry: Mapping[str, Any]) -> Topology:
    """Return the topology with one more fault, as a file spells it; raise HedgerowError if it does not fit the network.

    `Live` has checked it before, but any process that reaches the plant can send a request.
    """
    try:
        more = _with(topology, entry)
    except ValidationError:
        raise HedgerowError(f"the plant was given a fault that no file spells: {str(entry)[:200]!a}") from None
    new = more.faults[-1]
    problems = broken_faults(topology.model_copy(update={"faults": (new,)}))
    if problems or (isinstance(new, Jump) and not isinstance(new.a, float)):
        raise HedgerowError(f"the plant was given a fault that is none of this network: {str(entry)[:200]!a}")
    return more


def _with(topology: Topology, entry: Mapping[str, Any]) -> Topology:
    (fault,) = Topology.model_validate({**_LEAST, "faults": [entry]}).faults
    return topology.model_copy(update={"faults": (*topology.faults, fault)})


_LEAST = {"name": "one", "b": 0.1, "steps": 1, "nodes": [0]}
"""The smallest topology: it gives a fault its type; the names in the fault were checked before."""


def changes_before(step: int, one: Topology, other: Topology) -> bool:
    """Return True if the faults of two topologies differ in their effects before a step."""
    return _effects_before(step, one) != _effects_before(step, other)


def _effects_before(step: int, topology: Topology) -> list[tuple[Any, ...]]:
    found = []
    for one in effects(topology.faults, topology) if topology.faults else []:
        if one.start < step:
            table = {t: tuple(struck) for t, struck in (one.table or {}).items() if t < step}
            drawn = (one.probability, one.by, one.a)
            found.append((one.fault, one.kind, tuple(one.targets), one.start, min(one.stop, step), drawn, table))
    return found


def with_loss(topology: Topology, shard: int, nodes: list[int | str], at: int) -> Topology:
    """Return the topology with the crash fault that the loss of an agent process at a step means."""
    who = {"process": shard} if isinstance(topology.processes, int) else {"node": nodes[0]}
    if "process" in who and topology.layout is None:
        topology = topology.model_copy(update={"layout": layout_of(topology.graph, topology.process_count)})
    return _with(topology, {"kind": "crash", **who, "at": at})


def with_end(topology: Topology, number: int, at: int) -> Topology:
    """Return the topology with the end of a fault (`number`, from 0) at step `at`, after its begin.

    Raise HedgerowError for a fault that cannot end there.
    """
    faults = list(topology.faults)
    written = {} if isinstance(faults[number], Jump) else _ended(faults[number], at).written()
    try:
        (faults[number],) = _with(topology.model_copy(update={"faults": ()}), written).faults
    except ValidationError:
        raise HedgerowError(f"fault {number + 1} cannot end at step {at}") from None
    return topology.model_copy(update={"faults": tuple(faults)})


def _ended(fault: Fault, at: int) -> Fault:
    if isinstance(fault, Crash):
        return fault.model_copy(update={"restart_after": at - fault.at})
    table = getattr(fault, "at", None)
    if isinstance(table, Mapping):
        return fault.model_copy(update={"at": {step: pairs for step, pairs in table.items() if step < at}})
    start, stop = getattr(fault, "steps", None) or (0, FOREVER)
    return fault.model_copy(update={"steps": (start, min(stop, at))})
