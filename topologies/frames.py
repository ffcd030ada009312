"""Samples as tables with one column per node: data frames, Parquet and CSV files with a time column."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from hedgerow.topologies import budget
from hedgerow.topologies.base import node_id
from hedgerow.topologies.errors import Code, FileRefusedError, UserError
from hedgerow.topologies.foreign import csv_problem, not_text
from hedgerow.topologies.graph import LARGEST, Array
from hedgerow.topologies.paths import user_path
from hedgerow.topologies.reading import Times
from hedgerow.topologies.regular_file import read_regular

NodeId = int | str
GROWTH = 20
"""the memory per byte of a Parquet file, which is compressed"""


def of_frame(samples: Any, ids: Sequence[NodeId], times: Times | None, steps: int) -> dict[NodeId, list[float]]:
    """Return the samples of a data frame, a mapping of columns, or a CSV or Parquet file, by node id.

    times: as in `by_steps`; at most `steps` samples are returned. Raise UserError for a column that names no node, for
    values that are not numbers, and for too few samples.
    """
    name = str(samples) if isinstance(samples, str | Path) else "the samples"
    try:
        table = by_steps(name, _columns(name, samples), ids, times)
    except FileRefusedError as error:
        cure = error.cure[:1].upper() + error.cure[1:]
        text = f"{error.what.rstrip('.')}." + (f" {cure.rstrip('.')}." if cure else "")
        raise UserError(text, code=error.code) from None
    except OSError as error:
        raise UserError(f"{name}: {error.strerror}. Check the path.", code=Code.FILE_UNREADABLE) from None
    found = min(map(len, table.values()), default=0)
    if found < steps:
        raise UserError(
            f"{name}: {found} samples are too few for {steps} steps. Add samples, or lower `steps`.",
            code=Code.TOPOLOGY,
        )
    return {node: values[:steps] for node, values in table.items()}


def _columns(name: str, samples: Any) -> dict[Any, Any]:
    """Return the columns of a data frame, a mapping, or a file."""
    if not isinstance(samples, str | Path):
        return columns_of(samples)
    path = user_path(name)
    return parquet(path) if path.suffix.lower() == ".parquet" else _csv(path)


def columns_of(frame: Any) -> dict[Any, Any]:
    """Return the columns of a data frame of pandas, polars or pyarrow, or of a mapping, without an index."""
    if hasattr(frame, "to_pydict"):
        return dict(frame.to_pydict())
    if hasattr(frame, "iloc"):
        named = frame.index.name is not None and frame.index.name not in frame.columns
        frame = frame.reset_index() if named else frame
        _once("the samples", list(frame.columns))
        return {column: frame[column].to_numpy() for column in frame.columns}
    if hasattr(frame, "get_columns"):
        return {column.name: column.to_numpy() for column in frame.get_columns()}
    return {key: list(values) for key, values in dict(frame).items()}


def parquet(path: Path) -> dict[Any, Any]:
    """Return the columns of a Parquet file; raise FileRefusedError for another file."""
    import pyarrow as pa  # noqa: PLC0415
    import pyarrow.parquet as pq  # noqa: PLC0415 (a tenth of a second)

    data = read_regular(path, growth=GROWTH)
    try:
        file = pq.ParquetFile(io.BytesIO(data))
        # A few bytes of a compressed file can hold many numbers.
        cells = file.metadata.num_rows * file.metadata.num_columns
        if why := budget.excess(cells * 40):
            raise FileRefusedError(f"{path}: {why}", code=Code.FILE_TOO_LARGE)
        table = file.read()
    except (pa.ArrowException, OSError, ValueError) as error:
        if isinstance(error, FileRefusedError):
            raise
        raise FileRefusedError(f"{path}: is no Parquet file: {str(error)[:200]}") from None
    names = [name for name in table.column_names if not name.startswith("__index_level_")]
    _once(str(path), names)
    return {name: table.column(name).to_numpy() for name in names}


def _csv(path: Path) -> dict[Any, Any]:
    """Return the columns of a CSV file with a header."""
    import csv  # noqa: PLC0415

    try:
        reader = csv.reader(io.StringIO(read_regular(path, growth=60).decode("utf-8-sig")))
        numbered = [(reader.line_num, row) for row in reader if row]
    except (UnicodeDecodeError, csv.Error) as error:
        why = not_text(error.object, error) if isinstance(error, UnicodeDecodeError) else csv_problem(error)
        raise FileRefusedError(f"{path}: cannot be read: {why}", "Save it as CSV in UTF-8") from None
    rows = [row for _, row in numbered]
    for line, row in numbered:
        if len(row) != len(rows[0]):
            raise FileRefusedError(
                f"{path}:{line}: has {len(row)} cells, not {len(rows[0])}", "write one cell per column"
            )
    if len(rows) < 2:
        raise FileRefusedError(f"{path}: has no samples below a header", "write a header, and a row per step")
    names = [name.strip() for name in rows[0]]
    _once(str(path), names)
    return {name: [row[k] for row in rows[1:]] for k, name in enumerate(names)}


def _once(name: str, columns: Sequence[Any]) -> None:
    """Raise FileRefusedError if two columns have one name: only one of them would be used."""
    seen: set[Any] = set()
    for column in columns:
        if column in seen:
            raise FileRefusedError(f"{name}: two columns are named {str(column)[:40]!r}", "give each its own name")
        seen.add(column)


def by_steps(
    name: str, columns: Mapping[Any, Any], ids: Sequence[NodeId], times: Times | None
) -> dict[NodeId, list[float]]:
    """Return one sample per step from the columns that name nodes; raise FileRefusedError for other columns and values.

    times: the column of times, which ascend; t = 0 is the first one. Without it, a row is a step. A step is a time in
    the unit of the column, or in seconds if it holds dates. `hold` takes the last sample at or before a step, `linear`
    interpolates, `mean` averages the samples within a step.
    """
    if times is not None and times.resample not in (None, "hold", "linear", "mean"):
        raise FileRefusedError(f"{name}: `resample: {times.resample}` is unknown", "write hold, linear or mean")
    if times is not None and times.step is not None and not 0 < times.step < math.inf:
        raise FileRefusedError(f"{name}: `step` {times.step!r} is not above 0", "write the time of one step")
    time = None if times is None else times.column
    stamps: Array | None = None
    known = set(ids)
    table: dict[NodeId, Array] = {}
    for key, values in columns.items():
        if time is not None and str(key) == time:
            stamps = _times(name, time, values)
            continue
        node = node_id(key.item() if isinstance(key, np.generic) else key)
        if node not in known:
            others = ", ".join(map(str, list(ids)[:8]))
            cure = f"the nodes are {others}" if time else f"the nodes are {others}; name a column of times with `time`"
            raise FileRefusedError(f"{name}: the column {str(key)[:40]!r} names no node", cure)
        _once(name, [*table, node])
        table[node] = _numbers(name, key, values)
    if time is not None and stamps is None:
        raise FileRefusedError(f"{name}: has no column {time!r}", "name the column of times with `time`")
    if not table:
        raise FileRefusedError(f"{name}: has no column that names a node", "name the columns by node ids")
    if times is None or stamps is None:
        return {node: values.tolist() for node, values in table.items()}
    return _resampled(name, stamps, table, times.step, times.resample or "hold")


def _resampled(
    name: str, times: Array, table: dict[NodeId, Array], step: float | None, resample: str
) -> dict[NodeId, list[float]]:
    pace = float(step if step is not None else times[1] - times[0] if len(times) > 1 else 1.0)
    # Times such as 0.1, 0.2, 0.3 are not exact multiples: a step just below a sample is at the sample.
    slack = 1e-9 * pace
    count = math.floor((times[-1] + slack) / pace) + 1
    # A short step and a long gap make many samples of a small file.
    if why := budget.excess(count * 40 * (2 + len(table))):
        raise FileRefusedError(f"{name}: {count:,} steps of {pace:g}: {why}", code=Code.FILE_TOO_LARGE)
    at = np.arange(count) * pace
    last = np.searchsorted(times, at + slack, side="right") - 1
    found: dict[NodeId, list[float]] = {}
    for node, values in table.items():
        if resample == "linear":
            steps = np.interp(at, times, values)
        elif resample == "mean":
            home = np.minimum(np.floor((times + slack) / pace).astype(np.int64), count - 1)
            number = np.bincount(home, minlength=count)
            total = np.bincount(home, values, count)
            steps = np.where(number > 0, total / np.maximum(number, 1), values[last])
        else:
            steps = values[last]
        found[node] = steps.tolist()
    return found


def _times(name: str, time: str, values: Any) -> Array:
    """Return the times of a column from 0: its numbers, or the seconds since its first date."""
    array = np.asarray(values)
    if not len(array):
        raise FileRefusedError(f"{name}: has no rows", "write a row per time")
    if array.dtype.kind in "mM":
        seconds = (array - array[0]) / np.timedelta64(1, "s")
    else:
        try:
            seconds = array.astype(float)
        except (TypeError, ValueError):
            try:
                dates = [
                    one if isinstance(one, datetime) else datetime.fromisoformat(str(one).strip()) for one in array
                ]
                seconds = np.array([(date - dates[0]).total_seconds() for date in dates])
            except (TypeError, ValueError):
                raise FileRefusedError(
                    f"{name}: the column {time!r} holds neither numbers nor dates", "write numbers, or 2026-01-31T08:00"
                ) from None
    seconds = np.asarray(seconds, dtype=float)
    rising = np.isfinite(seconds) & (np.diff(seconds, prepend=-math.inf) > 0)
    if not rising.all():
        row = int(rising.argmin()) + 1
        raise FileRefusedError(
            f"{name}: row {row}: the times in {time!r} do not ascend", "sort the rows, and keep each time once"
        )
    return np.asarray(seconds - seconds[0])


def _numbers(name: str, key: object, values: Any) -> Array:
    try:
        array = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        array = np.array([np.nan])
    if not (good := np.abs(array) <= LARGEST).all():
        row = int(good.argmin()) + 1
        raise FileRefusedError(
            f"{name}: row {row} of the column {str(key)[:40]!r} is not a finite number below {LARGEST:g}",
            "write a number such as 0.5",
        )
    return array
