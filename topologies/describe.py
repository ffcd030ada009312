"""A fault in words, and the steps when it is active."""

from __future__ import annotations

from hedgerow.topologies.effects import FOREVER
from hedgerow.topologies.faults import Actuator, Crash, Cut, Delay, Drop, Fault, Jump, Partition, Sensor


def describe(fault: Fault) -> str:
    """Return a fault in a few words: its kind, its targets, and its steps."""
    start, stop = window(fault)
    if (start, stop) == (0, FOREVER):
        return f"{_what(fault)} at every step"
    return f"{_what(fault)} from step {start}" + (f" to {stop}" if stop < FOREVER else "")


def window(fault: Fault) -> tuple[int, int]:
    """Return the first step of a fault, and the first step after it."""
    match fault:
        case Drop(at=dict() as table) | Cut(at=dict() as table):
            return min(table), max(table) + 1
        case Crash():
            return fault.at, FOREVER if fault.restart_after is None else fault.at + fault.restart_after
        case Jump():
            return fault.at, FOREVER
        case _:
            return fault.steps or (0, FOREVER)


def _what(fault: Fault) -> str:
    match fault:
        case Drop(at=dict() as table) | Cut(at=dict() as table):
            struck = f"of {sum(map(len, table.values()))} by a table"
        case Drop(link=(i, j)) | Delay(link=(i, j)) | Cut(edge=(i, j)):
            struck = f"{i}-{j}"
        case Drop() | Delay():
            struck = f"{fault.from_}->{fault.to}"
        case Partition():
            struck = "/".join(",".join(map(str, group)) for group in fault.groups)
            struck += " with its edges" if fault.cut else ""
        case Crash(process=int() as process):
            struck = f"process {process}"
        case Jump():
            struck = f"{fault.node} to {fault.a}"
        case Sensor() | Actuator() | Crash():
            struck = f"{fault.node}"
    late = f" by {fault.by}" if isinstance(fault, Delay) else ""
    chance = getattr(fault, "probability", 1.0)
    return f"{fault.kind} {struck}{late}" + (f" with probability {chance:g}" if chance != 1.0 else "")


def count(number: int, thing: str, plural: str = "s") -> str:
    """Return a number of things, in words."""
    return f"{number} {thing}{plural if number != 1 else ''}"
