"""Columns of a network in a .npz file: the numbers of a large resolved file, or of a user.

    edges        (E, 2) pairs of positions of nodes, from 0: the only one that must be there
    ids          (n,) whole numbers or texts; 0 .. n-1 if absent
    weights      (E,) numbers above 0; 1 if absent
    a, x0, nominal, b    (n,)
    labels       (n,) texts, empty where a node has none
    positions    (n, 2), NaN where a node has none
    layout       (n,) the process of each node, from 0
    candidates   (n, M), NaN behind the end of a shorter list
    w PLACE KIND PARAMETER    of a disturbance, for the nodes at the positions in `w PLACE KIND nodes`, or for all of
                              them if that is absent: (k,), the values of samples (k, T)

Beside whole-number `ids`, a pair such as [1, 2] can also name ids. If both readings are possible, the table is refused.
`table_nodes: positions` or `table_nodes: ids` in the topology gives the reading, for `w … nodes` too.

Columns in the table hold for every node that `nodes:` does not change; missing columns are drawn, or taken from
`defaults:`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from hedgerow.topologies import archive, budget
from hedgerow.topologies.errors import Code, FileRefusedError, UserError
from hedgerow.topologies.graph import LARGEST, Array, Gain, Graph, Index
from hedgerow.topologies.hinf import condition_holds
from hedgerow.topologies.network import PARAMETERS, Group, Network, gains
from hedgerow.topologies.pages import page
from hedgerow.topologies.samples import beside

NAME = "network.npz"
"""its name in the folder of a run"""
NodesBy = Literal["positions", "ids"]
_NUMBERS = ("a", "x0", "nominal")
"""columns that a complete table must have"""
_PER_NODE = ("ids", *_NUMBERS, "b", "candidates", "labels", "positions")
"""columns that give the number of nodes"""
_COLUMNS = {"edges", "weights", "layout", "parts", *_PER_NODE}
BYTES_PER_NODE = 100
"""the memory of a node and its numbers, as for a rule"""
_GROWTH = {"edges": 12, "ids": 8, "weights": 4, "labels": 2}
"""the memory per byte of an array: a graph lists every edge from both ends, and ids become Python objects"""
_GROWTH_WITHOUT_N = 2
"""the memory per byte of the other columns, if none of them gives the number of nodes"""
_GROWTH_OF_ROWS = 5
"""the memory per byte of lists beyond a usual length, and of samples"""
_USUAL_BYTES = 64
"""the size of the candidates of a node that `BYTES_PER_NODE` includes"""
_GROUP = re.compile(r"w ([0-9]{1,3}) (\w+) (\w+)")


@dataclass(frozen=True, eq=False)
class Table:
    """The content of a table; None for missing columns."""

    ids: Sequence[int | str]
    edges: Index
    a: Array | None
    x0: Array | None
    nominal: Array | None
    candidates: Array | None
    """(M, n)"""
    disturbance: Sequence[Group] | None
    parts: Index | None
    b: Array | None = None
    weights: Array | None = None
    """(E,); None also if all are 1"""
    labels: Sequence[str] | None = None
    positions: Array | None = None
    """(n, 2)"""
    layout: tuple[int, ...] | None = None
    """the process of each node, (n,)"""

    def network(self, b: float) -> Network | None:
        """Return the network if the table is complete, otherwise None; `b` is the gain in the file, for a table without
        gains.
        """
        if self.a is None or self.x0 is None or self.nominal is None or self.candidates is None:
            return None
        if self.disturbance is None or self.parts is None:
            return None
        return Network(
            ids=self.ids,
            graph=Graph(len(self.ids), self.edges, self.weights),
            b=b if self.b is None else gains(self.b),
            a=self.a,
            x0=self.x0,
            nominal=self.nominal,
            candidates=self.candidates,
            disturbance=self.disturbance,
            parts=self.parts,
            labels=self.labels,
            positions=self.positions,
        )

    def numbers(self, k: int) -> dict[str, float | tuple[float, ...]]:
        """Return the numbers of the node at position k, by their keys in a file; without those that are missing."""
        columns = {"a": self.a, "x0": self.x0, "nominal": self.nominal, "b": self.b}
        found: dict[str, float | tuple[float, ...]] = {
            key: float(column[k]) for key, column in columns.items() if column is not None
        }
        if self.candidates is not None:
            listed = self.candidates[:, k]
            found["candidates"] = tuple(listed[~np.isnan(listed)].tolist())
        return found

    @classmethod
    def of(cls, network: Network, layout: tuple[int, ...] | None = None) -> Table:
        """Return the table of a complete network, as if it was written and read."""
        return cls(
            network.ids,
            network.graph.edges,
            network.a,
            network.x0,
            network.nominal,
            network.candidates,
            network.disturbance,
            network.parts,
            b=None if isinstance(network.b, float) else network.b,
            weights=network.graph.weights,
            labels=network.labels,
            positions=network.positions,
            layout=layout,
        )


def write(network: Network, path: Path, layout: Sequence[int] | None = None) -> None:
    """Write a complete network, which `read` reads back to the same bits; `layout` as in `arrays`."""
    archive.write(path, {}, arrays(network, layout))


def arrays(network: Network, layout: Sequence[int] | None = None) -> dict[str, NDArray[Any]]:
    """Return the columns of a complete network.

    layout: the process of each node, (n,), if it is recorded.
    """
    found: dict[str, Any] = {} if isinstance(network.ids, range) else {"ids": archive.id_array(network.ids)}
    found |= {name: getattr(network, name) for name in _NUMBERS}
    found |= {"edges": network.graph.edges, "candidates": network.candidates.T, "parts": network.parts}
    if not isinstance(network.b, float):
        found["b"] = network.b
    if network.graph.weights is not None:
        found["weights"] = network.graph.weights
    if network.labels is not None:
        found["labels"] = np.array(network.labels, dtype=np.str_)
    if network.positions is not None:
        found["positions"] = network.positions
    if layout is not None:
        found["layout"] = np.array(layout, dtype=np.int32)
    for group in network.disturbance:
        name = f"w {group.number} {group.kind}"
        found |= {f"{name} nodes": group.nodes} | {f"{name} {key}": column for key, column in group.values.items()}
    return found


def read(file: str, folder: Path, named_by: NodesBy | None = None) -> Table:
    """Return the table in a file; raise ValueError if it is invalid, FileRefusedError if it has two readings."""
    path = beside(folder, file)
    try:
        _, arrays = archive.read(path, _memory)
    except FileRefusedError as error:
        raise FileRefusedError(f"{file}: {error.what}", error.cure, error.code) from None
    except UserError as error:
        raise FileRefusedError(str(error), code=error.code) from None
    try:
        return _table(arrays, named_by)
    except (ValueError, LookupError, TypeError, AttributeError, ArithmeticError, MemoryError) as error:
        refused = FileRefusedError.of(error if isinstance(error, ValueError) else ValueError(str(error)))
        raise FileRefusedError(f"{file}: {refused.what}", refused.cure, refused.code) from None


def _memory(heads: Mapping[str, archive.Head]) -> int:
    """Return the memory of a table [bytes]; raise FileRefusedError for an array that no table has."""
    for name in heads:
        if name not in _COLUMNS and _column(name) is None:
            raise FileRefusedError(f"has a column `{name}`", f"the columns are listed in {page('topology')}")
    n = next((heads[name].shape[0] for name in _PER_NODE if name in heads and heads[name].shape), 0)
    for name in (*_PER_NODE, "layout", "parts"):
        if n and name in heads and heads[name].shape[:1] != (n,):
            raise FileRefusedError(f"`{name}` has the shape {heads[name].shape}", f"write {n} rows, one per node")
    sizes = {name: head.size for name, head in heads.items()}
    rows = max(0, sizes.get("candidates", 0) - _USUAL_BYTES * n)
    rows += sum(size for name, size in sizes.items() if name.endswith(" values"))
    return (
        BYTES_PER_NODE * n
        + _GROWTH_OF_ROWS * rows
        + sum(size * _GROWTH.get(name, 0 if n else _GROWTH_WITHOUT_N) for name, size in sizes.items())
    )


def _column(name: str) -> tuple[int, str, str] | None:
    """Return place, kind and parameter of a column of disturbances; None for another name."""
    match = _GROUP.fullmatch(name)
    if match is None or match[2] not in PARAMETERS or match[3] not in ("nodes", *PARAMETERS[match[2]]):
        return None
    return int(match[1]), match[2], match[3]


def _table(arrays: archive.Arrays, named_by: NodesBy | None) -> Table:
    n = _size(arrays)
    ids = _ids(arrays.pop("ids", None), n)
    _by_position(arrays, ids, named_by)
    edges = _edges(arrays.pop("edges"), n)
    columns = {name: _floats(name, arrays.pop(name), (n,)) if name in arrays else None for name in _NUMBERS}
    columns["b"] = _positive("b", arrays.pop("b"), n) if "b" in arrays else None
    weights = _positive("weights", arrays.pop("weights"), len(edges)) if "weights" in arrays else None
    labels = _labels(arrays.pop("labels"), n) if "labels" in arrays else None
    positions = _positions(arrays.pop("positions"), n) if "positions" in arrays else None
    candidates = _candidates(arrays.pop("candidates"), n) if "candidates" in arrays else None
    layout = _whole("layout", arrays.pop("layout"), (n,)) if "layout" in arrays else None
    parts = arrays.pop("parts", None)
    groups = list(_groups(arrays, n))
    if parts is None and groups:
        parts = np.ones(n, dtype=np.int64)
        for group in groups:
            parts[group.nodes] = np.maximum(parts[group.nodes], group.number + 1)
    if parts is not None:
        parts = _whole("parts", parts, (n,))
        least = np.zeros(n, dtype=np.int64)
        for group in groups:
            least[group.nodes] = np.maximum(least[group.nodes], group.number + 1)
        if (parts < least).any() or parts.max() > 1000:
            raise ValueError("`parts` are fewer than the disturbances of a node; leave it out")
    return Table(
        ids,
        edges,
        **columns,
        candidates=candidates,
        disturbance=None if parts is None else groups,
        parts=parts,
        weights=None if weights is None or (weights == 1).all() else weights,
        labels=labels,
        positions=positions,
        layout=None if layout is None else tuple(layout.tolist()),
    )


def _size(arrays: archive.Arrays) -> int:
    if "edges" not in arrays:
        raise ValueError("has no `edges`, pairs of nodes of the shape (E, 2)")
    for name in _PER_NODE:
        if name in arrays and arrays[name].ndim:
            return len(arrays[name])
    edges = arrays["edges"]
    if edges.dtype.kind not in "iu" or not edges.size:
        raise ValueError("does not give the number of nodes; add `ids`")
    n = int(edges.max()) + 1
    if why := budget.excess(n * BYTES_PER_NODE):
        raise FileRefusedError(f"`edges` names the node {n - 1}, so there are {n}: {why}", code=Code.FILE_TOO_LARGE)
    return n


def _ids(found: NDArray[Any] | None, n: int) -> Sequence[int | str]:
    if found is None:
        return range(n)
    from pydantic import TypeAdapter, ValidationError  # noqa: PLC0415

    from hedgerow.topologies.base import NodeId  # noqa: PLC0415

    if found.dtype.kind in "iu" and found.ndim == 1 and np.array_equal(found, np.arange(n)):
        return range(n)
    try:
        ids: list[int | str] = TypeAdapter(list[NodeId]).validate_python(found.tolist())
    except ValidationError:
        raise ValueError("`ids` are not a list of names or whole numbers") from None
    if len(set(ids)) < n:
        raise ValueError("`ids` has one of them twice")
    return tuple(ids)


def _by_position(arrays: archive.Arrays, ids: Sequence[int | str], named_by: NodesBy | None) -> None:
    """Turn node ids in `edges` and `w … nodes` into positions, if `table_nodes: ids` marks them as ids.

    Raise FileRefusedError without that key if both readings are possible. A complete table was written by a run, with
    positions.
    """
    complete = all(name in arrays for name in (*_NUMBERS, "candidates", "parts"))
    if isinstance(ids, range) or (named_by is None and complete) or named_by == "positions":
        return
    from hedgerow.topologies.base import node_id  # noqa: PLC0415

    places = {node: k for k, node in enumerate(ids)}
    for name, array in arrays.items():
        if not (name == "edges" or name.endswith(" nodes")) or not array.size:
            continue
        whole = array.dtype.kind in "iu"
        if whole and array.min() >= 0 and array.max() < len(ids) and named_by is None:
            used = np.unique(array).tolist()
            if all(node in places for node in used) and any(places[node] != node for node in used):
                raise FileRefusedError(
                    f"`{name}` can hold positions of nodes, from 0, or the ids of nodes: all of its numbers are both",
                    "write `table_nodes: positions` or `table_nodes: ids` in the topology",
                    Code.FILE_AMBIGUOUS,
                )
            continue
        strange = [node for node in np.unique(array).tolist() if node_id(node) not in places]
        if strange and named_by == "ids":
            raise FileRefusedError(
                f"`{name}` names {strange[0]!r}, which is not in `ids`", "add it to `ids`, or correct it"
            )
        if named_by is None and not strange:
            raise FileRefusedError(
                f"`{name}` holds the ids of nodes, not their positions from 0",
                "write `table_nodes: ids` in the topology",
            )
        if named_by == "ids":
            found = np.array([places[node_id(node)] for node in array.ravel().tolist()], dtype=np.int64)
            arrays[name] = found.reshape(array.shape)


def _edges(found: NDArray[Any], n: int) -> Index:
    edges = _whole("edges", found, (len(found) if found.ndim else 0, 2))
    if edges.size and (edges.min() < 0 or edges.max() >= n):
        raise ValueError(f"`edges` leads to a node that is none of the {n}; give positions, from 0")
    low, high = edges.min(axis=1), edges.max(axis=1)
    if (low == high).any():
        raise ValueError(f"`edges` has a self-loop, in row {int((low == high).argmax())}")
    if len(np.unique(low * n + high)) < len(edges):
        raise ValueError("`edges` has one of them twice; they are undirected: keep one")
    return edges


def _whole(name: str, found: NDArray[Any], shape: tuple[int, ...]) -> Index:
    if found.shape != shape or found.dtype.kind not in "iu":
        raise ValueError(f"`{name}` has the shape {found.shape} of {found.dtype}, not {shape} of whole numbers")
    return found.astype(np.int64)


def _floats(name: str, found: NDArray[Any], shape: tuple[int, ...]) -> Array:
    if found.shape != shape or found.dtype.kind not in "fiu":
        raise ValueError(f"`{name}` has the shape {found.shape} of {found.dtype}, not {shape} of numbers")
    numbers = found.astype(np.float64)
    if not (fits := np.abs(numbers) <= LARGEST).all():
        raise ValueError(f"`{name}` holds a number that is not finite, or beyond {LARGEST:g}, in row {fits.argmin()}")
    return numbers


def _positive(name: str, found: NDArray[Any], k: int) -> Array:
    numbers = _floats(name, found, (k,))
    if not (good := numbers > 0).all():
        raise ValueError(f"`{name}` holds {numbers[good.argmin()]:g} in row {good.argmin()}, which is not above 0")
    return numbers


def _labels(found: NDArray[Any], n: int) -> Sequence[str] | None:
    from pydantic import TypeAdapter, ValidationError  # noqa: PLC0415

    from hedgerow.topologies.base import Label  # noqa: PLC0415
    from hedgerow.topologies.wording import in_our_words  # noqa: PLC0415

    if found.shape != (n,) or found.dtype.kind != "U":
        raise ValueError(f"`labels` has the shape {found.shape} of {found.dtype}, not {(n,)} of texts")
    given: list[str] = found.tolist()
    try:
        TypeAdapter(list[Label]).validate_python([label for label in given if label])
    except ValidationError as error:
        raise ValueError(f"`labels`: {in_our_words(error.errors(include_url=False)[0])}") from None
    return tuple(given) if any(given) else None


def _positions(found: NDArray[Any], n: int) -> Array | None:
    if found.shape != (n, 2) or found.dtype.kind not in "fiu":
        raise ValueError(f"`positions` has the shape {found.shape} of {found.dtype}, not {(n, 2)} of numbers")
    numbers = found.astype(np.float64)
    none = np.isnan(numbers)
    if (none[:, 0] != none[:, 1]).any() or (np.abs(numbers) > LARGEST).any():
        raise ValueError(f"`positions` holds half a pair, or a number beyond {LARGEST:g}")
    return None if none.all() else numbers


def _candidates(found: NDArray[Any], n: int) -> Array:
    if found.ndim != 2 or len(found) != n or not found.size or found.dtype.kind not in "fiu":
        raise ValueError(f"`candidates` has the shape {found.shape} of {found.dtype}, not ({n}, M) of numbers")
    numbers = np.ascontiguousarray(found.T, dtype=np.float64)
    none = np.isnan(numbers)
    if (np.abs(numbers) > LARGEST).any() or none[0].any() or (none[:-1] & ~none[1:]).any():
        raise ValueError("`candidates` has a list that is empty, too large, or continues after a NaN")
    return numbers


def _groups(arrays: archive.Arrays, n: int) -> Iterator[Group]:
    found: dict[tuple[int, str], dict[str, NDArray[Any]]] = {}
    for name, array in arrays.items():
        if (column := _column(name)) is not None:
            number, kind, key = column
            found.setdefault((number, kind), {})[key] = array
    for (number, kind), columns in sorted(found.items(), key=lambda item: item[0]):
        name = f"w {number} {kind}"
        nodes = columns.pop("nodes", np.arange(n))
        nodes = _whole(f"{name} nodes", nodes, (nodes.size,))
        if nodes.size and (nodes[0] < 0 or nodes[-1] >= n or (np.diff(nodes) <= 0).any()):
            raise ValueError(f"`{name} nodes` are not ascending positions of nodes")
        if missing := [key for key in PARAMETERS[kind] if key not in columns]:
            raise ValueError(f"has no `{name} {missing[0]}`")
        yield Group(number, kind, nodes, {key: _value(name, key, columns[key], len(nodes)) for key in PARAMETERS[kind]})


def _value(name: str, key: str, found: NDArray[Any], k: int) -> NDArray[Any]:
    if key == "at":
        return _whole(f"{name} {key}", found, (k,))
    return _floats(f"{name} {key}", found, (k, *found.shape[1:2]) if key == "values" else (k,))


def broken(
    table: Table, b: Gain, steps: int, a: float | None = None, candidates: Sequence[float] | None = None
) -> Iterator[tuple[str, str]]:
    """Yield each rule that a table breaks, condition (3) or another one, as the problem and the fix.

    `b` is the gain in the file; or (n,), the largest of each node, if `nodes:` give some their own. `a` and
    `candidates` are those in `defaults:`, if they are numbers.
    """
    degree = Graph(len(table.ids), table.edges, table.weights).weighted_degree
    for name in ("a", "nominal", "candidates"):
        values = getattr(table, name)
        if values is not None and not (good := condition_holds(values, b, degree) | np.isnan(values)).all():
            k = int((~np.atleast_2d(good)).any(axis=0).argmax())
            where = f"node {table.ids[k]}, of degree {degree[k]:.6g}"
            yield f"`{name}` breaks condition (3) at {where}", "choose values inside its interval, or a smaller b"
    truth: Any = a if table.a is None else table.a
    listed: Any = table.candidates
    if listed is None and candidates is not None:
        listed = np.array(candidates, dtype=np.float64)[:, None]
    if truth is not None and listed is not None and (table.a is not None or table.candidates is not None):
        among = np.broadcast_to((listed == truth).any(axis=0), len(table.ids))
        if not among.all():
            yield f"the truth of node {table.ids[int((~among).argmax())]} is not among its candidates", "add it to them"
    for group in table.disturbance or ():
        if group.kind == "samples" and group.values["values"].shape[1] < steps:
            yield (
                f"{group.values['values'].shape[1]} samples are too few for {steps} steps",
                "add some, or lower `steps:`",
            )
