"""Edges and matrices as text: edge lists, CSV files with or without a header, adjacency matrices, data frames."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Hashable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hedgerow.topologies.base import node_id
from hedgerow.topologies.foreign import csv_problem, not_text
from hedgerow.topologies.graph import Array, Index
from hedgerow.topologies.importing.found import Found, as_number, refuse, weights_of
from hedgerow.topologies.importing.options import Options
from hedgerow.topologies.regular_file import read_regular

GROWTH = 25
"""the memory per byte of a file: every cell is a text first"""
MOST_COLUMNS = 4
"""the most columns of a square without row names that is a matrix only if it is symmetric"""
COMMENTS = ("#", "%", "//")
FROM = ("source", "from", "src", "node1", "start", "from_node", "node_from", "tail")
TO = ("target", "to", "dst", "node2", "end", "to_node", "node_to", "head")
_SEPARATORS = ",;\t| "
_DECIMAL = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")


def read(path: Path, options: Options) -> Found:
    """Return the graph in a text of edges, one per row, or of an adjacency matrix.

    A matrix is a square of numbers, with or without a row and a column of names. A row of edges begins with the two
    ends, unless a header names the columns.
    """
    rows = _rows(path)
    if not rows:
        raise refuse(path, "has no rows", "Write an edge per row, such as `1,2`")
    if rows[0][1][-1].endswith("}"):
        from hedgerow.topologies.importing import graphs  # noqa: PLC0415

        return graphs.read(path, options, "edgelist")
    matrix = _matrix(path, rows)
    if matrix is not None:
        names, values = matrix
        return of_matrix(values, options, str(path), names)
    return _edges(path, rows, options)


def _rows(path: Path) -> list[tuple[int, list[str]]]:
    """Return the rows of a file, without comments, and their lines."""
    data = read_regular(path, growth=GROWTH)
    if why := not_text(data[:64]):
        raise refuse(path, why, "Save the file as text in UTF-8")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise refuse(path, not_text(error.object, error), "Save the file as text in UTF-8") from None
    # Other line ends of Unicode may be part of a name.
    lines = list(enumerate(text.replace("\r\n", "\n").replace("\r", "\n").split("\n"), 1))
    lines = [(k, line.rstrip()) for k, line in lines if line.strip() and not line.lstrip().startswith(COMMENTS)]
    separator = _separator([line for _, line in lines[:50]])
    if separator == " " and not any('"' in line for _, line in lines):
        return [(k, line.split()) for k, line in lines]
    if separator == " ":
        lines = [(k, line.strip().replace("\t", " ")) for k, line in lines]
    reader = csv.reader(io.StringIO("\n".join(line for _, line in lines)), delimiter=separator, skipinitialspace=True)
    rows, first = [], 0
    try:
        for row in reader:
            # A quoted cell may span lines: the place of a row is its first line.
            rows.append((lines[first][0], [cell.strip() for cell in row]))
            first = reader.line_num
    except csv.Error as error:
        raise refuse(path, f"is no table: {csv_problem(error)}", "Write an edge per row") from None
    return rows


def _separator(lines: Sequence[str]) -> str:
    """Return the separator of the cells: the first of `,;TAB|` that every line has, otherwise blanks.

    If most lines have one, it is the separator, and the other lines lack an end. Commas that are only in numbers, such
    as in `1;2;0,5`, are decimal commas, and the separator is another one.
    """
    signs = _SEPARATORS[:-1]
    of_all = next((sign for sign in signs if lines and all(sign in line for line in lines)), None)
    of_most = next((sign for sign in signs if 2 * sum(sign in line for line in lines) > len(lines)), " ")
    found = of_all or of_most
    if found == ",":
        return next((sign for sign in _SEPARATORS[1:] if all(_decimal(line, sign) for line in lines)), found)
    return found


def _decimal(line: str, sign: str) -> bool:
    """Return True if a sign separates cells of which some are numbers with a decimal comma, and no other has commas."""
    cells = line.split() if sign == " " else line.split(sign)
    # Blanks often follow a comma that separates: `1, 2`.
    if len(cells) < 2 + (sign == " ") or (sign == " " and "," in cells[0] + cells[1]):
        return False
    return all("," not in cell or _DECIMAL.fullmatch(cell.strip()) for cell in cells)


def _number(cell: str) -> float | None:
    return 0.0 if not cell else as_number(cell)


def _matrix(path: Path, rows: Sequence[tuple[int, list[str]]]) -> tuple[list[Hashable] | None, Array] | None:
    """Return the names and the values of an adjacency matrix, or None if the rows are not a square of numbers."""
    header, n = rows[0][1], len(rows) - 1
    widths = {len(row) for _, row in rows[1:]}
    names: list[str] | None = None
    beside: list[str] | None = None
    cells: Sequence[tuple[int, list[str]]]
    if n < 2 or _ends_named(header):
        return None
    first = [row[0] for _, row in rows[1:]]
    corner = len(header) == n + 1 and as_number(header[0]) is None
    if (
        widths == {n + 1}
        and (len(header) == n or corner)
        and (_named(header[-n:]) or header[-n:] == first or not header[0])
    ):
        # The rows have names too. The corner is empty, holds any text, or is left out.
        names, beside = header[-n:], first
        cells = [(line, row[1:]) for line, row in rows[1:]]
    elif _named(header) and len(header) == n:
        names, cells = header, rows[1:]
    else:
        cells = rows
    n = len(cells)
    # Two edges in two columns look like a matrix of two nodes: treat them as edges, which are far more common.
    if n < 3 or any(len(row) != n for _, row in cells) or (names is not None and len(names) != n):
        return None
    values = np.empty((n, n))
    commas: tuple[int, str] | None = None
    for k, (line, row) in enumerate(cells):
        for column, cell in enumerate(row):
            value = _number(cell)
            if value is None and _DECIMAL.fullmatch(cell):
                commas = commas or (line, cell)
                value = _number(cell.replace(",", "."))
            if value is None:
                return None
            values[k, column] = value
    # Edges with attributes are a square too: an adjacency matrix is symmetric and has no loops.
    if beside is None and n <= MOST_COLUMNS and (not np.array_equal(values, values.T) or values.diagonal().any()):
        return None
    if commas is not None:
        raise refuse(f"{path}:{commas[0]}", f"{commas[1]!r} is not a number", "Write decimals with a point")
    if names is not None and beside is not None and len(set(names)) == n and set(beside) == set(names):
        values = values[[beside.index(name) for name in names]]
    return None if names is None else [node_id(name) for name in names], values


def _ends_named(header: Sequence[str]) -> bool:
    """Return True if a header names the two ends of an edge."""
    lower = {cell.lower() for cell in header}
    return bool(lower & {*FROM}) and bool(lower & {*TO})


def _named(cells: Sequence[str]) -> bool:
    return len(set(cells)) == len(cells) and all(cell and as_number(cell) is None for cell in cells)


def _edges(path: Path, rows: Sequence[tuple[int, list[str]]], options: Options) -> Found:
    header: list[str] | None = None
    first = rows[0][1]
    lower = [cell.lower() for cell in first]
    known = [cell for cell in lower if cell in (*FROM, *TO, "weight")]
    if len(known) >= 2 or (
        len(first) > 2 and all(_number(cell) is None for cell in first) and _numeric_column(rows[1:])
    ):
        header, rows = first, rows[1:]
    if header is not None and not rows:
        raise refuse(path, "has a header and no edges", "Write an edge per row, such as `1,2`")
    if header is not None and len(known) < 2 and _places(lower):
        raise refuse(
            f"{path}:1",
            "the header is that of a table of nodes",
            "Name a table of edges, with columns source and target",
        )
    i, j = _columns(header)
    for line, row in rows:
        if len(row) <= max(i, j) or not row[i] or not row[j]:
            raise refuse(f"{path}:{line}", "has no two ends of an edge", "Write an edge per row, such as `1,2`")
    others = _attributes(header, rows, (i, j))
    named = [f"{path}:{line}" for line, _ in rows]
    return of_pairs([row[i] for _, row in rows], [row[j] for _, row in rows], others, options, str(path), named)


def _places(header: Sequence[str]) -> bool:
    """Return True if a header names the coordinates of nodes."""
    return any({*pair} <= {*header} for pair in (("x", "y"), ("lon", "lat"), ("longitude", "latitude")))


def _numeric_column(rows: Sequence[tuple[int, list[str]]]) -> bool:
    return any(len(row) > 2 and all(_number(cell) is not None for cell in row[2:]) for _, row in rows[:1])


def _columns(header: Sequence[str] | None) -> tuple[int, int]:
    """Return the columns of the two ends."""
    if header is None:
        return 0, 1
    lower = [cell.lower() for cell in header]
    i = next((lower.index(name) for name in FROM if name in lower), 0)
    j = next((lower.index(name) for name in TO if name in lower and lower.index(name) != i), 1 if i == 0 else 0)
    return i, j


def _attributes(
    header: Sequence[str] | None, rows: Sequence[tuple[int, list[str]]], ends: tuple[int, int]
) -> dict[str, list[Any]]:
    """Return the other columns by name; without a header, the third one is `weight` if it holds numbers."""
    width = max((len(row) for _, row in rows), default=0)
    found: dict[str, list[Any]] = {}
    for column in range(width):
        if column in ends:
            continue
        if header is None:
            name = "weight" if column == 2 else f"column{column + 1}"
        else:
            name = header[column] if column < len(header) else f"column{column + 1}"
        cells = [row[column] if column < len(row) and row[column] else None for _, row in rows]
        values = [
            None if cell is None else number if (number := as_number(cell)) is not None else cell for cell in cells
        ]
        found[name] = values
    return found


def of_pairs(
    tails: Iterable[Hashable],
    heads: Iterable[Hashable],
    columns: dict[str, list[Any]],
    options: Options,
    source: str,
    edge_names: Sequence[str] | None = None,
) -> Found:
    """Return the graph of edges that are given by the names of their ends; `columns` are their attributes."""
    place: dict[Hashable, int] = {}

    def position(name: Hashable) -> int:
        return place.setdefault(node_id(name) if isinstance(name, str) else name, len(place))

    tails, heads = list(tails), list(heads)
    if len({len(tails), len(heads), *map(len, columns.values())}) > 1:
        raise refuse(source, "its columns differ in length", "Give every column a value per edge")
    for k, pair in enumerate(zip(tails, heads, strict=True)):
        if any(_missing(end) is None for end in pair):
            name = edge_names[k] if edge_names is not None else f"{source}: row {k + 1}"
            raise refuse(name, "has no two ends of an edge", "Remove the row, or name both ends")
    ends = [(position(i), position(j)) for i, j in zip(tails, heads, strict=True)]
    edges = np.array(ends, dtype=np.int64).reshape(-1, 2)
    names = list(place)
    attributes = (
        [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)] if columns else []
    )

    def named(k: int) -> str:
        return edge_names[k] if edge_names is not None else f"edge {names[edges[k, 0]]} - {names[edges[k, 1]]}"

    weights, fact = weights_of(source, options.weight, attributes or [{}] * len(edges), named)
    if isinstance(options.storage, str) and as_number(options.storage) is None:
        raise refuse(f"--storage {options.storage}", "a list of edges has no attributes of nodes", "Give a number")
    storage = None if options.storage is None else np.full(len(names), float(options.storage))
    return Found(
        source, names, edges, directed=False, weights=weights, storage=storage, edge_names=edge_names, facts=[fact]
    )


def of_matrix(
    matrix: Any, options: Options, source: str, names: Sequence[Hashable] | None = None, first: int = 0
) -> Found:
    """Return the graph of an adjacency matrix, dense or sparse: a nonzero entry is an edge with this weight.

    Nodes are numbered from `first` if they have no names. A symmetric matrix gives every edge twice, and it is taken
    once.
    """
    from scipy.sparse import coo_array, issparse  # noqa: PLC0415 (half a second to load)

    try:
        if not issparse(matrix) and np.asarray(matrix).dtype.kind == "O":
            matrix = np.asarray(matrix).astype(float)
        entries = coo_array(matrix)
    except (TypeError, ValueError) as error:
        raise refuse(source, f"is no matrix of numbers: {str(error)[:60]}", "Give an array (n, n)") from None
    if entries.ndim != 2 or entries.shape[0] != entries.shape[1]:
        raise refuse(source, f"has the shape {entries.shape}, which is no square", "Give an adjacency matrix (n, n)")
    n = entries.shape[0]
    if names is not None and len(names) != n:
        raise refuse(source, f"{len(names)} names for {n} nodes", "Give a name per node")
    if entries.data.dtype.kind not in "biuf":
        raise refuse(source, f"holds {entries.data.dtype}, not numbers", "Give an array of numbers")
    entries.sum_duplicates()
    edges: Index = np.stack(entries.coords, axis=1).astype(np.int64)
    values = entries.data.astype(float)
    nonzero = values != 0
    edges, values = edges[nonzero], values[nonzero]
    if edges.size and (options.weight is not None):
        number = as_number(options.weight)
        if number is None:
            raise refuse(f"--weight {options.weight}", "a matrix has no attributes of edges", "Give a number")
        values = np.full(len(edges), number)
    if edges.size and (edges[:, 0] == edges[:, 1]).all():
        raise refuse(source, "has no edge: all its nonzero entries are on the diagonal", "Give an adjacency matrix")
    ones = bool((values == 1).all())
    storage = None
    if options.storage is not None:
        if (size := as_number(options.storage)) is None:
            raise refuse(f"--storage {options.storage}", "a matrix has no attributes of nodes", "Give a number")
        storage = np.full(n, size)
    return Found(
        source,
        names=list(range(first, first + n)) if names is None else list(names),
        edges=edges,
        directed=True,
        weights=None if ones else values,
        storage=storage,
        sign=lambda weight: "and a pair without an edge has 0" if np.isnan(weight) else "",
        facts=["Every edge has the weight 1" if ones else "The weights are the entries of the matrix"],
    )


def of_frame(frame: Any, options: Options, source: str, tail: str | None, head: str | None) -> Found:
    """Return the graph of a data frame of edges: pandas, polars, pyarrow, or any object that dict() turns into
    columns.
    """
    if hasattr(frame, "to_pydict"):
        columns = frame.to_pydict()
    elif hasattr(frame, "to_dict"):
        if twice := [name for name in frame.columns if list(frame.columns).count(name) > 1]:
            raise refuse(source, f"two columns are named {twice[0]!r}", "Give each column its own name")
        columns = frame.to_dict("list") if hasattr(frame, "iloc") else frame.to_dict(as_series=False)
    else:
        columns = {key: list(values) for key, values in dict(frame).items()}
    columns = {str(key): list(values) for key, values in columns.items()}
    listed = list(columns)
    if len(listed) < 2:
        raise refuse(source, "has fewer than two columns", "Give a column for each end of an edge")
    for given in (tail, head):
        if given is not None and given not in columns:
            raise refuse(source, f"has no column {given!r}", f"Its columns are {', '.join(listed)}")
    # A column that the user names for one end is not the default of the other.
    i, j = _columns([name if name not in (tail, head) else "" for name in listed])
    spare = [listed[k] for k in (i, j, *range(len(listed))) if listed[k] not in (tail, head)]
    ends = [tail or spare.pop(0), head or spare.pop(0)]
    return of_pairs(
        columns[ends[0]],
        columns[ends[1]],
        {key: [_missing(one) for one in values] for key, values in columns.items() if key not in ends},
        options,
        source,
    )


def _missing(value: Any) -> Any:
    """Return None for a missing value of pandas: NaN, NaT, or NA, which has no truth value."""
    if isinstance(value, float) or type(value).__name__ in ("NaTType", "NAType"):
        return value if isinstance(value, float) and value == value else None  # noqa: PLR0124
    return value
