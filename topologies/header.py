"""The first row of a CSV file of samples: node ids, or the samples of step 0.

A row of whole numbers can be both. The file decides if only one reading is possible. Otherwise it is refused, and
`header: ids` or `header: none` in the topology gives the reading.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Literal

from hedgerow.topologies.errors import Code, FileRefusedError

NodeId = int | str
Header = Literal["ids", "none"]
Row = tuple[int, list[str]]
"""a line number, from 1, and the cells of that row"""

_WHOLE = re.compile(r"[-+]?[0-9]+")
_SEPARATORS = {";": "semicolons", "\t": "tabs", "|": "bars", " ": "spaces"}
_COUNTS = frozenset(
    ("", "#", "t", "k", "n", "i", "id", "idx", "index", "time", "step", "steps", "row", "date", "datetime", "timestamp")
)
"""names, in lower case, of columns that count rows"""
_ORDER = "write `header: ids` if that row names the nodes, or `header: none` if it holds samples of the nodes in order"


def split(file: str, rows: Sequence[Row], ids: Sequence[NodeId], asked: Header | None) -> tuple[Sequence[NodeId], int]:
    """Return the node of each column, and the number of rows in the header (0 or 1).

    rows: at least one; asked: the reading in the topology, None to decide by the content. Raise FileRefusedError for a
    row that fits no reading (FILE_FORMAT), and for one that fits two (FILE_AMBIGUOUS).
    """
    line, first = rows[0][0], [cell.strip() for cell in rows[0][1]]
    by_name = {str(node): node for node in ids}
    _check_cells(file, rows, first)
    fits = len(set(first)) == len(first) and all(cell in by_name for cell in first)
    if asked == "none":
        if len(first) != len(ids):
            raise _miscounted(file, rows, first, by_name)
        return ids, 0
    if fits and (asked == "ids" or not _all_ids(rows, by_name)):
        return [by_name[cell] for cell in first], 1
    if asked == "ids" or not all(map(_is_number, first)):
        raise _misnamed(file, line, first, by_name)
    if fits or _may_be_ids(first, by_name):
        raise FileRefusedError(
            f"{file}:{line}: the row {_shown(first)} can be a header of node ids or the samples of step 0",
            f"{_ORDER}; the nodes are {_shown([*by_name])}",
            Code.FILE_AMBIGUOUS,
        )
    if len(first) != len(ids):
        raise _miscounted(file, rows, first, by_name)
    if _counts(rows):
        raise FileRefusedError(
            f"{file}:{line}: the first column ({_column(rows)}) can be an index or time column, or samples of "
            f"node {ids[0]}",
            "remove it if it counts rows, or write `header: none` if it holds samples",
            Code.FILE_AMBIGUOUS,
        )
    return ids, 0


def _check_cells(file: str, rows: Sequence[Row], first: list[str]) -> None:
    """Raise FileRefusedError if the cells of a file are not separated by single commas."""
    line = rows[0][0]
    for sign, name in _SEPARATORS.items():
        # Several cells are separated by commas already, and a name may have a space in it.
        if any(sign in cell for cell in first) and (len(first) == 1 or sign != " "):
            if first[0].startswith("#"):
                break
            raise FileRefusedError(
                f"{file}:{line}: the cells are separated by {name}, not by commas",
                "write commas between cells, and a point in numbers",
            )
    if first[0].startswith("#"):
        raise FileRefusedError(f"{file}:{line}: starts with the comment sign #", "remove the sign, or the whole line")
    if len(first) > 1 and all(not row or not row[-1].strip() for _, row in rows):
        raise FileRefusedError(f"{file}:{line}: every row ends with a comma", "remove the comma at the end of each row")


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _all_ids(rows: Sequence[Row], by_name: Mapping[str, NodeId]) -> bool:
    """Return True if all rows are possible headers, so the first one is not special."""
    whole = len(rows) > 1 and len(rows[0][1]) == len(by_name)
    return whole and all(_is_number(cell) and cell.strip() in by_name for _, row in rows for cell in row)


def _may_be_ids(first: Sequence[str], by_name: Mapping[str, NodeId]) -> bool:
    """Return True if a row of numbers looks like ids of a network that has numbers as ids."""
    numbered = any(_WHOLE.fullmatch(name) for name in by_name)
    if numbered and all(_WHOLE.fullmatch(cell) for cell in first):
        return len(set(first)) > 1 or len(first) == 1 or first[0] in by_name
    # A header that a program wrote as numbers: 1.0,2.0,3.0 for the nodes 1, 2, 3.
    whole = [f"{float(cell):.0f}" for cell in first if math.isfinite(float(cell)) and float(cell).is_integer()]
    return len(set(whole)) == len(first) > 1 and set(whole) == set(by_name)


def _misnamed(file: str, line: int, first: list[str], by_name: Mapping[str, NodeId]) -> FileRefusedError:
    """Return the problem of a header: the columns that name no node, or the same node twice."""
    strange = [cell for cell in first if cell not in by_name]
    if not strange:
        twice = next(cell for cell in first if first.count(cell) > 1)
        return FileRefusedError(f"{file}:{line}: the header names node {twice} twice", "keep one column per node")
    counting = [cell for cell in strange if cell.lower() in _COUNTS]
    if counting and len(strange) == 1 and len(first) > 1:
        name = f"The column `{counting[0]}`" if counting[0] else f"Column {first.index('') + 1}, without a name,"
        return FileRefusedError(
            f"{file}:{line}: {name[0].lower()}{name[1:]} is an index or time column, and names no node",
            "remove it (in pandas: to_csv(..., index=False))",
        )
    return FileRefusedError(
        f"{file}:{line}: the header names no node with {_shown(strange)}", f"the nodes are {_shown([*by_name])}"
    )


def _miscounted(file: str, rows: Sequence[Row], first: list[str], by_name: Mapping[str, NodeId]) -> FileRefusedError:
    line, n = rows[0][0], len(by_name)
    what = f"{file}:{line}: {len(first)} columns for {n} nodes, and no header of node ids"
    if len(first) == n + 1 and _counts(rows):
        return FileRefusedError(f"{what}; the first column ({_column(rows)}) is an index or time column", "remove it")
    return FileRefusedError(what, "write one column per node, or name the columns by node ids in the first row")


def _column(rows: Sequence[Row]) -> str:
    return ", ".join(row[0].strip()[:20] for _, row in rows[:3]) + ", …"


def _counts(rows: Sequence[Row]) -> bool:
    """Return True if the first column counts rows, 0, dt, 2 dt, … or 1, 2, 3, …, and the second one does not."""
    if len(rows) < 3 or len(rows[0][1]) < 2:
        return False
    pace = _pace(rows, 0)
    return pace is not None and (float(rows[0][1][0]), pace) in ((0.0, pace), (1.0, 1.0)) and _pace(rows, 1) != pace


def _pace(rows: Sequence[Row], column: int) -> float | None:
    """Return the step from each value of a column to the next if it is constant and above 0, otherwise None."""
    pace = before = None
    for _, row in rows:
        if len(row) <= column or not _is_number(row[column]):
            return None
        value = float(row[column])
        if before is not None:
            step = value - before
            if not step > 0 or (pace is not None and abs(step - pace) > 1e-6 * pace):
                return None
            pace = step if pace is None else pace
        before = value
    return pace


def _shown(cells: Sequence[str]) -> str:
    """Return up to eight cells for a message."""
    listed = ",".join(cell[:40] for cell in cells[:8])
    return f"`{listed}{',…' if len(cells) > 8 else ''}`"
