"""The local view: the only part of the network that one agent process knows."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hedgerow.topologies import archive
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.json_file import read_json

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Ids = NDArray[Any]
"""Node ids: int64, or objects where some are names."""


@dataclass(frozen=True, eq=False)
class Peer:
    """Another shard that contains neighbours of our nodes."""

    shard: int
    say: Index
    """indices of our nodes in a message to it, in message order"""
    hear: int
    """number of its nodes in a message to us"""


@dataclass(frozen=True, eq=False)
class View:
    """The knowledge of a shard of k >= 1 nodes: their gains, their edges' weights, the law and the neighbours' shards.

    An incidence is a pair of a node and one of its edges. Incidences are ordered by node, then by neighbour, in network
    order.
    """

    shard: int
    b: float | Array
    """the gain b of (1), or that of each node, (k,)"""
    law: str
    """the text of a LawChoice; hinf and nominal are minimax with one candidate"""
    ids: Ids
    """ids of our own nodes, (k,)"""
    candidates: Array
    """the models of each node in list order, padded with NaN, (M, k)"""
    row: Index
    """per incidence: the node that it is seen from, (m,)"""
    column: Index
    """per incidence: the index of the neighbour in our own nodes followed by `heard`, (m,)"""
    peers: Sequence[Peer]
    heard: Ids
    """ids of the neighbours in other shards, peer by peer"""
    history: int
    """number of past steps kept for back-filling; with 0, missed samples are never learned"""
    seed: int | NDArray[np.uint64] = 0
    """the seed of laws that draw numbers, a function of the run's seed; for networks side by side: per node, (k,)"""
    weights: Array | None = None
    """per incidence: the weight of its edge, (m,); None if all are 1"""
    law_source: str = ""
    """the digest of a user's law; the process compares it with its own source. Empty for laws of the project."""

    @property
    def k(self) -> int:
        """Return the number of nodes."""
        return len(self.ids)

    def write(self, path: Path) -> None:
        """Write the view as the file that `read` reads: JSON if the name ends with .json, else .npz."""
        if path.suffix == ".json":
            path.write_text(self.to_json(), encoding="utf-8")
            return
        settings: dict[str, Any] = {
            "shard": self.shard,
            "law": self.law,
            "history": self.history,
            "seed": self.seed,
            "law_source": self.law_source,
        }
        peers = [(peer.shard, len(peer.say), peer.hear) for peer in self.peers]
        say = [peer.say for peer in self.peers]
        arrays = {
            "ids": self.ids,
            "candidates": self.candidates,
            "row": self.row,
            "column": self.column,
            "peers": np.array(peers, dtype=np.int64).reshape(-1, 3),
            "say": np.concatenate(say) if say else np.empty(0, dtype=np.int64),
            "heard": self.heard,
        }
        if isinstance(self.b, float):
            settings["b"] = self.b
        else:
            arrays["b"] = self.b
        if self.weights is not None:
            arrays["weights"] = self.weights
        archive.write(path, settings, arrays)

    @classmethod
    def read(cls, path: Path) -> View:
        """Return the view stored in a file."""
        if path.suffix == ".json":
            told = read_json(path)
            try:
                return cls.from_dict(told)
            except (KeyError, TypeError, ValueError, AttributeError) as error:
                raise UserError(
                    f"{path}: is not a local view: {type(error).__name__}. Start the run again.", code=Code.FILE_FORMAT
                ) from None
        settings, arrays = archive.read(path)
        with archive.reading(path):
            shards, says, hears = arrays.pop("peers").T
            say = np.split(arrays.pop("say"), np.cumsum(says)[:-1])
            peers = [Peer(int(q), own, int(n)) for q, own, n in zip(shards, say, hears, strict=False)]
            return cls(**settings, **arrays, peers=peers)

    def to_json(self) -> str:
        """Return `to_dict` as JSON text."""
        return json.dumps(self.to_dict())

    def to_dict(self) -> dict[str, Any]:
        """Return the view as a dictionary; every node has its candidates and the ids of its neighbours."""
        own, heard = self.ids.tolist(), self.heard.tolist()
        known = own + heard
        neighbours: list[list[Any]] = [[] for _ in own]
        for i, j in zip(self.row.tolist(), self.column.tolist(), strict=True):
            neighbours[i].append(known[j])
        nodes: list[dict[str, Any]] = [
            {"id": node, "candidates": column[~np.isnan(column)].tolist(), "neighbours": beside}
            for node, column, beside in zip(own, self.candidates.T, neighbours, strict=True)
        ]
        if self.weights is not None:
            for i, node in enumerate(nodes):
                node["weights"] = self.weights[self.row == i].tolist()
        ends = np.cumsum([peer.hear for peer in self.peers], dtype=np.int64)
        peers = [
            {"shard": peer.shard, "say": [own[i] for i in peer.say.tolist()], "hear": heard[end - peer.hear : end]}
            for peer, end in zip(self.peers, ends.tolist(), strict=True)
        ]
        b = self.b if isinstance(self.b, float) else self.b.tolist()
        told = {"shard": self.shard, "b": b, "law": self.law, "nodes": nodes, "peers": peers}
        more = {"seed": self.seed, "law_source": self.law_source}
        return {**told, "history": self.history, **{key: value for key, value in more.items() if value}}

    @classmethod
    def from_dict(cls, told: Mapping[str, Any]) -> View:
        """Return the view from a dictionary of `to_dict`.

        KeyError, TypeError or ValueError if the dictionary is malformed.
        """
        nodes = told["nodes"]
        own, heard = [node["id"] for node in nodes], [j for peer in told["peers"] for j in peer["hear"]]
        place = {node: k for k, node in enumerate(own + heard)}
        lists = [np.array(node["candidates"], dtype=np.float64) for node in nodes]
        candidates = np.full((max(map(len, lists)), len(own)), np.nan)
        for column, listed in zip(candidates.T, lists, strict=True):
            column[: len(listed)] = listed
        incidences = [(i, place[j]) for i, node in enumerate(nodes) for j in node["neighbours"]]
        row, column = np.array(incidences, dtype=np.int64).reshape(-1, 2).T.copy()
        weights = None
        if any("weights" in node for node in nodes):
            listed_weights = [weight for node in nodes for weight in node["weights"]]
            weights = np.array(listed_weights, dtype=np.float64)
            if len(weights) != len(row):
                raise ValueError("the weights are not one per neighbour")
        b = np.array(told["b"], dtype=np.float64) if isinstance(told["b"], list) else told["b"]
        if isinstance(b, np.ndarray) and b.shape != (len(own),):
            raise ValueError("the gains are not one per node")
        peers = [
            Peer(peer["shard"], np.array([place[i] for i in peer["say"]], dtype=np.int64), len(peer["hear"]))
            for peer in told["peers"]
        ]
        return cls(
            shard=told["shard"],
            b=b,
            law=told["law"],
            ids=archive.id_array(own),
            candidates=candidates,
            row=row,
            column=column,
            weights=weights,
            peers=peers,
            heard=archive.id_array(heard),
            history=told["history"],
            seed=told.get("seed", 0),
            law_source=told.get("law_source", ""),
        )
