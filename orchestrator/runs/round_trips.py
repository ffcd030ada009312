"""The answer times of each process: a table of every step, and the percentiles of the whole run.

The times are of the wall clock and differ from run to run, so they are not in the tables that are equal bit for bit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from hedgerow.orchestrator.ground.assignment import process_names
from hedgerow.orchestrator.ground.spelling import spelled
from hedgerow.orchestrator.runs.columns import column, names
from hedgerow.orchestrator.runs.writer import to_parquet
from hedgerow.topologies.schema import Topology
from hedgerow.wire.message import RoundTripTimes

TABLE = "round_trips"
SCHEMA = pa.schema([("step", pa.int64()), ("process", pa.string()), ("round_trip_ms", pa.float64())])
SHORTEST_MS, RATIO, BINS = 1e-3, 1.02, 1200
"""A long run has too many times to sort: they are counted in bins, each wider than the last by this ratio."""
PERCENTILES = {"median_ms": 0.5, "p99_ms": 0.99}
SHOWN = 3
"""The maximum number of processes in a line; with more, it shows the slowest."""


class RoundTrips:
    """The answer times of a run, process by process; OSError when the disk is full."""

    def __init__(self, processes: Sequence[str], folder: Path) -> None:
        self._processes, self._names = processes, names(processes)
        self._counts = np.zeros((len(processes), BINS), np.int64)
        self._max = np.zeros(len(processes))
        self._stream, self._parquet = folder / f"{TABLE}.arrows", folder / f"{TABLE}.parquet"
        self._writer = pa.ipc.new_stream(pa.OSFile(spelled(self._stream), "wb"), SCHEMA)

    def take(self, round_trips: RoundTripTimes) -> None:
        """Record the answer times of some steps."""
        ms = np.round(1e3 * round_trips.seconds, 3)
        steps, p = ms.shape
        there = ~np.isnan(ms)
        process = np.broadcast_to(np.arange(p), ms.shape)[there]
        place = np.log(np.maximum(ms[there], SHORTEST_MS) / SHORTEST_MS) / np.log(RATIO)
        where = process * BINS + np.minimum(place.astype(np.int64), BINS - 1)
        self._counts += np.bincount(where, minlength=p * BINS).reshape(p, BINS)
        self._max = np.fmax(self._max, np.fmax.reduce(ms, axis=0))
        columns = [
            column(np.repeat(np.arange(round_trips.t, round_trips.t + steps), p)),
            pa.concat_arrays([self._names] * steps),
            column(ms, ~there),
        ]
        self._writer.write_batch(pa.RecordBatch.from_arrays(columns, schema=SCHEMA))

    def close(self) -> None:
        """Turn the table into a Parquet file."""
        if self._stream.exists():
            self._writer.close()
            to_parquet(self._stream, self._parquet)
            self._stream.unlink()

    def summary(self) -> dict[str, dict[str, float | int | None]]:
        """Return the statistics by process as in verdict.json: `answers`, and percentiles with an error of 1 %."""
        return {
            name: _figures(counts, float(most))
            for name, counts, most in zip(self._processes, self._counts, self._max, strict=True)
        }


def processes_of(folder: Path, topology: Topology) -> list[str]:
    """Return the names of the processes with answer times in a run folder; empty for a run without Zenoh."""
    there = any((folder / f"{TABLE}.{kind}").exists() for kind in ("arrows", "parquet"))
    return process_names(topology) if there else []


def trips_in(batch: pa.RecordBatch) -> RoundTripTimes:
    """Return the answer times in a batch of the table."""
    step = batch["step"].to_numpy()
    steps = int(step[-1] - step[0]) + 1
    return RoundTripTimes(int(step[0]), batch["round_trip_ms"].to_numpy(zero_copy_only=False).reshape(steps, -1) / 1e3)


def _figures(counts: Any, most: float) -> dict[str, float | int | None]:
    total = int(counts.sum())
    if not total:
        return {"answers": 0, **dict.fromkeys((*PERCENTILES, "max_ms"))}
    reached = np.cumsum(counts)
    places = {name: int(np.searchsorted(reached, share * total)) for name, share in PERCENTILES.items()}
    middles = {name: min(most, SHORTEST_MS * RATIO ** (place + 0.5)) for name, place in places.items()}
    return {"answers": total, **middles, "max_ms": most}


def line(summary: Mapping[str, Mapping[str, Any]]) -> str:
    """Return one line about the slowest processes; empty without answers."""
    answered = [(name, figures) for name, figures in summary.items() if figures["answers"]]
    if not answered:
        return ""
    if len(answered) > SHOWN:
        answered = sorted(answered, key=lambda one: -one[1]["p99_ms"])[:SHOWN]
    parts = (
        f"{name} " + "/".join(f"{figures[key]:.3g}" for key in (*PERCENTILES, "max_ms")) for name, figures in answered
    )
    which = f", the slowest of {len(summary)}" if len(summary) > len(answered) else ""
    return f"round trips, median/99 %/most [ms]{which}: {', '.join(parts)}"
