"""Disturbance samples from a CSV file: one column a node."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path

from hedgerow.topologies.graph import LARGEST

MAX_BYTES = 512 * 2**20


def beside(folder: Path, file: str) -> Path:
    """A file in `folder` or below it; ValueError, in words for the user, for one that lies elsewhere."""
    path = folder / file
    if not path.resolve().is_relative_to(folder.resolve()):
        raise ValueError(f"{file} lies outside the topology's own folder")
    if not path.is_file():
        raise ValueError(f"{file}: no such file in {folder}, where the topology file is")
    return path


def columns(file: str, folder: Path, ids: Sequence[int | str]) -> dict[int | str, list[float]]:
    """The columns of `file` by node id; a header names them, without one they are in the order of `ids`.

    Raises ValueError, in words for the user, for a file that lies outside `folder` or is no such table.
    """
    try:
        path = beside(folder, file)
        if path.stat().st_size > MAX_BYTES:
            raise ValueError(f"{file}: larger than {MAX_BYTES // 2**20} MB")
        with path.open(newline="", encoding="utf-8-sig") as lines:
            rows = [row for row in csv.reader(lines) if row]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"{file}: cannot be read: {error}") from None
    if not rows:
        raise ValueError(f"{file}: is empty")
    by_name = {str(node): node for node in ids}
    header: Sequence[int | str] = ids
    first = [cell.strip() for cell in rows[0]]
    # A header of whole-number ids looks like data too; samples in that guise would have to equal the ids.
    if all(cell in by_name for cell in first) and len(set(first)) == len(first):
        header, rows = [by_name[cell] for cell in first], rows[1:]
    elif len(first) != len(ids):
        raise ValueError(f"{file}: {len(first)} columns for {len(ids)} nodes, and no header of node ids")
    table: dict[int | str, list[float]] = {node: [] for node in header}
    for number, row in enumerate(rows, 1):
        if len(row) != len(header):
            raise ValueError(f"{file}: row {number} has {len(row)} cells, not {len(header)}")
        for node, cell in zip(header, row, strict=True):
            try:
                value = float(cell)
            except ValueError:
                value = math.nan
            if not abs(value) <= LARGEST:
                what = f"beyond {LARGEST:g}" if math.isfinite(value) else "not a finite number"
                raise ValueError(f"{file}: row {number}, node {node}: {cell[:40]!r} is {what}")
            table[node].append(value)
    return table
