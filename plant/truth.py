"""All that the plant is told: the true network, its disturbances, and which process runs which node."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

NodeId = int | str


@dataclass(frozen=True)
class Truth:
    """The true network, in plain numbers; every sequence is over nodes in network order unless it says otherwise."""

    ids: Sequence[NodeId]
    b: float
    a: Sequence[float]
    x0: Sequence[float]
    edges: Sequence[tuple[int, int]]
    """Pairs of positions in `ids`."""
    disturbance: Sequence[Sequence[Mapping[str, Any]]]
    """Per node: the components that are summed, as a topology file spells them."""
    steps: int
    seed: int
    shards: Sequence[Sequence[int]]
    """Per agent process: the positions of its nodes."""
    effects: Sequence[Mapping[str, Any]]
    """What goes wrong: topologies.effects.Effect as its `to_dict` writes it."""
    faults: int
    """How many faults there are: that number is the next one's."""
    history: int
    """How many past steps are kept for back-filling, 0 for none."""

    def to_json(self) -> str:
        """The truth as JSON text."""
        return json.dumps(asdict(self))

    @classmethod
    def read(cls, path: Path) -> Truth:
        """The truth in a file that holds `to_json`'s text."""
        return cls(**json.loads(path.read_text(encoding="utf-8")))
