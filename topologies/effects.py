"""Faults in plain numbers: what the plant reads of them, with neither pydantic nor node ids in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

FOREVER = 2**62
"""A step that no run reaches: where a fault without an end stops."""


@dataclass(frozen=True)
class Effect:
    """What one fault of the list does, at steps `start` <= t < `stop`.

    `kind` says what its `targets` are: incidences of `hedgerow.topologies.graph.Graph` for drop and delay (c stands for
    the link on which node[c] hears neighbour[c]), edges for cut, positions of nodes for sensor, actuator, crash
    and jump. A crash starts when the nodes die and stops when they are back; a jump never stops.
    """

    fault: int
    """Its position in `faults:`, from 0; a partition that cuts has two effects."""
    kind: str
    targets: Sequence[int]
    start: int
    stop: int
    probability: float = 1.0
    """At each step, of each target on its own."""
    by: int = 0
    """How many steps a delayed message is late."""
    a: float = 0.0
    """The truth after a jump."""
    table: Mapping[int, Sequence[int]] | None = None
    """Targets by step, in place of `targets` at every step."""

    def to_dict(self) -> dict[str, Any]:
        """As JSON holds it."""
        steps = None if self.table is None else {str(step): list(struck) for step, struck in self.table.items()}
        return {**asdict(self), "targets": list(self.targets), "table": steps}

    @classmethod
    def from_dict(cls, written: Mapping[str, Any]) -> Effect:
        """The effect that `to_dict` wrote, from JSON or not."""
        steps = written["table"]
        table = None if steps is None else {int(step): tuple(struck) for step, struck in steps.items()}
        return cls(**{**written, "targets": tuple(written["targets"]), "table": table})
