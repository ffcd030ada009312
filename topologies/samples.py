"""Disturbance samples from a CSV or Parquet file: one column per node."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Collection, Sequence
from pathlib import Path

from hedgerow.topologies import budget, frames
from hedgerow.topologies.errors import Code, FileRefusedError, UserError
from hedgerow.topologies.graph import LARGEST
from hedgerow.topologies.header import Header, Row, split
from hedgerow.topologies.reading import Times
from hedgerow.topologies.regular_file import open_regular

MAX_BYTES = 512 * 2**20


def beside(folder: Path, file: str) -> Path:
    """Return the path of a file in `folder` or below it; raise ValueError, with a text for the user, for a file
    elsewhere.
    """
    path = folder / file
    if not path.resolve().is_relative_to(folder.resolve()):
        raise ValueError(f"{file} lies outside the topology's own folder")
    if not path.is_file():
        raise ValueError(f"{file}: no such file in {folder}, where the topology file is")
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
        what = f"{file}: byte {error.start} is not UTF-8 text"
        raise FileRefusedError(what, "save the file as CSV in UTF-8") from None
    except (OSError, csv.Error) as error:
        raise ValueError(f"{file}: cannot be read: {error}") from None
    if not rows:
        raise ValueError(f"{file}: is empty")
    if times is None:
        return _table(file, rows, ids, header)
    rows, stamps = _without_times(file, rows, times.column)
    return frames.by_steps(file, {times.column: stamps, **_table(file, rows, ids, "ids")}, ids, times)


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


def _table(file: str, rows: list[Row], ids: Sequence[int | str], header: Header | None) -> dict[int | str, list[float]]:
    order, above = split(file, rows, ids, header)
    table: dict[int | str, list[float]] = {node: [] for node in order}
    for line, row in rows[above:]:
        if len(row) != len(order):
            raise FileRefusedError(
                f"{file}:{line}: has {len(row)} cells, not {len(order)}", "write one cell per column"
            )
        for column, (node, cell) in enumerate(zip(order, row, strict=True), 1):
            try:
                value = float(cell)
            except ValueError:
                value = math.nan
            if not abs(value) <= LARGEST:
                what = f"beyond {LARGEST:g}" if math.isfinite(value) else "not a finite number"
                cure = "write a point, not a comma, in it" if "," in cell else "write a number such as 0.5"
                raise FileRefusedError(f"{file}:{line}: column {column}, node {node}: {cell[:40]!r} is {what}", cure)
            table[node].append(value)
    return table
