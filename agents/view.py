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
from hedgerow.topologies.document import Form, Lists, NodeIds, Numbers, Ragged, Rows, Setting, ragged
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
    sends: Index
    """indices of our nodes in a message to it, in message order"""
    receives: int
    """number of its nodes in a message to us"""


@dataclass(frozen=True, eq=False)
class View:
    """The knowledge of a shard of k >= 1 nodes: their gains, their edges' weights, the law and the neighbours' shards.

    An incidence is a pair of a node and one of its edges. Incidences are ordered by node, then by neighbour, in network
    order.
    """

    shard: int
    b: float | Array
    """the input gain b of (1), or that of each node, (k,)"""
    law: str
    """the text of a LawChoice; hinf and nominal are minimax with one candidate"""
    ids: Ids
    """ids of our own nodes, (k,)"""
    candidates: Array
    """the models of each node in list order, padded with NaN, (M, k)"""
    row: Index
    """per incidence: the node that it is seen from, (m,)"""
    column: Index
    """per incidence: the index of the neighbour in our own nodes followed by `outside`, (m,)"""
    peers: Sequence[Peer]
    outside: Ids
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
        else:
            _FORM.save(path, self._document(np.arange(self.k + len(self.outside))))

    @classmethod
    def read(cls, path: Path) -> View:
        """Return the view stored in a file."""
        if path.suffix != ".json":
            with archive.reading(path):
                return cls._of(_FORM.load(path), in_words=False)
        written = read_json(path)
        try:
            return cls.from_dict(written)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise UserError(
                f"{path}: is not a local view: {type(error).__name__}. Start the run again.", code=Code.FILE_FORMAT
            ) from None

    def to_json(self) -> str:
        """Return `to_dict` as JSON text."""
        return json.dumps(self.to_dict())

    def to_dict(self) -> dict[str, Any]:
        """Return the view as a dictionary; every node has its candidates and the ids of its neighbours."""
        return _FORM.plain(self._document(np.concatenate([self.ids, self.outside])))

    @classmethod
    def from_dict(cls, written: Mapping[str, Any]) -> View:
        """Return the view from a dictionary of `to_dict`.

        KeyError, TypeError or ValueError if the dictionary is malformed.
        """
        return cls._of(_FORM.read(written), in_words=True)

    def _document(self, names: Ids) -> dict[str, Any]:
        """Return the view as a document; `names` are those of our own nodes, then of `outside`."""
        degrees, listed = np.bincount(self.row, minlength=self.k), ~np.isnan(self.candidates.T)
        sends, receives = ragged([peer.sends for peer in self.peers]), [peer.receives for peer in self.peers]
        return {
            "shard": self.shard,
            "b": self.b,
            "law": self.law,
            "nodes": {
                "id": self.ids,
                "candidates": Ragged(self.candidates.T[listed], listed.sum(axis=1)),
                "neighbours": Ragged(names[self.column], degrees),
                "weights": None if self.weights is None else Ragged(self.weights, degrees),
            },
            "peers": {
                "shard": np.array([peer.shard for peer in self.peers], dtype=np.int64),
                "sends": Ragged(names[sends.values], sends.sizes),
                "receives": Ragged(self.outside, np.array(receives, dtype=np.int64)),
            },
            "history": self.history,
            "seed": self.seed or None,
            "law_source": self.law_source or None,
        }

    @classmethod
    def _of(cls, document: Mapping[str, Any], in_words: bool) -> View:
        """Return the view from its document, with node ids in place of positions if `in_words`."""
        nodes, peers = document["nodes"], document["peers"]
        ids, candidates, neighbours = nodes["id"], nodes["candidates"], nodes["neighbours"]
        weights, sends, receives = nodes.get("weights"), peers["sends"], peers["receives"]
        if weights is not None and not np.array_equal(weights.sizes, neighbours.sizes):
            raise ValueError("the weights are not one per neighbour")
        b = document["b"]
        if isinstance(b, np.ndarray) and b.shape != ids.shape:
            raise ValueError("the gains are not one per node")
        if in_words:
            place = {node: k for k, node in enumerate([*ids.tolist(), *receives.values.tolist()])}
            neighbours, sends = (
                one._replace(values=np.array([place[node] for node in one.values.tolist()], dtype=np.int64))
                for one in (neighbours, sends)
            )
        padded = np.full((candidates.sizes.max(), len(ids)), np.nan)
        padded.T[np.arange(len(padded)) < candidates.sizes[:, None]] = candidates.values
        return cls(
            shard=document["shard"],
            b=b,
            law=document["law"],
            ids=ids,
            candidates=padded,
            row=np.repeat(np.arange(len(ids)), neighbours.sizes),
            column=neighbours.values,
            weights=None if weights is None else weights.values,
            peers=[
                Peer(*one) for one in zip(peers["shard"].tolist(), sends.lists(), receives.sizes.tolist(), strict=True)
            ],
            outside=receives.values,
            history=document["history"],
            seed=document.get("seed", 0),
            law_source=document.get("law_source", ""),
        )


_IDS = Lists(NodeIds())
_FORM = Form(
    shard=Setting(),
    b=Numbers(np.float64),
    law=Setting(),
    nodes=Rows(
        id=NodeIds(), candidates=Lists(Numbers(np.float64)), neighbours=_IDS, weights=Lists(Numbers(np.float64))
    ),
    peers=Rows(shard=Numbers(np.int64), sends=_IDS, receives=_IDS),
    history=Setting(),
    seed=Setting(),
    law_source=Setting(),
)
