"""networkx graphs, and the files that networkx reads: GraphML, GML, GEXF, Pajek, node-link JSON."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Hashable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hedgerow.topologies.importing.found import Found, pairs, places, refuse, storage_of, weights_of
from hedgerow.topologies.importing.options import Options
from hedgerow.topologies.regular_file import read_regular

if TYPE_CHECKING:
    import networkx as nx

GROWTH = 60
"""the memory per byte of a file: networkx holds a dictionary for each node and edge"""
_LABELS = ("label", "Label", "name", "Name")
_PLACES = (("x", "y"), ("Longitude", "Latitude"), ("longitude", "latitude"), ("lon", "lat"), ("lng", "lat"))


def read(path: Path, options: Options, kind: str) -> Found:
    """Return the graph in a file of the kind graphml, gml, gexf, pajek, node-link, or edgelist with attributes."""
    import networkx as nx  # noqa: PLC0415 (a third of a second)

    data = read_regular(path, growth=GROWTH)
    readers: dict[str, Callable[[], Any]] = {
        "graphml": lambda: nx.read_graphml(io.BytesIO(data)),
        "gml": lambda: _gml(data),
        "gexf": lambda: nx.read_gexf(io.BytesIO(data)),
        "pajek": lambda: nx.parse_pajek(data.decode()),
        "edgelist": lambda: nx.parse_edgelist(data.decode("utf-8-sig").splitlines(), data=True),
        "node-link": lambda: _node_link(json.loads(data)),
    }
    try:
        graph = readers[kind]()
    except Exception as error:  # each reader of networkx passes on the errors of its parser
        text = str(error).strip("\"'\n") or type(error).__name__
        raise refuse(path, f"is no {kind} file that networkx can read: {text[:200]}", "Check its format") from None
    return of_networkx(graph, options, str(path))


def _gml(data: bytes) -> Any:
    import networkx as nx  # noqa: PLC0415

    lines = data.decode("utf-8").splitlines()
    try:
        return nx.parse_gml(lines)
    except nx.NetworkXError as error:
        # By default, labels are the names of nodes, but a file may have none or repeat one.
        if "label" not in str(error):
            raise
        return nx.parse_gml(lines, label="id")


def _node_link(content: Any) -> Any:
    import networkx as nx  # noqa: PLC0415

    if not isinstance(content, dict) or "nodes" not in content:
        raise ValueError("a node-link file is an object with `nodes` and `links`")
    return nx.node_link_graph(content, edges="edges" if "edges" in content else "links")


def of_networkx(graph: nx.Graph[Any], options: Options, source: str) -> Found:
    """Return a networkx graph of any class as found: its attributes give labels, positions, weights and storage."""
    names: list[Hashable] = list(graph.nodes)
    nodes: list[Mapping[str, Any]] = [graph.nodes[name] for name in names]
    place = {name: k for k, name in enumerate(names)}
    listed = list(graph.edges(data=True))
    edges = pairs([(place[i], place[j]) for i, j, _ in listed])

    def named(k: int) -> str:
        return f"edge {listed[k][0]} - {listed[k][1]}"

    weights, fact = weights_of(source, options.weight, [own for *_, own in listed], named)
    storage, of_storage = storage_of(source, options.storage, nodes, options.junction_storage, "node")
    return Found(
        source=source,
        names=names,
        edges=edges,
        directed=graph.is_directed(),
        labels=_labels(nodes),
        positions=places([_place(own) for own in nodes]),
        weights=weights,
        storage=storage,
        facts=[fact, *([of_storage] if of_storage else [])],
    )


def _labels(nodes: Sequence[Mapping[str, Any]]) -> list[str | None] | None:
    for key in _LABELS:
        labels = [str(own[key]) if own.get(key) not in (None, "") else None for own in nodes]
        if any(labels):
            return labels
    return None


def _place(own: Mapping[str, Any]) -> tuple[float, float] | None:
    """Return the position of a node, from the attributes that the common tools write."""
    for key in ("pos", "position", "coordinates"):
        if isinstance(own.get(key), list | tuple) and len(own[key]) >= 2:
            return _pair(own[key][0], own[key][1])
    graphics = own.get("graphics") or own.get("viz") or {}
    if isinstance(graphics, dict):
        graphics = graphics.get("position", graphics)
    for x, y in _PLACES:
        for attributes in (own, graphics):
            if isinstance(attributes, dict) and x in attributes and y in attributes:
                return _pair(attributes[x], attributes[y])
    return None


def _pair(x: Any, y: Any) -> tuple[float, float] | None:
    try:
        found = float(x), float(y)
    except (TypeError, ValueError):
        return None
    return found if max(map(abs, found)) < 1e12 else None
