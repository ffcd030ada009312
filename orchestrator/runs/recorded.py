"""The rows of a run: its steps, nodes and edges, and the columns of its tables as arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hedgerow.orchestrator.metrics.verdict import Verdict
from hedgerow.orchestrator.runs.rows import frozen, spread
from hedgerow.orchestrator.runs.selection import Selection, selection
from hedgerow.orchestrator.runs.table import Table
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.escape import command
from hedgerow.topologies.graph import Array, Index
from hedgerow.topologies.schema import Topology

NodeId = int | str


@dataclass(frozen=True, eq=False, repr=False)
class RecordedRows:
    """A run of T steps, n nodes and E edges in its folder. A row that was not recorded is missing in every array."""

    folder: Path
    """The run folder (docs/run-folder.md)."""
    topology: Topology
    """The resolved network, with every fault of the run."""
    verdict: Verdict
    """The verdict; its word is empty while the run is in progress, and after `up` was killed."""
    events: Sequence[Mapping[str, Any]]
    """The lines of events.jsonl, one mapping per event."""
    tables: Mapping[str, Table]
    """The tables telemetry and edges, and the summary if there is one."""

    def __post_init__(self) -> None:
        if self.topology.steps < self.T:
            raise UserError(
                f"{self.folder}: {self.T} steps of a run of {self.topology.steps}: the files are of two runs",
                code=Code.FILE_FORMAT,
            )
        if not (self.recorded < self.T).any():
            raise UserError(f"{self.folder}: no whole step of the run is recorded yet", code=Code.RUN_MISSING)

    @cached_property
    def selection(self) -> Selection:
        """Return the steps, nodes and edges that have rows."""
        return selection(self.topology)

    @property
    def whole(self) -> bool:
        """Return True if every step of every node has rows."""
        return self.selection.whole

    def need_all(self, what: str) -> None:
        """Raise UserError if some rows were not recorded; `what` names the purpose that needs them."""
        if not self.whole:
            again = command(["orchestrator", "simulate", self.folder, "--set", "record={nodes: all}"])
            raise UserError(
                f"{self.folder}: {what} needs all rows, and the run has {self.selection}; it can be run again with all"
                f" of them, to the same bits: {again}",
                code=Code.NOT_RECORDED,
            )

    @property
    def name(self) -> str:
        """Return the name of the run folder."""
        return self.folder.name

    @cached_property
    def T(self) -> int:  # noqa: N802 (the paper's name)
        """Return T, the number of recorded steps. The arrays of inputs have T rows. The arrays of states have T + 1."""
        steps, edges = self.recorded, len(self.edges)
        if not edges or not len(steps):
            return int(steps[-1]) if len(steps) else 0
        behind = self.tables["edges"].steps(edges)
        if self.whole:
            return min(int(steps[-1]), int(behind[-1]) + 1 if len(behind) else 0)
        # The rows of edges follow those of nodes: use the steps that have both, and the state of the next row.
        return int(steps[min(len(behind), len(steps) - 1)]) if len(behind) else 0

    @property
    def steps(self) -> int:
        """Return the number of steps, T."""
        return self.T

    @cached_property
    def ids(self) -> tuple[int | str, ...]:
        """Return the node ids in the order of the columns."""
        every = self.topology.ids
        return tuple(every) if self.selection.all_nodes else tuple(every[k] for k in self.selection.nodes.tolist())

    @cached_property
    def edges(self) -> Index:
        """Return the positions in `ids` of the two ends of each edge, -1 for a node without rows, (E, 2)."""
        places = np.full(self.topology.graph.n, -1)
        places[self.selection.nodes] = np.arange(len(self.selection.nodes))
        return frozen(places[self.topology.graph.edges[self.selection.edges]])

    @cached_property
    def rows(self) -> Index:
        """Return the steps up to T that have rows, ascending, (K,)."""
        return frozen(self.recorded[self.recorded <= self.T].copy())

    @cached_property
    def lost(self) -> Index:
        """Return the steps before T that lost their telemetry, (L,)."""
        due = np.arange(self.T)
        if not self.whole and "summary" in self.tables:
            return frozen(np.setdiff1d(due, self.tables["summary"].steps(1)))
        return frozen(np.setdiff1d(due[self.selection.rows(due)], self.recorded))

    @cached_property
    def recorded(self) -> Index:
        """The step of each row of telemetry, (K,), or (K + 1,) with a step after T."""
        return frozen(self.tables["telemetry"].steps(len(self.ids)) if self.ids else self._summary.steps(1))

    def column(self, node: NodeId) -> int:
        """Return the column of a node in the arrays: `run.x[:, run.column(4)]`. Raises UserError."""
        try:
            return self.ids.index(node)
        except ValueError:
            raise UserError(
                f"{node!r} is no node; the nodes are {', '.join(map(str, self.ids[:12]))}", code=Code.OPTION
            ) from None

    @property
    def _summary(self) -> Table:
        if "summary" not in self.tables:
            raise UserError(f"{self.folder}: has no summary, by `record:` of its topology.yaml", code=Code.NOT_RECORDED)
        return self.tables["summary"]

    def _summed(self, name: str, rows: int) -> Array:
        """Return a column of the summary, (rows,)."""
        return spread(self._summary.column(name, 1)[:, 0].astype(np.float64), self._summary.steps(1), rows, np.nan)

    def _of_nodes(self, name: str, rows: int, missing: float) -> Array:
        if not self.ids:
            return frozen(np.empty((rows, 0)))
        return spread(self.tables["telemetry"].column(name, len(self.ids)), self.recorded, rows, missing)

    def _of_edges(self, name: str, missing: Any) -> NDArray[Any]:
        table, width = self.tables["edges"], len(self.edges)
        if not width:
            return frozen(np.empty((self.T, 0), type(missing)))
        return spread(table.column(name, width), table.steps(width), self.T, missing)

    def _by_step(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return one row per step from one row per recorded step."""
        missing = {"f": np.nan, "i": -1}[values.dtype.kind]
        return spread(values, self.recorded, self.T, missing)
