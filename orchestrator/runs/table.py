"""A table of a run, complete or growing: of steps and nodes, of steps and edges, or of steps."""

from __future__ import annotations

import contextlib
import importlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from hedgerow.orchestrator.ground.spelling import spelled
from hedgerow.orchestrator.runs import arrow_stream
from hedgerow.orchestrator.runs.files import check_file, reading
from hedgerow.topologies import budget
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.graph import Index

FRAMES = ("arrow", "pandas", "polars")


def there_is(folder: Path, name: str) -> bool:
    """Return True if a run has a table, complete or growing."""
    return any((folder / f"{name}.{form}").exists() for form in ("parquet", "arrows"))


class Table:
    """One table of a run: its Parquet file or, before that exists, the complete batches of its Arrow stream."""

    def __init__(self, folder: Path, name: str) -> None:
        self.parquet, stream = folder / f"{name}.parquet", folder / f"{name}.arrows"
        self._stream: Any = None
        self._taken: set[str] = set()
        """columns that were read completely"""
        self._longest: dict[str, int] = {}
        """the length of the longest text in a column [bytes]"""
        with contextlib.suppress(FileNotFoundError), reading(stream):  # it has just become the Parquet file
            if not self.parquet.exists() and stream.exists():
                self._stream = _so_far(stream)
        self.path = self.parquet if self._stream is None else stream
        try:
            if self._stream is None:
                check_file(self.parquet)
            with reading(self.parquet):
                self._file = pq.ParquetFile(spelled(self.parquet)) if self._stream is None else None
        except FileNotFoundError:
            raise UserError(
                f"{folder}: no step of the run is recorded yet: there is no {name}.parquet", code=Code.RUN_MISSING
            ) from None

    @property
    def over(self) -> bool:
        """Return True if the Parquet file exists."""
        return self._file is not None

    @property
    def schema(self) -> Any:
        return self._stream.schema if self._file is None else self._file.schema_arrow

    def _require(self, *names: str) -> None:
        """Raise UserError if these columns, with those read before, take more memory than allowed."""
        self._taken.update(names)
        with reading(self.path):
            row = self._row(self._taken)
        rows = self._stream.num_rows if self._file is None else self._file.metadata.num_rows
        # Do not use the size on disk: repeated values take no room there.
        budget.require(self.path, rows * row)

    def _row(self, names: Iterable[str]) -> int:
        """Return an upper bound of the memory of a row of these columns [bytes]."""
        return sum(self._width(name) for name in names)

    def _width(self, name: str) -> int:
        """Return an upper bound of the size of a value of a column [bytes], at least 8: numbers become float64 in
        between.
        """
        kind = self.schema.field(name).type
        if pa.types.is_primitive(kind):
            return max(8, int(kind.bit_width) // 8)
        if not (pa.types.is_string(kind) or pa.types.is_large_string(kind)):
            raise UserError(
                f"{self.path}: column {name[:80]} is of type {str(kind)[:80]}, not of numbers or text. "
                "Put back the file that the run wrote.",
                code=Code.FILE_FORMAT,
            )
        if name not in self._longest:
            # In a stream, each row has its own copy of a text.
            self._longest[name] = 8 + (0 if self._file is None else _longest(self.parquet, self._file.metadata, name))
        return self._longest[name]

    def whole(self) -> Any:
        """Return a pyarrow.Table."""
        self._require(*self.schema.names)
        with reading(self.path):
            return self._stream if self._file is None else self._file.read()

    def batches(self) -> Iterator[Any]:
        """Yield the table in parts that fit into memory."""
        if self._file is None:
            yield from self._stream.to_batches()
            return
        with reading(self.path):
            row = max(1, self._row(self.schema.names))
            rows = max(1, min(_MOST_ROWS, _PART_BYTES // row))
            budget.require(self.path, rows * row)
            yield from self._file.iter_batches(batch_size=rows)

    def column(self, name: str, width: int) -> NDArray[Any]:
        """Return one column, one row per recorded step, (K, width); NaN for null."""
        if name not in self.schema.names:
            raise UserError(
                f"{self.path}: has no column {name}: another version of hedgerow wrote it", code=Code.FILE_FORMAT
            )
        self._require(name)
        with reading(self.path):
            table = self._stream if self._file is None else self._file.read(columns=[name])
            values: NDArray[Any] = table[name].to_numpy()
            if values.dtype.kind not in "fiub":
                raise ValueError(f"column {name} is of type {table[name].type}, or has gaps")
            return values.reshape(-1, width)

    def steps(self, width: int) -> Index:
        """Return the step of each row of `column`, (K,)."""
        rows = self._stream.num_rows if self._file is None else self._file.metadata.num_rows
        if rows % width:
            raise UserError(
                f"{self.path}: {rows} rows are no whole steps of {width}; topology.yaml belongs to another run",
                code=Code.FILE_FORMAT,
            )
        budget.require(self.path, 8 * (rows // width))
        if rows and rows == (self._last_step() + 1) * width:
            return np.arange(rows // width)
        steps: Index = self.column("step", width)[:, 0].astype(np.int64)
        if len(steps) and (steps[0] < 0 or (np.diff(steps) <= 0).any()):
            raise UserError(f"{self.path}: its steps do not ascend; it is damaged", code=Code.FILE_FORMAT)
        return steps

    def _last_step(self) -> int:
        """Return the last step of a table with rows."""
        if "step" not in self.schema.names:
            return -1
        with reading(self.path):
            table = self._stream
            if self._file is not None:
                table = self._file.read_row_group(self._file.num_row_groups - 1, columns=["step"])
            last = table["step"][-1].as_py()
        return last if isinstance(last, int) else -1

    def frame(self, kind: str) -> Any:
        """Return the whole table: a pyarrow.Table, or a frame of "pandas" or "polars"."""
        if kind not in FRAMES:
            raise UserError(f"{kind!r} is no kind of table; there are {', '.join(FRAMES)}", code=Code.OPTION)
        if kind == "arrow":
            return self.whole()
        try:
            library = importlib.import_module(kind)
        except ModuleNotFoundError as error:
            if error.name != kind:
                raise
            raise UserError(
                f"{kind} is not installed; install it with: pip install {kind}", code=Code.DEPENDENCY
            ) from None
        if kind == "polars":
            return library.from_arrow(self.whole())
        # With nulls, a column of whole numbers would become floats.
        return self.whole().to_pandas(types_mapper={pa.int32(): library.Int32Dtype()}.get)


_MOST_ROWS, _PART_BYTES = 65_536, 64 * 2**20
"""the limits of one part of a table"""


def _longest(file: Path, metadata: Any, name: str) -> int:
    """Return the length of the longest text in a column of a Parquet file [bytes].

    The file has a repeated text only once, so a text of 100 MB can be in each of 10^6 rows. A dictionary column keeps
    each text once in memory.
    """
    column = metadata.schema.to_arrow_schema().names.index(name)
    groups = [metadata.row_group(k) for k in range(metadata.num_row_groups)]
    sizes = [group.column(column).total_uncompressed_size + 4 * group.num_rows for group in groups]
    budget.require(file, max(sizes, default=0))
    found = 0
    with pq.ParquetFile(spelled(file), read_dictionary=[name]) as opened:
        for k in range(len(groups)):
            for chunk in opened.read_row_group(k, columns=[name])[name].chunks:
                longest = pc.max(pc.binary_length(chunk.dictionary)).as_py()
                found = max(found, longest or 0)
    return found


_SMALL_BYTES, _JOINED = 2**16, 256
"""The size of a small batch [bytes], and the number that become one: a batch costs some kB beside its rows."""


def _joined(batches: list[Any], schema: Any) -> list[Any]:
    """Return batches as one batch, in memory. Raises ArrowInvalid for a damaged one, which a copy would follow."""
    for batch in batches:
        batch.validate(full=True)
    joined: list[Any] = pa.Table.from_batches(batches, schema).combine_chunks().to_batches()
    return joined


def _so_far(stream: Path) -> Any:
    """Return an Arrow stream as a table that stays in the file, up to its last complete batch."""
    size = check_file(stream)
    try:
        schema, batches = arrow_stream.batches(stream)
    except (pa.ArrowInvalid, EOFError):  # even the schema is missing
        raise UserError(f"{stream.parent}: no step of the run is recorded yet", code=Code.RUN_MISSING) from None
    taken, copied = 0, 0
    found: list[Any] = []
    small: list[Any] = []
    for batch in batches:
        taken += batch.nbytes
        # Batches stay in the file, except compressed ones, which no run writes, and copies of small ones.
        budget.require(stream, max(0, taken - size) + copied)
        if batch.nbytes < _SMALL_BYTES:
            small.append(batch)
        if small and (batch.nbytes >= _SMALL_BYTES or len(small) == _JOINED):
            copied += sum(one.nbytes for one in small)
            found += _joined(small, schema)
            small = []
        if batch.nbytes >= _SMALL_BYTES:
            found.append(batch)
    found += _joined(small, schema)
    table = pa.Table.from_batches(found, schema)
    table.validate(full=True)  # a text with damaged offsets would be read from anywhere in memory
    return table
