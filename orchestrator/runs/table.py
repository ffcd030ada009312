"""A table of a run, as far as it has come: of steps and nodes, of steps and edges, or of steps."""

from __future__ import annotations

import contextlib
import importlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from hedgerow.orchestrator.ground.spelling import spelled
from hedgerow.orchestrator.runs.files import reading
from hedgerow.orchestrator.runs.writer import whole_batches
from hedgerow.topologies.errors import UserError
from hedgerow.topologies.graph import Index

FRAMES = ("arrow", "pandas", "polars")


def there_is(folder: Path, name: str) -> bool:
    """Whether a run left a table, or has begun one."""
    return any((folder / f"{name}.{form}").exists() for form in ("parquet", "arrows"))


class Table:
    """One table of a run: its Parquet file or, as long as there is none, the whole batches of its Arrow stream."""

    def __init__(self, folder: Path, name: str) -> None:
        self.parquet, stream = folder / f"{name}.parquet", folder / f"{name}.arrows"
        self._stream: Any = None
        with contextlib.suppress(FileNotFoundError), reading(stream):  # it has become the Parquet file just now
            if not self.parquet.exists() and stream.exists():
                self._stream = _so_far(stream)
        self.path = self.parquet if self._stream is None else stream
        try:
            with reading(self.parquet):
                self._file = pq.ParquetFile(spelled(self.parquet)) if self._stream is None else None
        except FileNotFoundError:
            raise UserError(f"{folder}: no step of the run is recorded yet: there is no {name}.parquet") from None

    @property
    def over(self) -> bool:
        """Whether the Parquet file is there."""
        return self._file is not None

    @property
    def schema(self) -> Any:
        return self._stream.schema if self._file is None else self._file.schema_arrow

    def whole(self) -> Any:
        """A pyarrow.Table."""
        with reading(self.path):
            return self._stream if self._file is None else self._file.read()

    def batches(self) -> Iterator[Any]:
        """The same in parts that fit into memory."""
        with reading(self.path):
            yield from self._stream.to_batches() if self._file is None else self._file.iter_batches()

    def column(self, name: str, width: int) -> NDArray[Any]:
        """One column, a row a recorded step, (K, width); NaN where a number is null."""
        if name not in self.schema.names:
            raise UserError(f"{self.path}: has no column {name}: another version of hedgerow wrote it")
        with reading(self.path):
            table = self._stream if self._file is None else self._file.read(columns=[name])
            values: NDArray[Any] = table[name].to_numpy()
            if values.dtype.kind not in "fiub":
                raise ValueError(f"column {name} is of type {table[name].type}, or has gaps")
            return values.reshape(-1, width)

    def steps(self, width: int) -> Index:
        """The step of each row of `column`, (K,)."""
        rows = self._stream.num_rows if self._file is None else self._file.metadata.num_rows
        if rows % width:
            raise UserError(f"{self.path}: {rows} rows are no whole steps of {width}; topology.yaml is another's")
        if rows and rows == (self._last_step() + 1) * width:
            return np.arange(rows // width)
        steps: Index = self.column("step", width)[:, 0].astype(np.int64)
        if len(steps) and (steps[0] < 0 or (np.diff(steps) <= 0).any()):
            raise UserError(f"{self.path}: its steps do not ascend; it is damaged")
        return steps

    def _last_step(self) -> int:
        """Of a table with rows in it."""
        if "step" not in self.schema.names:
            return -1
        with reading(self.path):
            table = self._stream
            if self._file is not None:
                table = self._file.read_row_group(self._file.num_row_groups - 1, columns=["step"])
            last = table["step"][-1].as_py()
        return last if isinstance(last, int) else -1

    def frame(self, kind: str) -> Any:
        """All of it: a pyarrow.Table, or a frame of "pandas" or "polars"."""
        if kind not in FRAMES:
            raise UserError(f"{kind!r} is no kind of table; there are {', '.join(FRAMES)}")
        if kind == "arrow":
            return self.whole()
        try:
            library = importlib.import_module(kind)
        except ModuleNotFoundError as error:
            if error.name != kind:
                raise
            raise UserError(f"{kind} is not installed; install it with: pip install {kind}") from None
        if kind == "polars":
            return library.from_arrow(self.whole())
        # With nulls in it, a column of whole numbers would become one of floats.
        return self.whole().to_pandas(types_mapper={pa.int32(): library.Int32Dtype()}.get)


def _so_far(stream: Path) -> Any:
    """An Arrow stream as a table that stays in the file, up to its last whole batch."""
    try:
        reader = pa.ipc.open_stream(pa.memory_map(spelled(stream)))
    except pa.ArrowInvalid:  # not even what the columns are
        raise UserError(f"{stream.parent}: no step of the run is recorded yet") from None
    table = pa.Table.from_batches(whole_batches(reader), reader.schema)
    table.validate(full=True)  # a text whose offsets came to harm would be read from anywhere in memory
    return table
