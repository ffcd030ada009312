"""The key expressions of one run, relative to its namespace (docs/wire.md)."""

from __future__ import annotations

from urllib.parse import quote

TELEMETRY = "telemetry"
SEEN = "seen"
ALIVE = "alive/**"
PLANT = "plant"
ROOM = "room"
"""The token of a process that is about to start a plant: no other plant may start."""
COMMANDS = ("status", "stop", "pause", "resume", "step", "rate", "fault", "heal", "died")
"""what a plant can be asked; `died` is for `up` alone"""


def chunk(text: str) -> str:
    """Return any text as one chunk of a key expression, another for each text; letters, digits, `-_.~` stay."""
    return quote(text.encode("utf-8", "surrogatepass"), safe="")


def state(shard: int) -> str:
    """Plant to shard: its states, which edges were open, which links are up."""
    return f"state/{shard}"


def input_(shard: int) -> str:
    """Shard to plant: its inputs, and what it reports about itself."""
    return f"input/{shard}"


def link(sender: int, receiver: int) -> str:
    """Shard to shard: state and input of the sender's nodes that have a neighbour there."""
    return f"link/{sender}/{receiver}"


def control(command: str) -> str:
    """Anybody to plant, a query: one of the commands of plant/control.py."""
    return f"control/{command}"


def join(who: int | str) -> str:
    """A process that nobody forked to plant, a query: may it take part? `who` is its shard, or `observer`."""
    return control(f"join/{who}")


def alive(name: str, life: int | str = 0, plant: int = -1) -> str:
    """The liveliness token of a process that is ready; who is started again says so in its next life, `*` for any.

    `plant` is the number of the plant that gave it its place, if it asked one.
    """
    return f"alive/{name}/{life}" + ("" if plant < 0 else f"-{plant}")


def shard_name(shard: int) -> str:
    """What the process of a shard is called in tokens, logs and messages."""
    return f"shard-{shard}"
