"""Disturbance samples from a CSV file: one column a node."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path

from hedgerow.topologies.errors import FileRefusedError
from hedgerow.topologies.graph import LARGEST
from hedgerow.topologies.header import Header, split

MAX_BYTES = 512 * 2**20


def beside(folder: Path, file: str) -> Path:
    """A file in `folder` or below it; ValueError, in words for the user, for one that lies elsewhere."""
    path = folder / file
    if not path.resolve().is_relative_to(folder.resolve()):
        raise ValueError(f"{file} lies outside the topology's own folder")
    if not path.is_file():
        raise ValueError(f"{file}: no such file in {folder}, where the topology file is")
    return path


def columns(
    file: str, folder: Path, ids: Sequence[int | str], header: Header | None = None
) -> dict[int | str, list[float]]:
    """Return the columns of `file` by node id; a header names them, without one they are in the order of `ids`.

    header: `ids` if the first row names the nodes, `none` if it holds samples, None if the file has to decide. Raises
    ValueError for a file that lies outside `folder` or is no such table, FileRefusedError if it has two readings.
    """
    try:
        path = beside(folder, file)
        if path.stat().st_size > MAX_BYTES:
            raise ValueError(f"{file}: larger than {MAX_BYTES // 2**20} MB")
        with path.open(newline="", encoding="utf-8-sig") as lines:
            reader = csv.reader(lines)
            rows = [(reader.line_num, row) for row in reader if row]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"{file}: cannot be read: {error}") from None
    if not rows:
        raise ValueError(f"{file}: is empty")
    named, above = split(file, rows, ids, header)
    table: dict[int | str, list[float]] = {node: [] for node in named}
    for line, row in rows[above:]:
        if len(row) != len(named):
            raise FileRefusedError(
                f"{file}:{line}: has {len(row)} cells, not {len(named)}", "write one cell per column"
            )
        for column, (node, cell) in enumerate(zip(named, row, strict=True), 1):
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
