"""The tables of a run: telemetry.parquet with one row per step and node, edges.parquet with one row per step and edge,
and summary.parquet with one row per step. `record:` of the topology selects the nodes and steps of the first two.

During the run, rows are in Arrow streams, which can be read up to their last batch after any end. At the end they
become Parquet, in row groups of one size, so equal runs have equal files.
"""

from __future__ import annotations

import functools
import os
import zlib
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from hedgerow.orchestrator.ground.spelling import spelled
from hedgerow.orchestrator.metrics.fault_accounts import at_ends
from hedgerow.orchestrator.metrics.observer import Batch, Observer
from hedgerow.orchestrator.runs.columns import column, names
from hedgerow.orchestrator.runs.selection import selection
from hedgerow.topologies.archive import id_array
from hedgerow.topologies.graph import Array, Index
from hedgerow.topologies.schema import Topology
from hedgerow.wire.message import End

if TYPE_CHECKING:
    from hedgerow.orchestrator.metrics.gain_certificate import GainCertificate

ROW_GROUP = 2**16
STEPS_AT_ONCE = 64
Change = Callable[[pa.Table], pa.Table]


def _id_type(topology: Topology) -> pa.DataType:
    return pa.int64() if id_array(topology.ids).dtype == np.int64 else pa.string()


def id_column(topology: Topology, positions: Index) -> pa.Array:
    """Return the ids of some nodes as the tables hold them: numbers if all of them are, else text."""
    if _id_type(topology) == pa.int64():
        return column(id_array(topology.ids)[positions])
    return names([str(topology.ids[k]) for k in positions.tolist()])


class _Table:
    """One growing table: an Arrow stream while it grows, a Parquet file once it is closed."""

    def __init__(self, folder: Path, name: str, schema: pa.Schema) -> None:
        self.stream = folder / f"{name}.arrows"
        self.parquet = folder / f"{name}.parquet"
        self.schema = schema
        self._file = pa.OSFile(spelled(self.stream), "wb")
        self._writer = pa.ipc.new_stream(self._file, schema)
        self._full = False

    def append(self, columns: dict[str, pa.Array]) -> None:
        """Append some rows; raise OSError when the disk is full, and then the stream ends with the last complete
        rows.
        """
        arrays = [columns[name] for name in self.schema.names]
        whole = self._file.tell()
        try:
            self._writer.write_batch(pa.RecordBatch.from_arrays(arrays, schema=self.schema))
        except OSError:
            # A partial row is useless, and the verdict needs the space.
            self._full = True
            os.truncate(self.stream, whole)
            raise

    def close(self, change: Change | None = None) -> None:
        """Turn the stream into the Parquet file; `change` may replace columns of its parts."""
        if not self.stream.exists():
            return
        if not self._full:  # otherwise the end of the stream would follow a gap
            self._writer.close()
        elif not self.stream.stat().st_size:  # there was not even room for the names of the columns
            return
        to_parquet(self.stream, self.parquet, change)
        self.stream.unlink()


def to_parquet(stream: Path, parquet: Path, change: Change | None = None) -> None:
    """Turn an Arrow stream, complete or not, into a Parquet file, which is written completely or not at all.

    `change` may replace columns of each part.
    """
    part = parquet.with_suffix(".parquet.part")
    try:
        with (
            pa.OSFile(spelled(stream), "rb") as source,
            pa.ipc.open_stream(source) as reader,
            pq.ParquetWriter(spelled(part), reader.schema) as writer,
        ):
            for table in _row_groups(reader):
                writer.write_table(table if change is None else change(table), row_group_size=ROW_GROUP)
        part.rename(parquet)
    finally:
        part.unlink(missing_ok=True)


def _row_groups(reader: Any) -> Iterator[pa.Table]:
    """Yield the stream as tables of a multiple of ROW_GROUP rows, and the rest."""
    waiting: list[pa.RecordBatch] = []
    rows = 0
    for batch in whole_batches(reader):
        waiting.append(batch)
        rows += batch.num_rows
        if rows >= ROW_GROUP:
            table, whole = pa.Table.from_batches(waiting), rows - rows % ROW_GROUP
            yield table.slice(0, whole)
            waiting, rows = table.slice(whole).to_batches(), rows - whole
    if rows:
        yield pa.Table.from_batches(waiting)


def whole_batches(reader: Any) -> Iterator[pa.RecordBatch]:
    """Yield the batches of an Arrow stream, up to the point where the writer was killed."""
    while True:
        try:
            yield reader.read_next_batch()
        except (
            StopIteration,
            pa.ArrowInvalid,
            OSError,
        ):  # the end, or the point where the writer was killed
            return


CLAIMS = ("ceiling", "ceiling_slack")
"""The columns of the certificate of the law: null without a claim."""
SUMMARY = {
    "step": "int64",
    **dict.fromkeys(("x_sum", "x_max", "u_sum", "u_max", "regret_max"), "double"),
    **dict.fromkeys(("regret_sum", "nominal_regret_sum"), "double"),
    **dict.fromkeys(("cost", "cost_oracle", "cost_sum", "cost_oracle_sum", "energy_sum"), "double"),
    **dict.fromkeys(CLAIMS, "double"),
    **dict.fromkeys(("right", "missing", "edges_cut", "messages_lost", "checksum"), "int64"),
}
"""The columns of summary.parquet."""


def summary(batch: Batch) -> dict[str, NDArray[Any]]:
    """Return the facts of the whole network at each step of a batch, by name of the column, (B,)."""
    x, u, missing = np.abs(batch.x), np.abs(batch.u), batch.missing
    if missing.any():
        u[missing] = 0.0
    return {
        "step": batch.t,
        "x_sum": x.sum(axis=1),
        "x_max": x.max(axis=1),
        "u_sum": u.sum(axis=1),
        "u_max": u.max(axis=1),
        "regret_max": batch.regret.max(axis=1),
        **{name: getattr(batch, name) for name in ("regret_sum", "nominal_regret_sum", "cost", "cost_oracle")},
        **{name: getattr(batch, name) for name in ("cost_sum", "cost_oracle_sum", "energy_sum", "right")},
        **{name: getattr(batch, name) for name in CLAIMS},
        "missing": missing.sum(axis=1),
        "edges_cut": batch.edge_open.shape[1] - np.count_nonzero(batch.edge_open, axis=1),
        "messages_lost": batch.link_up.shape[1] - np.count_nonzero(batch.link_up, axis=1),
        "checksum": checksums(
            *(batch.x, batch.u, batch.w, batch.ahat, batch.index),
            # The table has null for an infinite margin: the checksum can be computed again from the tables.
            np.where(np.isfinite(batch.margin), batch.margin, np.nan),
            *(batch.edge_open, batch.link_up),
        ),
    }


def end_summary(observer: Observer, end: End) -> dict[str, NDArray[Any]]:
    """Return the facts of the final state, by name of the column, (1,)."""
    x = np.abs(end.x)
    last = {
        "x_sum": x.sum(),
        "x_max": x.max(),
        "regret_max": np.abs(end.x - observer.x_oracle_end).max(),
        "regret_sum": observer.regret_sum,
        "nominal_regret_sum": observer.nominal_regret_sum,
    }
    known = {name: np.array([value]) for name, value in last.items()}
    return known | {"step": np.array([end.t]), "checksum": checksums(end.x[None])}


def checksums(*columns: NDArray[Any]) -> Index:
    """Return a CRC-32 of each row over some arrays: all NaN are equal, and so are all nulls of a table."""
    same = [
        np.where(np.isnan(one), np.nan, one) if one.dtype.kind == "f" and np.isnan(one).any() else one
        for one in columns
    ]
    rows = [np.ascontiguousarray(one) for one in same]
    return np.array([functools.reduce(lambda crc, one: zlib.crc32(one[k], crc), rows, 0) for k in range(len(rows[0]))])


class Recorder:
    """The writer of the observer's results to the tables of a run folder; OSError when the disk is full."""

    def __init__(self, topology: Topology, folder: Path) -> None:
        node = _id_type(topology)
        f8 = pa.float64()
        self._selection = selection(topology)
        self._nodes, self._e = self._selection.nodes, self._selection.edges
        ends = topology.graph.edges[self._e]
        self._hears = at_ends(topology.graph)[self._e]
        self._ids = id_column(topology, self._nodes)
        self._i, self._j = (id_column(topology, ends[:, end]) for end in (0, 1))
        floats = [(name, f8) for name in ("x", "u", "w", "ahat")]
        self._telemetry = _Table(
            folder,
            "telemetry",
            pa.schema(
                [
                    ("step", pa.int64()),
                    ("node", node),
                    *floats,
                    ("index", pa.int32()),
                    ("margin", f8),
                    ("x_oracle", f8),
                    ("x_nominal", f8),
                ]
            ),
        )
        self._edge_inputs = _Table(
            folder,
            "edges",
            pa.schema(
                [
                    ("step", pa.int64()),
                    ("i", node),
                    ("j", node),
                    ("u_edge", f8),
                    ("open", pa.bool_()),
                    ("i_hears", pa.bool_()),
                    ("j_hears", pa.bool_()),
                ]
            ),
        )
        columns = [(name, {"int64": pa.int64(), "double": f8}[kind]) for name, kind in SUMMARY.items()]
        self._summary = _Table(folder, "summary", pa.schema(columns)) if topology.record.summary else None

    def write(self, batch: Batch) -> None:
        """Append the rows of one batch."""
        if self._summary is not None:
            values = summary(batch)
            nulls = {name: np.isnan(values[name]) for name in CLAIMS}
            self._summary.append({name: column(one, nulls.get(name)) for name, one in values.items()})
        rows = self._selection.rows(batch.t)
        t, n, e = batch.t[rows], len(self._nodes), len(self._e)

        def of(values: NDArray[Any], columns: Index) -> NDArray[Any]:
            if len(rows) < len(values):
                values = values[rows]
            return values if len(columns) == values.shape[1] else values[:, columns]

        telemetry: dict[str, pa.Array] = {}
        edges: dict[str, pa.Array] = {}
        if len(rows) and n:
            u, ahat, margin = (of(values, self._nodes) for values in (batch.u, batch.ahat, batch.margin))
            unknown = np.isnan(ahat)
            states = ("x", "w", "x_oracle", "x_nominal")
            telemetry = {
                "step": column(np.repeat(t, n)),
                "node": pa.concat_arrays([self._ids] * len(rows)),
                **{name: column(of(getattr(batch, name), self._nodes)) for name in states},
                "u": column(u, np.isnan(u)),
                "ahat": column(ahat, unknown),
                "index": column(of(batch.index, self._nodes), unknown),
                "margin": column(margin, ~np.isfinite(margin)),
            }
        if len(rows) and e:
            edges = {
                "step": column(np.repeat(t, e)),
                "i": pa.concat_arrays([self._i] * len(rows)),
                "j": pa.concat_arrays([self._j] * len(rows)),
                "u_edge": column(of(batch.u_edge, self._e)),
                "open": column(of(batch.edge_open, self._e)),
                "i_hears": column(of(batch.link_up, self._hears[:, 0])),
                "j_hears": column(of(batch.link_up, self._hears[:, 1])),
            }
        # Write a few steps at a time: when the disk is full, only the last of them are lost.
        for first in range(0, len(rows), STEPS_AT_ONCE):
            for table, columns, width in ((self._telemetry, telemetry, n), (self._edge_inputs, edges, e)):
                if columns:
                    table.append({k: one.slice(first * width, STEPS_AT_ONCE * width) for k, one in columns.items()})

    def write_end(self, observer: Observer, end: End) -> None:
        """Append the last states: at step T no input acts, so all other columns are null."""
        nodes, n = self._nodes, len(self._nodes)
        nothing = {name: pa.nulls(n, pa.float64()) for name in ("u", "w", "ahat", "margin")}
        if n:
            self._telemetry.append(
                {
                    "step": column(np.full(n, end.t)),
                    "node": self._ids,
                    "x": column(end.x[nodes]),
                    **nothing,
                    "index": pa.nulls(n, pa.int32()),
                    "x_oracle": column(observer.x_oracle_end[nodes]),
                    "x_nominal": column(observer.x_nominal_end[nodes]),
                }
            )
        if self._summary is not None:
            known = end_summary(observer, end)
            nulls = {field.name: pa.nulls(1, field.type) for field in self._summary.schema}
            self._summary.append(nulls | {name: column(value) for name, value in known.items()})

    def close(self, certificate: GainCertificate | None = None) -> None:
        """Turn the streams into Parquet files, with the claims of a certificate at steps that came before its bounds.

        So the file does not depend on the time that the bounds took.
        """
        self._telemetry.close()
        self._edge_inputs.close()
        if self._summary is not None:
            self._summary.close(None if certificate is None else partial(_with_claims, certificate.late_claims()))


def _with_claims(claims: tuple[Index, Array, Array], table: pa.Table) -> pa.Table:
    """Return a part of the summary with the claims (steps, bounds, slacks) at some steps."""
    steps, *values = claims
    # `to_numpy` of a column in chunks would load pandas.
    own = np.array(table["step"].to_pylist())
    here = np.isin(own, steps)
    for name, late in zip(CLAIMS, values, strict=True) if here.any() else ():
        known = np.array(table[name].to_pylist(), dtype=np.float64)
        known[here] = late[np.searchsorted(steps, own[here])]
        table = table.set_column(table.schema.get_field_index(name), name, column(known, np.isnan(known)))
    return table
