"""The local view: all that one agent process is told of the network, and nothing else."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

NodeId = int | str


@dataclass(frozen=True)
class NodeView:
    """One node of the shard: its id, its candidate models in list order, its neighbours in network order."""

    id: NodeId
    candidates: Sequence[float]
    neighbours: Sequence[NodeId]


@dataclass(frozen=True)
class Peer:
    """Another shard with neighbours of ours: `say`, our nodes in a message to it; `hear`, its nodes in one to us."""

    shard: int
    say: Sequence[NodeId]
    hear: Sequence[NodeId]


@dataclass(frozen=True)
class View:
    """What a shard of k >= 1 nodes knows: the gain b of (1), its law, its own nodes, and where its neighbours are.

    `law` is `minimax`, or `package.module:Class` for another; hinf and nominal are minimax with one candidate.
    """

    shard: int
    b: float
    law: str
    nodes: Sequence[NodeView]
    peers: Sequence[Peer]
    history: int
    """how many past steps are kept for back-filling, 0 for none: then what was missed stays missed"""

    def to_json(self) -> str:
        """The view as JSON text."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> View:
        """The view that `to_json` wrote."""
        raw = json.loads(text)
        raw["nodes"] = [NodeView(**node) for node in raw["nodes"]]
        raw["peers"] = [Peer(**peer) for peer in raw["peers"]]
        return cls(**raw)

    @classmethod
    def read(cls, path: Path) -> View:
        """The view in a file."""
        return cls.from_json(path.read_text(encoding="utf-8"))
