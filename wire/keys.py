"""The key expressions of one run, relative to its namespace (docs/wire.md)."""

from __future__ import annotations

from urllib.parse import quote

TELEMETRY = "telemetry"
SEEN = "seen"
ALIVE = "alive/**"
PLANT = "plant"
ROOM = "room"
"""The token of a process that is about to start a plant. No other plant may start while it is there."""
COMMANDS = ("status", "stop", "pause", "resume", "step", "rate", "fault", "heal", "died")
"""the commands that a plant answers; `died` is for `up` alone"""


def chunk(text: str) -> str:
    """Return a text as one chunk of a key expression, unique for each text; letters, digits and `-_.~` stay."""
    return quote(text.encode("utf-8", "surrogatepass"), safe="")


def state(shard: int) -> str:
    """Return the key from the plant to a shard: its states, the open edges, the links that are up."""
    return f"state/{shard}"


def input_(shard: int) -> str:
    """Return the key from a shard to the plant: its inputs, and its report."""
    return f"input/{shard}"


def link(sender: int, receiver: int) -> str:
    """Return the key from shard to shard: state and input of the sender's nodes that have a neighbour there."""
    return f"link/{sender}/{receiver}"


def control(command: str) -> str:
    """Return the key of a query to the plant: one of the commands of plant/control.py."""
    return f"control/{command}"


def join(who: int | str) -> str:
    """Return the key of a query from a separate process to the plant to join the run; `who` is its shard, or
    `observer`.
    """
    return control(f"join/{who}")


def alive(name: str, life: int | str = 0, plant: int = -1) -> str:
    """Return the key of the liveliness token of a process that is ready. `life` counts its restarts; `*` matches any.

    `plant` is the number of the plant that gave it its place, if it asked one.
    """
    return f"alive/{name}/{life}" + ("" if plant < 0 else f"-{plant}")


def shard_name(shard: int) -> str:
    """Return the name of the process of a shard in tokens, logs and messages."""
    return f"shard-{shard}"
