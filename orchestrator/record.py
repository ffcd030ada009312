"""The tables of a run: telemetry.parquet, one row a step and node, and edges.parquet, one row a step and edge.

While the run goes on, rows are kept in Arrow streams, which can be read up to their last batch however the run
ends; at the end they become Parquet, in row groups of one size, so that equal runs leave equal files.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from orchestrator.accounts import at_ends
from orchestrator.columns import column, names
from orchestrator.observe import Batch, Observer
from topologies.graph import Index
from topologies.schema import Topology
from wire.codec import End

ROW_GROUP = 2**16


def _id_type(topology: Topology) -> pa.DataType:
    return pa.int64() if all(isinstance(node, int) for node in topology.ids) else pa.string()


def _ids(topology: Topology, positions: Index) -> pa.Array:
    if _id_type(topology) == pa.int64():
        return column(np.array(topology.ids, dtype=np.int64)[positions])
    return names([str(topology.ids[k]) for k in positions])


class _Table:
    """One growing table: an Arrow stream while it grows, a Parquet file once it is closed."""

    def __init__(self, folder: Path, name: str, schema: pa.Schema) -> None:
        self.stream = folder / f"{name}.arrows"
        self.parquet = folder / f"{name}.parquet"
        self._schema = schema
        self._writer = pa.ipc.new_stream(pa.OSFile(str(self.stream), "wb"), schema)

    def append(self, columns: dict[str, pa.Array]) -> None:
        arrays = [columns[name] for name in self._schema.names]
        self._writer.write_batch(pa.RecordBatch.from_arrays(arrays, schema=self._schema))

    def close(self) -> None:
        if not self.stream.exists():
            return
        self._writer.close()
        to_parquet(self.stream, self.parquet)
        self.stream.unlink()


def to_parquet(stream: Path, parquet: Path) -> None:
    """Turn an Arrow stream, whole or cut short, into a Parquet file, which is there whole or not at all."""
    part = parquet.with_suffix(".parquet.part")
    try:
        with (
            pa.OSFile(str(stream), "rb") as source,
            pa.ipc.open_stream(source) as reader,
            pq.ParquetWriter(part, reader.schema) as writer,
        ):
            for table in _row_groups(reader):
                writer.write_table(table, row_group_size=ROW_GROUP)
        part.rename(parquet)
    finally:
        part.unlink(missing_ok=True)


def _row_groups(reader: Any) -> Iterator[pa.Table]:
    """The stream as tables of a multiple of ROW_GROUP rows, and the rest."""
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
    """The batches of an Arrow stream, up to where a writer that was killed left off."""
    while True:
        try:
            yield reader.read_next_batch()
        except (
            StopIteration,
            pa.ArrowInvalid,
            OSError,
        ):  # the end, or where a killed writer left off
            return


class Recorder:
    """Writes what the observer computes to the tables of a run's folder; OSError when the disk is full."""

    def __init__(self, topology: Topology, folder: Path) -> None:
        node = _id_type(topology)
        f8 = pa.float64()
        self._n, self._edges = len(topology.ids), topology.graph.edges
        self._hears = at_ends(topology.graph)
        self._ids = _ids(topology, np.arange(self._n))
        self._i, self._j = (_ids(topology, self._edges[:, end]) for end in (0, 1))
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

    def write(self, batch: Batch) -> None:
        """Append the rows of one batch."""
        rows, e, unknown = len(batch.t), len(self._edges), np.isnan(batch.ahat)
        self._telemetry.append(
            {
                "step": column(np.repeat(batch.t, self._n)),
                "node": pa.concat_arrays([self._ids] * rows),
                **{name: column(getattr(batch, name)) for name in ("x", "w", "x_oracle", "x_nominal")},
                "u": column(batch.u, np.isnan(batch.u)),
                "ahat": column(batch.ahat, unknown),
                "index": column(batch.index, unknown),
                "margin": column(batch.margin, ~np.isfinite(batch.margin)),
            }
        )
        if e:
            self._edge_inputs.append(
                {
                    "step": column(np.repeat(batch.t, e)),
                    "i": pa.concat_arrays([self._i] * rows),
                    "j": pa.concat_arrays([self._j] * rows),
                    "u_edge": column(batch.u_edge),
                    "open": column(batch.edge_open),
                    "i_hears": column(batch.link_up[:, self._hears[:, 0]]),
                    "j_hears": column(batch.link_up[:, self._hears[:, 1]]),
                }
            )

    def write_end(self, observer: Observer, end: End) -> None:
        """Append the last states: at step T nothing acts, so all but the states is null."""
        n = self._n
        nothing = {name: pa.nulls(n, pa.float64()) for name in ("u", "w", "ahat", "margin")}
        self._telemetry.append(
            {
                "step": column(np.full(n, end.t)),
                "node": self._ids,
                "x": column(end.x),
                **nothing,
                "index": pa.nulls(n, pa.int32()),
                "x_oracle": column(observer.x_oracle_end),
                "x_nominal": column(observer.x_nominal_end),
            }
        )

    def close(self) -> None:
        """Turn both streams into Parquet files."""
        self._telemetry.close()
        self._edge_inputs.close()
