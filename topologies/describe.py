"""A fault in words, and things with their number."""

from __future__ import annotations

from hedgerow.topologies.effects import FOREVER
from hedgerow.topologies.faults import Fault


def describe(fault: Fault) -> str:
    """Return a fault in a few words: its kind, its targets, and its steps."""
    start, stop = fault.window
    chance = getattr(fault, "probability", 1.0)
    what = f"{fault.kind} {fault.struck}" + (f" with probability {chance:g}" if chance != 1.0 else "")
    if (start, stop) == (0, FOREVER):
        return f"{what} at every step"
    return f"{what} from step {start}" + (f" to {stop}" if stop < FOREVER else "")


def count(number: int, thing: str, plural: str = "s") -> str:
    """Return a number of things, in words."""
    return f"{number} {thing}{plural if number != 1 else ''}"
