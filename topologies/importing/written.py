"""The topology of an imported network: the dictionary form of a file, its text with comments, and a table if large."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from hedgerow.topologies import archive
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.escape import escape
from hedgerow.topologies.graph import Array
from hedgerow.topologies.hinf import allowed_interval
from hedgerow.topologies.importing.found import Found
from hedgerow.topologies.importing.ids import ids_of
from hedgerow.topologies.importing.options import Options
from hedgerow.topologies.importing.simple import simple
from hedgerow.topologies.load import parse
from hedgerow.topologies.nodes import SPELLED_OUT
from hedgerow.topologies.regular_file import read_regular
from hedgerow.topologies.resolve import Dumper, Line
from hedgerow.topologies.schema import Topology

STEPS = 300
SHARE = 0.5
"""the maximum of 8 b² d_i with the default b; condition (3) needs less than 1"""
INLINE = 20_000
"""the maximum number of samples in the file itself"""


@dataclass(eq=False)
class Imported:
    """An imported network: the keys of its file, the columns of its table, and the changes made."""

    content: dict[str, Any]
    """the dictionary form of the file; of a large network without `nodes` and `edges`"""
    arrays: dict[str, NDArray[Any]] = field(default_factory=dict)
    """the columns of its table, if it is large"""
    facts: Sequence[str] = ()
    assumptions: Sequence[str] = ()
    changes: Sequence[str] = ()
    source: str = ""
    size: tuple[int, int] = (0, 0)
    """nodes and edges"""
    digest: str = ""
    """SHA-256 of the file, or empty"""

    def text(self, table: str | None = None) -> str:
        """Return the file: comments about assumptions and changes, then the keys."""
        digest = f", SHA-256 {self.digest}" if self.digest else ""
        lines = [f"# Imported from {escape(self.source, keep='')}{digest}"] if self.source else []
        for title, sentences in (
            ("From the source", self.facts),
            ("Assumed", self.assumptions),
            ("Changed", self.changes),
        ):
            lines += [f"# {title}:"] if sentences else []
            lines += [f"# - {escape(sentence, keep='')}" for sentence in sentences]
        content: dict[str, Any] = {key: value for key, value in self.content.items() if key not in ("nodes", "edges")}
        if table is not None:
            # The ids are whole numbers in many files, and so are the positions of nodes in the table.
            content |= {"table": table, "table_nodes": "positions"}
        else:
            # A network of Python may name its nodes only, or have a rule for them.
            if isinstance(nodes := self.content.get("nodes", []), dict):
                content["nodes"] = {node: Line(own or {}) for node, own in nodes.items()}
            elif nodes:
                content["nodes"] = nodes
            if edges := self.content.get("edges", []):
                content["edges"] = [Line(edge) for edge in edges]
        dumped = yaml.dump(
            content, Dumper=Dumper, sort_keys=False, default_flow_style=None, width=10**6, allow_unicode=True
        )
        return "".join(f"{line}\n" for line in lines) + dumped

    def save(self, path: Path, force: bool = False) -> list[Path]:
        """Write the file, and beside it the table of a large network; raise UserError if one of them exists."""
        table = path.with_suffix(".npz") if self.arrays else None
        written = [path, *([table] if table is not None else [])]
        for file in written:
            if not force and (file.exists() or file.is_symlink()):
                raise UserError(f"{file}: exists. Name another file, or replace it with --force.", code=Code.OUTPUT)
        try:
            if table is not None:
                archive.write(table, {}, self.arrays)
            path.write_text(self.text(None if table is None else table.name), encoding="utf-8")
        except OSError as error:
            raise UserError(
                f"{path}: cannot be written: {error.strerror}. Name another file.", code=Code.OUTPUT
            ) from None
        return written

    def topology(self, path: Path) -> Topology:
        """Return the checked topology of the saved file, or of the text if it needs no table."""
        text = read_regular(path) if self.arrays else self.text().encode()
        return parse(text, str(path), path.parent)


def imported(found: Found, options: Options) -> Imported:
    """Return the topology of a reader's result; raise UserError for an invalid weight or option."""
    found = simple(found, options)
    n = len(found.names)
    ids, labels, made = ids_of(found.names, found.labels)
    changes = list(found.changes)
    if made:
        changes.append(
            f"{made:,} id{'s' if made > 1 else ''} made from names that are not valid ids, or that occur twice"
        )
    assumptions = list(found.assumptions)
    content: dict[str, Any] = {"name": _name(options.name or Path(found.source).stem), "b": 0.0}
    content["b"] = _gain(found, options, ids, assumptions)
    content |= {"steps": options.steps or found.steps or STEPS, "seed": options.seed}
    content["defaults"] = _defaults(found, assumptions)
    b = None if found.storage is None else content["b"] / np.sqrt(found.storage)
    if b is not None and (b == b[0]).all():
        content["b"], b = float(b[0]), None
    result = Imported(
        content,
        facts=found.facts,
        assumptions=assumptions,
        changes=changes,
        source=found.source,
        size=(n, len(found.edges)),
    )
    samples = 0 if found.samples is None else found.samples.size
    if n > SPELLED_OUT or samples > INLINE:
        result.arrays = _columns(found, ids, labels, b)
    else:
        content["nodes"] = _nodes(found, ids, labels, b)
        content["edges"] = _edges(found, ids)
    return result


def import_file(path: Path, options: Options) -> Imported:
    """Return the topology of a file of another tool; raise UserError if it cannot be imported."""
    from hedgerow.topologies.importing.files import read  # noqa: PLC0415 (each reader imports this package)

    result = imported(read(path, options), options)
    result.digest = hashlib.sha256(read_regular(path)).hexdigest()
    return result


def _gain(found: Found, options: Options, ids: Sequence[Hashable], assumptions: list[str]) -> float:
    """Return b: the given one, that of the source, or one that leaves every node an interval of condition (3)."""
    n = len(found.names)
    weights = np.ones(len(found.edges)) if found.weights is None else found.weights
    degree = np.bincount(found.edges.ravel(), np.repeat(weights, 2), n)
    load = degree if found.storage is None else degree / found.storage
    worst = int(load.argmax())
    if options.b is not None or found.b is not None:
        b = options.b or found.b or 1.0
        if allowed_interval(b, float(load[worst])) is None:
            fits = _two_digits(math.sqrt(SHARE / (8 * load[worst])))
            raise UserError(
                f"--b {b:g}: 8 b_i² d_i = {8 * b * b * load[worst]:.4g} is not below 1 at node {ids[worst]}, so "
                f"that no a satisfies condition (3). Use --b {fits:g}, which fits all nodes.",
                code=Code.TOPOLOGY,
            )
        return b
    b = 0.1 if load[worst] <= 0 else _two_digits(math.sqrt(SHARE / (8 * load[worst])))
    assumptions.append(
        f"b = {b:g}: at node {ids[worst]}, 8 b_i² d_i is the largest, and at most {SHARE:g}; condition (3) of the paper"
        " needs it below 1; d_i is the sum of the weights at node i; choose another with `--b`, such as"
        f" `--b {_two_digits(b / 2):g}`"
    )
    return b


def _two_digits(value: float) -> float:
    """Return a number rounded down to two digits."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.floor(value / unit * (1 + 1e-12)) * unit:.2g}")


def _defaults(found: Found, assumptions: list[str]) -> dict[str, Any]:
    defaults: dict[str, Any] = {} if found.a is None else {"a": found.a}
    defaults["candidates"] = {"random": 5}
    if found.b is None:
        defaults |= {
            "x0": {"random": [-10, 10]},
            "disturbance": {"kind": "sinusoid", "amplitude": 1.0, "omega": {"random": [0.0, 3.14159]}},
        }
        assumptions.append("x(0), the disturbance, a and its candidates are drawn: the source has no dynamics")
    elif found.samples is None:
        defaults["x0"] = {"random": [-10, 10]}
        assumptions.append("The candidates for a and x(0) are drawn: the network begins off its operating point")
    else:
        assumptions.append("The candidates for a are drawn, and x(0) = 0: the network begins at its operating point")
    return defaults


def _nodes(found: Found, ids: Sequence[int | str], labels: Sequence[str | None], b: Array | None) -> dict[Any, Any]:
    nodes: dict[Any, Any] = {}
    for k, node in enumerate(ids):
        own: dict[str, Any] = {}
        if labels[k] is not None:
            own["label"] = labels[k]
        if found.positions is not None and not np.isnan(found.positions[k]).any():
            own["position"] = found.positions[k].tolist()
        if b is not None:
            own["b"] = float(b[k])
        if found.samples is not None and found.samples[k].any():
            own["disturbance"] = {"kind": "samples", "values": found.samples[k].tolist()}
        nodes[node] = own
    return nodes


def _edges(found: Found, ids: Sequence[int | str]) -> list[Any]:
    ends = [[ids[i], ids[j]] for i, j in found.edges.tolist()]
    if found.weights is None:
        return ends
    weighted = zip(ends, found.weights.tolist(), strict=True)
    return [pair if weight == 1 else {"ends": pair, "weight": weight} for pair, weight in weighted]


def _columns(
    found: Found, ids: Sequence[int | str], labels: Sequence[str | None], b: Array | None
) -> dict[str, NDArray[Any]]:
    arrays: dict[str, NDArray[Any]] = {"edges": found.edges, "ids": archive.id_array(ids)}
    if found.weights is not None:
        arrays["weights"] = found.weights
    if b is not None:
        arrays["b"] = b
    if any(labels):
        arrays["labels"] = np.array([label or "" for label in labels])
    if found.positions is not None and not np.isnan(found.positions).all():
        arrays["positions"] = found.positions
    if found.samples is not None:
        nodes = np.flatnonzero(found.samples.any(axis=1))
        arrays |= {"w 0 samples nodes": nodes, "w 0 samples values": found.samples[nodes]}
    return arrays


def _name(text: str) -> str:
    name = re.sub(r"[^A-Za-z0-9_.-]+", "_", text).strip("._-")[:64]
    return name or "imported"
