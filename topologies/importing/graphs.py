"""networkx graphs, and the files that networkx reads: GraphML, GML, GEXF, Pajek, JSON."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Callable, Hashable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

from hedgerow.topologies.errors import UserError
from hedgerow.topologies.foreign import not_text
from hedgerow.topologies.importing.found import Found, pairs, places, refuse, storage_of, weights_of
from hedgerow.topologies.importing.options import Options
from hedgerow.topologies.json_file import loads
from hedgerow.topologies.regular_file import read_regular

if TYPE_CHECKING:
    import networkx as nx

GROWTH = 60
"""the memory per byte of a file: networkx holds a dictionary for each node and edge"""
_LABELS = ("label", "Label", "name", "Name")
_PLACES = (("x", "y"), ("Longitude", "Latitude"), ("longitude", "latitude"), ("lon", "lat"), ("lng", "lat"))


def read(path: Path, options: Options, kind: str) -> Found:
    """Return the graph in a file of the kind graphml, gml, gexf, pajek, JSON, or edgelist with attributes."""
    import networkx as nx  # noqa: PLC0415 (a third of a second)

    data = read_regular(path, growth=GROWTH)
    readers: dict[str, Callable[[], Any]] = {
        "graphml": lambda: _graphml(data),
        "gml": lambda: _gml(data),
        "gexf": lambda: nx.read_gexf(io.BytesIO(data)),
        "pajek": lambda: _pajek(data),
        "edgelist": lambda: nx.parse_edgelist(data.decode("utf-8-sig").splitlines(), data=True),
        "JSON": lambda: _json_graph(loads(path, data)),
    }
    try:
        graph = readers[kind]()
    except UserError:
        raise
    except Exception as error:  # each reader of networkx passes on the errors of its parser
        if why := not_text(data, error if isinstance(error, UnicodeDecodeError) else None):
            raise refuse(path, why, "Name a file of the kind of its ending") from None
        raise refuse(path, f"is no {kind} file that networkx can read: {_why(error)}", "Check its format") from None
    return of_networkx(graph, options, str(path))


def _why(error: Exception) -> str:
    """Return the cause of an error of a parser, in our words where its own name a part of Python."""
    if isinstance(error, RecursionError):
        return "it is nested too deep"
    if "int_max_str_digits" in str(error):
        return "a number has more than 4300 digits"
    text = str(error.args[0]) if isinstance(error, KeyError) and error.args else str(error)
    return " ".join(text.split()).rstrip(".")[:200] or type(error).__name__


def _gml(data: bytes) -> Any:
    import networkx as nx  # noqa: PLC0415

    text, label = data.decode("utf-8"), "label"
    for _ in range(3):
        try:
            return nx.parse_gml(text.splitlines(), label=label)
        except nx.NetworkXError as error:
            if str(error).startswith("edge #") and "multigraph" not in text:
                # Many files have parallel edges without the key that allows them.
                text = re.sub(r"\bgraph\s*\[", "graph [ multigraph 1", text, count=1)
            elif "label" in str(error) and label == "label":
                # By default, labels are the names of nodes, but a file may have none or repeat one.
                label = "id"
            else:
                raise
    raise ValueError("it has neither ids nor labels")


def _pajek(data: bytes) -> Any:
    import networkx as nx  # noqa: PLC0415

    return _upwards(nx.parse_pajek(data.decode("utf-8-sig")))


def _upwards(graph: Any) -> Any:
    """Return the graph of a tool in which y points down, with y upwards."""
    for _, own in graph.nodes(data=True):
        if "y" in own and (place := _pair(0, own["y"])) is not None:
            own["y"] = 0.0 - place[1]  # of 0, this makes no -0
    return graph


def _graphml(data: bytes) -> Any:
    import networkx as nx  # noqa: PLC0415

    # networkx makes nodes of ids that no node has, and one node of those without an id.
    listed = [one.get("id") for one in ElementTree.fromstring(data).iter() if one.tag.rpartition("}")[2] == "node"]
    if None in listed:
        raise ValueError("a node has no `id`")
    if len(set(listed)) < len(listed):
        raise ValueError(f"two nodes have the id {_twice(listed)!r}")
    graph = nx.read_graphml(io.BytesIO(data))
    if len(graph) > len(listed):
        strange = next(node for node in graph if str(node) not in listed)
        raise ValueError(f"an edge leads to {strange!r}, which is no node")
    return _upwards(graph) if b"yworks.com/xml" in data else graph  # yEd's format


def _json_graph(content: Any) -> Any:
    """Return the graph of node-link JSON, or of the adjacency and Cytoscape JSON that networkx writes too."""
    import networkx as nx  # noqa: PLC0415

    if isinstance(content, dict) and isinstance(content.get("elements"), dict):
        for listed in content["elements"]["nodes"]:
            listed["data"].setdefault("value", listed["data"].get("id"))  # networkx needs it, Cytoscape has none
        graph = nx.cytoscape_graph(content)
        for node, listed in zip(graph, content["elements"]["nodes"], strict=True):
            # networkx leaves the positions out. In Cytoscape, y points down.
            if isinstance(place := listed.get("position"), dict) and {"x", "y"} <= {*place}:
                graph.nodes[node]["pos"] = (place["x"], 0.0 - place["y"])
        return graph
    if isinstance(content, dict) and "nodes" in content and "adjacency" in content:
        return nx.adjacency_graph(content)
    key = next((key for key in ("edges", "links") if isinstance(content, dict) and key in content), None)
    if key is None or "nodes" not in content:
        raise ValueError("node-link JSON is an object with `nodes`, and `edges` or `links`")
    listed = [json.dumps(node["id"]) for node in content["nodes"] if "id" in node]
    if len(set(listed)) < len(listed):
        raise ValueError(f"two nodes have the id {_twice(listed)}")
    graph = nx.node_link_graph(content, edges=key)
    if len(graph) > len(content["nodes"]):
        raise ValueError(f"an edge leads to {[*graph][len(content['nodes'])]!r}, which is no node")
    return graph


def _twice(listed: Sequence[Hashable]) -> Hashable:
    """Return the first repeated entry of a list."""
    seen: set[Hashable] = set()
    return next(one for one in listed if one in seen or seen.add(one))  # type: ignore[func-returns-value]


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
