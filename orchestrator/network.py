"""A network in Python: built, imported, changed, checked, saved and drawn, without a file."""

from __future__ import annotations

import difflib
import shutil
import tempfile
import weakref
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np
import yaml

from hedgerow.topologies import archive
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.escape import shorten
from hedgerow.topologies.faults import known_keys
from hedgerow.topologies.importing.graphs import of_networkx
from hedgerow.topologies.importing.options import Options
from hedgerow.topologies.importing.tables import of_frame, of_matrix
from hedgerow.topologies.importing.written import Imported, imported
from hedgerow.topologies.in_python import answers_in_python, in_words_of_python
from hedgerow.topologies.named import resolved, text_of
from hedgerow.topologies.nodes import SPELLED_OUT
from hedgerow.topologies.paths import user_path
from hedgerow.topologies.plain import plain
from hedgerow.topologies.reading import Times
from hedgerow.topologies.schema import Topology

if TYPE_CHECKING:
    import networkx as nx
    from matplotlib.axes import Axes

TABLE = "network.npz"
NodeId = int | str


class Network(Mapping[str, Any]):
    """A network as the keys of a topology file (docs/topology.md). It is checked when it is made, and never changes.

        net = hg.Network("pair", b=0.1, steps=50, nodes=["p", "q"], edges=[("p", "q")])
        net = net.replace(law="hinf").with_node("r", x0=3).with_edge("q", "r", weight=0.5)
        net.save("three.yaml")
        run = hg.simulate(net)

    It is a mapping of these keys, and can replace a file or its name as an argument. Raises TopologyError with all
    mistakes.
    """

    def __init__(self, name: str, **keys: Any) -> None:
        self._hold({"name": name, **keys}, {})

    @classmethod
    def of(cls, network: str | Path | Mapping[str, Any] | Topology) -> Self:
        """Return a network of a bundled name, a file or run folder, a text, a dictionary, or a Topology."""
        if isinstance(network, Network):
            return cls._of(dict(network), network.arrays)
        text, name, folder = text_of(network)
        content = yaml.load(text, Loader=yaml.CSafeLoader)
        if not isinstance(content, dict) or "table" in content or _files(content):
            # Draw the values in files beside the topology, so the network needs none of these files.
            return cls._of_resolved(resolved(network))
        del name, folder
        return cls._of(content, {})

    @classmethod
    def _of(cls, content: Mapping[str, Any], arrays: Mapping[str, Any]) -> Self:
        network = cls.__new__(cls)
        network._hold(content, arrays)
        return network

    @classmethod
    def _of_resolved(cls, topology: Topology) -> Self:
        from hedgerow.topologies.resolve import to_yaml  # noqa: PLC0415

        if len(topology.ids) > SPELLED_OUT:
            raise UserError(
                f"{topology.name}: {len(topology.ids):,} nodes lie in a table, and are no keys in Python. "
                "Use hg.load, or change the file.",
                code=Code.TOPOLOGY,
            )
        return cls._of(yaml.load(to_yaml(topology), Loader=yaml.CSafeLoader), {})

    @classmethod
    def _of_import(cls, found: Imported) -> Self:
        network = cls._of(found.content, found.arrays)
        network._imported = found
        return network

    def _hold(self, content: Mapping[str, Any], arrays: Mapping[str, Any]) -> None:
        self._content: dict[str, Any] = plain(content)
        self.arrays: dict[str, Any] = dict(arrays)
        """the columns of a network of more than 1000 nodes, as a table of docs/topology.md has them"""
        self._imported: Imported | None = None
        self.folder: Path | None = None
        """the folder of a large network's table, until this object is deleted"""
        if self.arrays:
            self.folder = Path(tempfile.mkdtemp(prefix="hedgerow-"))
            weakref.finalize(self, shutil.rmtree, self.folder, ignore_errors=True)
            archive.write(self.folder / TABLE, {}, self.arrays)
            self._content |= {"table": TABLE, "table_nodes": "positions"}
        _ = self.topology  # a read that reports all mistakes

    def __getitem__(self, key: str) -> Any:
        return self._content[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._content)

    def __len__(self) -> int:
        return len(self._content)

    def __hash__(self) -> int:
        return id(self)

    def __repr__(self) -> str:
        topology = self.topology
        edges = len(topology.graph.edges)
        return f"<Network {topology.name}: {len(topology.ids)} nodes, {edges} edges, {topology.steps} steps>"

    @cached_property
    def topology(self) -> Topology:
        """Return the network with all numbers drawn."""
        return resolved(self)

    @property
    def notes(self) -> Sequence[str]:
        """Return sentences about an imported network: the meaning of its numbers, the assumptions, and the changes."""
        found = self._imported
        notes = () if found is None else (*found.facts, *found.assumptions, *found.changes)
        return tuple(map(in_words_of_python, notes))

    def check(self) -> str:
        """Return the output of `orchestrator check`: gains, degrees, intervals and candidates of the nodes."""
        from hedgerow.orchestrator.metrics.summary import table  # noqa: PLC0415

        return table(self.topology)

    def replace(self, **keys: Any) -> Self:
        """Return a copy with other values of top-level keys; None removes a key."""
        content = {**self._content, **keys}
        return self._of({key: value for key, value in content.items() if value is not None}, self.arrays)

    def with_node(self, node: NodeId, **settings: Any) -> Self:
        """Return a copy with one more node, or with other settings of an existing node."""
        nodes = self._nodes()
        return self.replace(nodes={**nodes, node: {**nodes.get(node, {}), **settings}})

    def without_node(self, node: NodeId) -> Self:
        """Return a copy without a node and its edges; raise UserError if the node does not exist."""
        nodes = self._nodes()
        if node not in nodes:
            raise UserError(f"node {node!r}: does not exist. The nodes are {_some(nodes)}.", code=Code.TOPOLOGY)
        edges = [edge for edge in self._edges() if node not in _ends(edge)]
        return self.replace(nodes={key: own for key, own in nodes.items() if key != node}, edges=edges)

    def with_edge(self, i: NodeId, j: NodeId, weight: float | None = None) -> Self:
        """Return a copy with one more edge, or with another weight of an existing edge."""
        edges = [edge for edge in self._edges() if {*_ends(edge)} != {i, j}]
        return self.replace(edges=[*edges, [i, j] if weight is None else {"ends": [i, j], "weight": weight}])

    def without_edge(self, i: NodeId, j: NodeId) -> Self:
        """Return a copy without an edge; raise UserError if the edge does not exist."""
        edges = [edge for edge in self._edges() if {*_ends(edge)} != {i, j}]
        if len(edges) == len(self._edges()):
            raise UserError(f"edge [{i}, {j}]: does not exist. Name an edge of the network.", code=Code.TOPOLOGY)
        return self.replace(edges=edges)

    @answers_in_python
    def with_samples(
        self,
        samples: Any,
        *,
        time: str | None = None,
        step: float | None = None,
        resample: Literal["hold", "linear", "mean"] | None = None,
    ) -> Self:
        """Return a copy with samples as disturbances: a data frame with a column per node, or the path of a file.

        time: the column of times; step: the time of one step, in its unit (seconds if it holds dates);
        resample: `hold` (default), `linear` or `mean`. A node without a column keeps its disturbance.
        """
        from hedgerow.topologies.frames import of_frame as samples_of  # noqa: PLC0415

        nodes = self._nodes()
        times = None if time is None else Times(time, step, resample)
        columns = samples_of(samples, list(nodes), times, int(self._content["steps"]))
        given = {
            node: {**own, **({"disturbance": {"kind": "samples", "values": columns[node]}} if node in columns else {})}
            for node, own in nodes.items()
        }
        return self.replace(nodes=given)

    @answers_in_python
    def save(self, path: str | Path, force: bool = False) -> Path:
        """Write the topology file, and return its path.

        The numbers of a large network are written to a table beside the file. Raise UserError if the file exists,
        unless `force` is True.
        """
        target = user_path(str(path))
        found = self._imported
        if found is None or found.content is not self._content:
            content = {key: value for key, value in self._content.items() if key not in ("table", "table_nodes")}
            origin = found or Imported(content)
            found = Imported(content, self.arrays, origin.facts, origin.assumptions, origin.changes, origin.source)
        found.save(target, force)
        return target

    @cached_property
    def graph(self) -> nx.Graph[NodeId]:
        """Return the network as a networkx graph: nodes with `label`, `pos`, `b`, `a` and `x0`, edges with `weight`."""
        import networkx as nx  # noqa: PLC0415 (a third of a second)

        network = self.topology.network
        graph: nx.Graph[NodeId] = nx.Graph(name=self.topology.name)
        b = np.broadcast_to(network.b, len(network.ids))
        for k, node in enumerate(network.ids):
            graph.add_node(node, b=float(b[k]), a=float(network.a[k]), x0=float(network.x0[k]))
            if network.labels is not None and network.labels[k]:
                graph.nodes[node]["label"] = network.labels[k]
            if network.positions is not None and not np.isnan(network.positions[k]).any():
                graph.nodes[node]["pos"] = tuple(network.positions[k].tolist())
        weights = network.graph.weights
        for e, (i, j) in enumerate(network.graph.edges.tolist()):
            graph.add_edge(network.ids[i], network.ids[j], weight=1.0 if weights is None else float(weights[e]))
        return graph

    def plot(self, ax: Axes | None = None, labels: bool | None = None) -> Axes:
        """Draw the network with matplotlib, and return the axes: wide edges have large weights.

        labels: write the ids; by default for up to 60 nodes.
        """
        from hedgerow.orchestrator.views.drawing import draw  # noqa: PLC0415

        if ax is not None and not hasattr(ax, "scatter"):
            raise UserError(
                f"ax={shorten(repr(ax))}: are no axes. Give axes of matplotlib, or none for new ones.", code=Code.OPTION
            )
        return draw(self.topology, ax, labels)

    def _nodes(self) -> dict[Any, dict[str, Any]]:
        if self.arrays or "nodes" not in self._content:
            raise UserError(
                f"{self._content['name']}: a rule or a table makes its nodes, which cannot be changed one by one. "
                "Change `arrays`, or build it with `nodes` and `edges`.",
                code=Code.TOPOLOGY,
            )
        nodes = self._content["nodes"]
        return {node: {} for node in nodes} if isinstance(nodes, list) else {k: dict(v or {}) for k, v in nodes.items()}

    def _edges(self) -> list[Any]:
        return list(self._content.get("edges", []))


@answers_in_python
def from_networkx(graph: nx.Graph[Any], **options: Any) -> Network:
    """Return the network of a networkx graph of any class: labels, positions and weights are its attributes.

    options: those of `orchestrator import`, such as `weight="capacity"`, `b=0.1`, `largest_component=True`; and keys of
    a topology file, such as `law="hinf"`. Raise UserError if the graph cannot be imported.
    """
    if not hasattr(graph, "nodes") or not hasattr(graph, "is_directed"):
        raise UserError(
            f"the graph: is a {type(graph).__name__}, no graph of networkx. Use hg.from_edges for pairs, and "
            "hg.from_adjacency for a matrix.",
            code=Code.FILE_FORMAT,
        )
    own, keys = _split(options)
    own.setdefault("name", str(graph.name) or "graph")
    chosen = Options(**own)
    return _made(imported(of_networkx(graph, chosen, "the graph"), chosen), keys)


@answers_in_python
def from_adjacency(matrix: Any, names: Sequence[Hashable] | None = None, **options: Any) -> Network:
    """Return the network of an adjacency matrix: a NumPy array, a SciPy matrix or array, or a pandas data frame.

    Nodes are 0 .. n-1 if there are no names. Options and errors are those of `from_networkx`.
    """
    own, keys = _split(options)
    own.setdefault("name", "adjacency")
    chosen = Options(**own)
    if names is None and hasattr(matrix, "columns") and hasattr(matrix, "to_numpy"):
        names = list(matrix.columns)
        rows = list(matrix.index) if hasattr(matrix, "loc") else []
        if len({*names}) == len(names) == len(rows) and {*rows} == {*names}:
            matrix = matrix.loc[names]  # its rows may have another order
        matrix = matrix.to_numpy()
    return _made(imported(of_matrix(matrix, chosen, "the matrix", names), chosen), keys)


@answers_in_python
def from_edges(frame: Any, source: str | None = None, target: str | None = None, **options: Any) -> Network:
    """Return the network of a data frame of edges (pandas, polars, pyarrow), a mapping of columns, or a list of pairs.

    source and target name the columns of the two ends, by default `source` and `target`, `from` and `to`, or the first
    two. A list may hold triples with a weight. Options and errors are those of `from_networkx`.
    """
    own, keys = _split(options)
    own.setdefault("name", "edges")
    chosen = Options(**own)
    return _made(imported(of_frame(_columns(frame), chosen, "the edges", source, target), chosen), keys)


def _columns(frame: Any) -> Any:
    """Return a list of pairs or triples as columns, and any other table as it is."""
    if hasattr(frame, "columns") or hasattr(frame, "to_pydict") or isinstance(frame, Mapping):
        return frame
    if isinstance(frame, str | Path):
        raise UserError(
            f"the edges: {shorten(repr(str(frame)))} is a text. Give a data frame or pairs, such as pandas.read_csv(…);"
            " for a file, write `orchestrator import FILE -o net.yaml`, and use hg.load.",
            code=Code.FILE_FORMAT,
        )
    try:
        rows = [tuple(row) for row in frame]
    except TypeError:
        rows = []
    widths = {len(row) for row in rows}
    if not rows or not widths <= {2, 3}:
        raise UserError("the edges: are no pairs or triples. Give (i, j), or (i, j, weight).", code=Code.FILE_FORMAT)
    columns = {"source": [row[0] for row in rows], "target": [row[1] for row in rows]}
    return columns if widths == {2} else columns | {"weight": [row[2] if len(row) > 2 else 1.0 for row in rows]}


def _split(options: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the options of an import, and the keys of a topology file."""
    known = set(Options.__dataclass_fields__)
    own = {key: value for key, value in options.items() if key in known}
    if isinstance(own.get("weight"), int | float):
        own["weight"] = str(own["weight"])
    return own, {key: value for key, value in options.items() if key not in known}


def _made(found: Imported, keys: Mapping[str, Any]) -> Network:
    names = [*Options.__dataclass_fields__, *known_keys(Topology)]
    for key in keys:
        if key not in names:
            near = difflib.get_close_matches(key, names, 1, 0.5)
            raise UserError(
                f"{key}: is no option of an import, and no key of a topology file. "
                + (f"Did you mean {near[0]}?" if near else f"Choose one of {', '.join(names)}."),
                code=Code.OPTION,
            )
    found.content |= keys
    return Network._of_import(found)


def _ends(edge: Any) -> list[Any]:
    return list(edge["ends"] if isinstance(edge, dict) else edge)


def _files(content: Any) -> bool:
    """Return True if a topology reads samples from files."""
    if isinstance(content, dict):
        return "file" in content or any(_files(value) for value in content.values())
    return isinstance(content, list) and any(_files(value) for value in content)


def _some(nodes: Iterable[Any]) -> str:
    listed = [str(node) for node in nodes]
    return ", ".join(listed[:8]) + (", …" if len(listed) > 8 else "")
