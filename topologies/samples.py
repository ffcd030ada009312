"""Disturbance samples from a CSV or Parquet file: one column per node."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Collection, Sequence
from pathlib import Path

from hedgerow.topologies import budget, frames
from hedgerow.topologies.cures import cure_of_number
from hedgerow.topologies.errors import Code, FileRefusedError, UserError
from hedgerow.topologies.escape import shorten
from hedgerow.topologies.foreign import csv_problem, foreign_kind, not_text
from hedgerow.topologies.graph import LARGEST
from hedgerow.topologies.header import Header, Row, split
from hedgerow.topologies.paths import real_path
from hedgerow.topologies.reading import Times
from hedgerow.topologies.regular_file import check_regular, open_regular
from hedgerow.topologies.source import FLOAT

MAX_BYTES = 512 * 2**20


def beside(folder: Path, file: str) -> Path:
    """Return the path of a file in `folder` or below it; raise ValueError, with a text for the user, for a file
    elsewhere.
    """
    path = folder / file
    try:
        inside = real_path(path).is_relative_to(real_path(folder))
    except UserError as error:
        raise FileRefusedError(str(error), code=error.code) from None
    if not inside:
        raise FileRefusedError(f"{file} lies outside the topology's own folder", "copy it into that folder")
    if not path.exists():
        raise FileRefusedError(
            f"{file}: no such file in {folder}, where the topology file is", "correct the name, or copy it there"
        )
    try:
        check_regular(path)
    except (OSError, UserError) as error:
        why = str(error.strerror) if isinstance(error, OSError) else str(error)
        raise FileRefusedError(
            why if why.startswith(str(path)) else f"{file}: {why}", code=Code.FILE_NOT_REGULAR
        ) from None
    return path


BYTES_PER_CELL, BYTES_PER_LINE = 130, 200
"""the memory per cell and per line [bytes]; each cell is a text first and then a number"""


def _memory(path: Path) -> int:
    """Return the memory for the samples of a file [bytes], by its commas and lines."""
    cells = lines = 0
    with open_regular(path) as file:
        while part := file.read(2**20):
            cells += part.count(b",")
            lines += max(part.count(b"\n"), part.count(b"\r"))
    return path.stat().st_size + (cells + lines) * BYTES_PER_CELL + lines * BYTES_PER_LINE


def columns(
    file: str,
    folder: Path,
    ids: Sequence[int | str],
    header: Header | None = None,
    times: Times | None = None,
    named: Collection[str] = (),
) -> dict[int | str, list[float]]:
    """Return the columns of `file` by node id.

    A header names the columns; without a header they are in the order of `ids`.

    header: `ids` if the first row names the nodes, `none` if it holds samples, None to decide by the content. times:
    the column of times, None if a row is a step. named: paths that may be outside `folder`. Raise ValueError for a file
    outside `folder` or another kind of file, FileRefusedError if it has two readings.
    """
    try:
        path = Path(file) if file in named else beside(folder, file)
        if path.stat().st_size > MAX_BYTES:
            raise FileRefusedError(f"{file}: larger than {MAX_BYTES // 2**20} MB", code=Code.FILE_TOO_LARGE)
        if path.suffix.lower() == ".parquet":
            return frames.by_steps(file, frames.parquet(path), ids, times)
        if why := budget.excess(_memory(path)):
            raise FileRefusedError(f"{file}: {why}", code=Code.FILE_TOO_LARGE)
        with io.TextIOWrapper(open_regular(path), "utf-8-sig", newline="") as lines:
            reader = csv.reader(lines)
            rows = [(reader.line_num, row) for row in reader if row]
    except UserError as error:
        raise FileRefusedError(str(error), code=error.code) from None
    except UnicodeDecodeError as error:
        raise _no_text(file, path, error) from None
    except OSError as error:
        raise FileRefusedError(f"{file}: cannot be read: {error.strerror}", "check its permissions") from None
    except csv.Error as error:
        raise FileRefusedError(f"{file}:{reader.line_num + 1}: {csv_problem(error)}", _CLOSE_QUOTES) from None
    if not rows:
        raise FileRefusedError(f"{file}: is empty", "write a row of samples per step")
    if foreign_kind(rows[0][1][0].encode(errors="replace")):
        raise _no_text(file, path, None)
    if times is None:
        return _table(file, rows, ids, header)
    rows, stamps = _without_times(file, rows, times.column)
    return frames.by_steps(file, {times.column: stamps, **_table(file, rows, ids, "ids")}, ids, times)


_CLOSE_QUOTES = "close every quote, and write one row per line"


def _no_text(file: str, path: Path, error: UnicodeDecodeError | None) -> FileRefusedError:
    with open_regular(path) as opened:
        what = not_text(opened.read(64), error)
    return FileRefusedError(f"{file}: {what}", "save the file as CSV in UTF-8")


def _without_times(file: str, rows: list[Row], time: str) -> tuple[list[Row], list[str]]:
    """Return the rows without the column of times, and that column without its name."""
    line, first = rows[0]
    cells = [cell.strip() for cell in first]
    if cells.count(time) != 1:
        listed = ",".join(cells[:8])[:80]
        raise FileRefusedError(f"{file}:{line}: no column, or several, are named {time!r}", f"the header is `{listed}`")
    at = cells.index(time)
    for number, row in rows:
        if len(row) != len(first):
            raise FileRefusedError(
                f"{file}:{number}: has {len(row)} cells, not {len(first)}", "write one cell per column"
            )
    return [(number, row[:at] + row[at + 1 :]) for number, row in rows], [row[at].strip() for _, row in rows[1:]]


def number(cell: str) -> float:
    """Return the number in a cell; NaN for a text that is none.

    Python would read 1_0 as 10 and accept the digits of other scripts, which other readers of the same file refuse.
    """
    spelled = cell.strip()
    return float(spelled) if FLOAT.match(spelled) else math.nan


def _table(file: str, rows: list[Row], ids: Sequence[int | str], header: Header | None) -> dict[int | str, list[float]]:
    order, above = split(file, rows, ids, header)
    table: dict[int | str, list[float]] = {node: [] for node in order}
    for line, row in rows[above:]:
        if len(row) != len(order):
            raise FileRefusedError(
                f"{file}:{line}: has {len(row)} cells, not {len(order)}", "write one cell per column"
            )
        for column, (node, cell) in enumerate(zip(order, row, strict=True), 1):
            value = number(cell)
            if not abs(value) <= LARGEST:
                what, cure = "not a finite number", cure_of_number(cell.strip())
                if not math.isnan(value):
                    what, cure = f"beyond {LARGEST:g}", "choose a smaller one"
                raise FileRefusedError(
                    f"{file}:{line}: column {column}, node {node}: {shorten(repr(cell[:400]), 44)} is {what}", cure
                )
            table[node].append(value)
    return table
