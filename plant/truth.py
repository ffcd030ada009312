"""The plant's knowledge: the true network, its disturbances, and the nodes of each process."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hedgerow.topologies import archive
from hedgerow.topologies.graph import Array, Gain, Index
from hedgerow.topologies.network import Group


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

    def write(self, path: Path) -> None:
        """Write the truth as the .npz file that `read` reads."""
        settings = {name: getattr(self, name) for name in ("steps", "seed", "effects", "faults", "history")}
        arrays = {
            "ids": self.ids,
            "a": self.a,
            "x0": self.x0,
            "edges": self.edges,
            "nodes": np.concatenate(self.shards),
            "sizes": np.array([len(nodes) for nodes in self.shards]),
        }
        if isinstance(self.b, float):
            settings["b"] = self.b
        else:
            arrays["b"] = self.b
        if self.weights is not None:
            arrays["weights"] = self.weights
        for g, group in enumerate(self.disturbance):
            arrays[f"w{g}"] = group.nodes
            arrays |= {f"w{g} {key}": value for key, value in group.values.items()}
        groups = [(group.number, group.kind, list(group.values)) for group in self.disturbance]
        archive.write(path, settings | {"groups": groups}, arrays)

    @classmethod
    def read(cls, path: Path) -> Truth:
        """Return the truth in a file."""
        settings, arrays = archive.read(path)
        with archive.reading(path):
            groups = [
                Group(number, kind, arrays.pop(f"w{g}"), {key: arrays.pop(f"w{g} {key}") for key in keys})
                for g, (number, kind, keys) in enumerate(settings.pop("groups"))
            ]
            shards = np.split(arrays.pop("nodes"), np.cumsum(arrays.pop("sizes"))[:-1])
            return cls(**settings, **arrays, disturbance=groups, shards=shards)

    def to_dict(self) -> dict[str, Any]:
        """Return the truth as a dictionary for JSON and TOML."""
        disturbance = [
            {"number": group.number, "kind": group.kind, "nodes": group.nodes.tolist()}
            | {"values": {key: value.tolist() for key, value in group.values.items()}}
            for group in self.disturbance
        ]
        return {
            "b": self.b if isinstance(self.b, float) else self.b.tolist(),
            "steps": self.steps,
            "seed": self.seed,
            "history": self.history,
            "faults": self.faults,
            "ids": self.ids.tolist(),
            "a": self.a.tolist(),
            "x0": self.x0.tolist(),
            "edges": self.edges.tolist(),
            **({} if self.weights is None else {"weights": self.weights.tolist()}),
            "shards": [nodes.tolist() for nodes in self.shards],
            "disturbance": disturbance,
            "effects": list(self.effects),
        }

    @classmethod
    def from_dict(cls, told: Mapping[str, Any]) -> Truth:
        """Return the truth from a dictionary of `to_dict`; raise KeyError, TypeError or ValueError if it is
        malformed.
        """
        disturbance = [
            Group(
                group["number"],
                group["kind"],
                np.array(group["nodes"], dtype=np.int64),
                {key: np.array(value) for key, value in group["values"].items()},
            )
            for group in told["disturbance"]
        ]
        return cls(
            ids=archive.id_array(told["ids"]),
            b=np.array(told["b"], dtype=np.float64) if isinstance(told["b"], list) else told["b"],
            a=np.array(told["a"], dtype=np.float64),
            x0=np.array(told["x0"], dtype=np.float64),
            edges=np.array(told["edges"], dtype=np.int64).reshape(-1, 2),
            weights=np.array(told["weights"], dtype=np.float64) if "weights" in told else None,
            disturbance=disturbance,
            steps=told["steps"],
            seed=told["seed"],
            shards=[np.array(nodes, dtype=np.int64) for nodes in told["shards"]],
            effects=[{"table": None, **effect} for effect in told["effects"]],
            faults=told["faults"],
            history=told["history"],
        )
