"""The comparison of a finished run with the in-process reference: equal, different from a step on, or not compared."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

from hedgerow.orchestrator.launch.recording import Recording, same_tables
from hedgerow.orchestrator.launch.simulation import simulate_into
from hedgerow.orchestrator.launch.watching import Watching
from hedgerow.orchestrator.metrics.verdict import Comparison
from hedgerow.orchestrator.runs.folder import RunFolder, create
from hedgerow.orchestrator.views.screen import Quiet
from hedgerow.topologies.errors import HedgerowError, UserError
from hedgerow.topologies.schema import Topology


@dataclass(frozen=True)
class Difference:
    """The first value that differs between two tables."""

    step: int
    node: str
    column: str
    value: object
    reference: object

    def __str__(self) -> str:
        return f"node {self.node}: {self.column} is {self.value!r}, and {self.reference!r} in the reference"


def compare(run: Recording) -> Comparison:
    """Compare the tables of a finished run with those of the in-process reference, bit for bit.

    A failure during the comparison, a signal or a full disk, proves nothing about the run: it is then not compared.
    """
    try:
        run.close_tables()
        with tempfile.TemporaryDirectory(prefix="hedgerow-", ignore_cleanup_errors=True) as scratch:
            return _beside(run.topology, run.folder, create(run.topology, Path(scratch) / "reference"))
    except (OSError, HedgerowError) as error:
        return Comparison(None, cause=str(error))


def _beside(topology: Topology, folder: RunFolder, reference: RunFolder) -> Comparison:
    shards = [range(len(topology.ids))]
    verdict = simulate_into(topology, reference, shards, Watching(record=False), Quiet(), replayed=False)
    if verdict.content["steps_done"] < topology.steps or not reference.verdict.is_file():
        reasons = "; ".join(verdict.content["reasons"]) or "the reference could not be written"
        return Comparison(None, cause=reasons)
    if same_tables(folder.path, reference.path):
        return Comparison(True)
    try:
        difference = first_difference(folder.path, reference.path)
    except UserError as error:  # the tables differ, even if the place cannot be found
        return Comparison(False, cause=f"other tables; {error}")
    if difference is None:
        return Comparison(False, cause="other tables or columns")
    return Comparison(False, step=difference.step, cause=str(difference))


def first_difference(one: Path, other: Path) -> Difference | None:
    """Return the first value in which the telemetry of two run folders differs, or None."""
    from hedgerow.orchestrator.runs.table import Table  # noqa: PLC0415 (Arrow takes a while to load)

    tables = [Table(folder, "telemetry").whole() for folder in (one, other)]
    if tables[0].column_names != tables[1].column_names:
        return None
    rows = min(len(table) for table in tables)
    found: tuple[int, str] | None = None
    for name in tables[0].column_names:
        columns = [table.column(name).slice(0, rows).combine_chunks() for table in tables]
        row = _first_row(*columns)
        if row is not None and (found is None or row < found[0]):
            found = row, name
    if found is None:
        return None
    row, name = found
    mine, theirs = (table.slice(row, 1).to_pylist()[0] for table in tables)
    return Difference(int(mine["step"]), str(mine["node"]), name, mine[name], theirs[name])


def _first_row(mine: object, theirs: object) -> int | None:
    """Return the first row in which two Arrow arrays differ, NaN being equal to NaN; by halves of the arrays."""
    low, high = 0, len(mine)  # type: ignore[arg-type]
    if _equal(mine, theirs, low, high):
        return None
    while high - low > 1:
        middle = (low + high) // 2
        if _equal(mine, theirs, low, middle):
            low = middle
        else:
            high = middle
    return low


def _equal(mine: object, theirs: object, low: int, high: int) -> bool:
    # Compare as text, because Arrow does not treat NaN as equal to itself; repr of a float is exact.
    one, other = (array.slice(low, high - low) for array in (mine, theirs))  # type: ignore[attr-defined]
    return bool(one.equals(other)) or repr(one.to_pylist()) == repr(other.to_pylist())
