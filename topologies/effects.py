"""Faults as plain numbers for the plant, without pydantic and without node ids."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

FOREVER = 2**62
"""A step that no run reaches: the end of a fault without an end."""
INCIDENCES, EDGES, NODES = "incidences", "edges", "nodes"


class EffectKind(NamedTuple):
    """The properties of a kind of effect."""

    of: str
    """The meaning of its targets. Incidence c is the link to node[c] from neighbour[c]."""
    strikes: str
    """The thing that it takes away or changes: a field of `plant.faults.ActiveFaults`, "absent" or "truth"."""


EFFECT_KINDS: Mapping[str, EffectKind] = {
    "drop": EffectKind(INCIDENCES, "lost"),
    "delay": EffectKind(INCIDENCES, "late"),
    "cut": EffectKind(EDGES, "cut"),
    "sensor": EffectKind(NODES, "blind"),
    "actuator": EffectKind(NODES, "mute"),
    "crash": EffectKind(NODES, "absent"),
    "jump": EffectKind(NODES, "truth"),
}
"""Only this table and `topologies.fault_kinds` name the kinds; all other code asks an effect for its properties."""


@dataclass(frozen=True)
class Effect:
    """The effect of one fault of the list, at steps `start` <= t < `stop`.

    A crash starts when the nodes fail and stops when they return; a jump never stops.
    """

    fault: int
    """The position of the fault in `faults:`, from 0; a partition that cuts has two effects."""
    kind: str
    targets: Sequence[int]
    start: int
    stop: int
    probability: float = 1.0
    """The probability at each step, independent for each target."""
    by: int = 0
    """The delay of a message, in steps."""
    a: float = 0.0
    """The true a after a jump."""
    table: Mapping[int, Sequence[int]] | None = None
    """Targets by step, in place of `targets` at every step."""

    @property
    def of(self) -> str:
        """Return the meaning of its targets: positions of INCIDENCES, EDGES or NODES in the graph."""
        return EFFECT_KINDS[self.kind].of

    @property
    def strikes(self) -> str:
        """Return the thing that it takes away or changes, as in EffectKind."""
        return EFFECT_KINDS[self.kind].strikes

    @property
    def removes_agents(self) -> bool:
        """Return True if its targets have no agent while it lasts."""
        return self.strikes == "absent"

    @property
    def changes_truth(self) -> bool:
        """Return True if its target has another true a from `start` on."""
        return self.strikes == "truth"

    @property
    def counts_once(self) -> bool:
        """Return True if the effect occurs once per target, at `start`; otherwise it occurs at every step."""
        return self.removes_agents or self.changes_truth

    @property
    def lossy(self) -> bool:
        """Return True if a reading, a message, an input or a flow can be missing."""
        return not self.changes_truth

    def to_dict(self) -> dict[str, Any]:
        """Return the effect as a dictionary for JSON."""
        steps = None if self.table is None else {str(step): list(struck) for step, struck in self.table.items()}
        return {**asdict(self), "targets": list(self.targets), "table": steps}

    @classmethod
    def from_dict(cls, written: Mapping[str, Any]) -> Effect:
        """Return the effect from a dictionary of `to_dict`, also after JSON."""
        steps = written["table"]
        table = None if steps is None else {int(step): tuple(struck) for step, struck in steps.items()}
        return cls(**{**written, "targets": tuple(written["targets"]), "table": table})
