"""The plant's knowledge: the true network, its disturbances, and the nodes of each process."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hedgerow.topologies import archive
from hedgerow.topologies.document import Form, Lists, Named, NodeIds, Numbers, Parts, Ragged, Setting, ragged
from hedgerow.topologies.graph import Array, Gain, Index
from hedgerow.topologies.network import Group, padded


@dataclass(frozen=True, eq=False)
class Truth:
    """The true network, in plain numbers; every array is over nodes in network order unless its docstring differs."""

    ids: NDArray[Any]
    b: Gain
    a: Array
    x0: Array
    edges: Index
    """Pairs of positions in `ids`, (E, 2)."""
    disturbance: Sequence[Group]
    steps: int
    seed: int | NDArray[np.uint64]
    """one, or for networks side by side that of each node, (n,)"""
    shards: Sequence[Index]
    """Per agent process: the positions of its nodes, ascending."""
    effects: Sequence[Mapping[str, Any]]
    """The faults: topologies.effects.Effect as its `to_dict` writes it."""
    faults: int
    """The number of faults; also the number of the next fault."""
    history: int
    """The number of past steps stored for back-filling, 0 for none."""
    weights: Array | None = None
    """Weights of the edges, (E,); None if all are 1."""
    candidates: Array | None = None
    """The values that the command of a jump may give a node, (M, n), padded with NaN; None in a large network."""

    def write(self, path: Path) -> None:
        """Write the truth as the .npz file that `read` reads."""
        _FORM.save(path, self._document())

    @classmethod
    def read(cls, path: Path) -> Truth:
        """Return the truth in a file."""
        with archive.reading(path):
            return cls._of(_FORM.load(path))

    def to_dict(self) -> dict[str, Any]:
        """Return the truth as a dictionary for JSON and TOML."""
        return _FORM.plain(self._document())

    @classmethod
    def from_dict(cls, written: Mapping[str, Any]) -> Truth:
        """Return the truth from a dictionary of `to_dict`; raise KeyError, TypeError or ValueError if it is
        malformed.
        """
        return cls._of(_FORM.read(written))

    def _document(self) -> dict[str, Any]:
        disturbance = [vars(group) for group in self.disturbance]
        listed = None
        if self.candidates is not None:
            known = ~np.isnan(self.candidates.T)
            listed = Ragged(self.candidates.T[known], known.sum(axis=1))
        return {**vars(self), "disturbance": disturbance, "shards": ragged(self.shards), "candidates": listed}

    @classmethod
    def _of(cls, document: Mapping[str, Any]) -> Truth:
        disturbance = [Group(**group) for group in document["disturbance"]]
        # TOML has no null: an effect without a table leaves it out.
        effects = [{"table": None, **effect} for effect in document["effects"]]
        changed = {"disturbance": disturbance, "shards": document["shards"].lists(), "effects": effects}
        if (listed := document.get("candidates")) is not None:
            changed["candidates"] = padded([own.tolist() for own in listed.lists()])
        return cls(**{**document, **changed})


_FLOATS, _INDEX = Numbers(np.float64), Numbers(np.int64)
_FORM = Form(
    b=_FLOATS,
    steps=Setting(),
    seed=Numbers(np.uint64),
    history=Setting(),
    faults=Setting(),
    ids=NodeIds(),
    a=_FLOATS,
    x0=_FLOATS,
    edges=Numbers(np.int64, -1, 2),
    weights=_FLOATS,
    shards=Lists(_INDEX),
    candidates=Lists(_FLOATS),
    disturbance=Parts(Form(number=Setting(), kind=Setting(), nodes=_INDEX, values=Named())),
    effects=Setting(),
)
