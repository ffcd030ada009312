"""The nodes and edges of a network in columns, with the same interface as the mappings of a file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, overload

import numpy as np

from hedgerow.topologies.disturbances import COMPONENTS, Component, Nothing
from hedgerow.topologies.edges import Edge, Ends
from hedgerow.topologies.network import Group, Network
from hedgerow.topologies.settings import Node

SPELLED_OUT = 1_000
"""Up to this number of nodes, a resolved file lists each of them; more nodes are in a table beside it."""

NodeId = int | str


class Nodes(Mapping[NodeId, Node]):
    """The mapping from ids to settings; a node is made on request."""

    def __init__(self, network: Network) -> None:
        self._network = network
        ids = network.ids
        self._position = ids if isinstance(ids, range) else {node: k for k, node in enumerate(ids)}

    def __len__(self) -> int:
        return len(self._network.ids)

    def __iter__(self) -> Iterator[NodeId]:
        return iter(self._network.ids)

    def __contains__(self, node: object) -> bool:
        if isinstance(self._position, range):
            return isinstance(node, int) and node in self._position
        return node in self._position

    def __getitem__(self, node: NodeId) -> Node:
        if node not in self:
            raise KeyError(node)
        k = int(node) if isinstance(self._position, range) else self._position[node]
        network = self._network
        listed = network.candidates[:, k]
        parts: list[Component] = [Nothing() for _ in range(int(network.parts[k]))]
        for group in network.disturbance:
            row = int(np.searchsorted(group.nodes, k))
            if row < len(group.nodes) and group.nodes[row] == k:
                parts[group.number] = _component(group, row)
        return Node(
            b=None if isinstance(network.b, float) else float(network.b[k]),
            a=float(network.a[k]),
            candidates=tuple(listed[~np.isnan(listed)].tolist()),
            x0=float(network.x0[k]),
            nominal=float(network.nominal[k]),
            disturbance=parts[0] if len(parts) == 1 else tuple(parts),
            label=(network.labels[k] or None) if network.labels is not None else None,
            position=self._place(k),
        )

    def _place(self, k: int) -> tuple[float, float] | None:
        positions = self._network.positions
        if positions is None or np.isnan(positions[k, 0]):
            return None
        return float(positions[k, 0]), float(positions[k, 1])


def _component(group: Group, row: int) -> Component:
    values: dict[str, Any] = {key: column[row].tolist() for key, column in group.values.items()}
    return COMPONENTS[group.kind](**values)


class Pairs(Sequence[Ends]):
    """Pairs of ids, in the order of `Graph.edges`."""

    def __init__(self, network: Network) -> None:
        self._network = network

    def __len__(self) -> int:
        return len(self._network.graph.edges)

    @overload
    def __getitem__(self, k: int) -> Ends: ...

    @overload
    def __getitem__(self, k: slice) -> list[Ends]: ...

    def __getitem__(self, k: int | slice) -> Ends | list[Ends]:
        ids = self._network.ids
        pairs = self._network.graph.edges[k].tolist()
        return [(ids[i], ids[j]) for i, j in pairs] if isinstance(k, slice) else (ids[pairs[0]], ids[pairs[1]])

    def __iter__(self) -> Iterator[Ends]:
        ids = self._network.ids
        return ((ids[i], ids[j]) for i, j in self._network.graph.edges.tolist())

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sequence) and tuple(self) == tuple(other)

    __hash__ = None  # type: ignore[assignment]  # as of a list


class Edges(Sequence[Ends | Edge]):
    """The edges as a file writes them, in the order of `Graph.edges`: a pair, or an `Edge` if its weight is not 1."""

    def __init__(self, network: Network) -> None:
        self.pairs = Pairs(network)
        """the ends alone"""
        self._weights = network.graph.weights

    def __len__(self) -> int:
        return len(self.pairs)

    @overload
    def __getitem__(self, k: int) -> Ends | Edge: ...

    @overload
    def __getitem__(self, k: slice) -> list[Ends | Edge]: ...

    def __getitem__(self, k: int | slice) -> Ends | Edge | list[Ends | Edge]:
        if isinstance(k, slice):
            return [self[place] for place in range(*k.indices(len(self)))]
        return _written(self.pairs[k], 1.0 if self._weights is None else float(self._weights[k]))

    def __iter__(self) -> Iterator[Ends | Edge]:
        if self._weights is None:
            return iter(self.pairs)
        return map(_written, self.pairs, self._weights.tolist())

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sequence) and tuple(self) == tuple(other)

    __hash__ = None  # type: ignore[assignment]  # as of a list


def _written(ends: Ends, weight: float) -> Ends | Edge:
    return ends if weight == 1 else Edge(ends=ends, weight=weight)
