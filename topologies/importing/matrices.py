"""Files of matrices: Matrix Market, and MATLAB or SciPy files with one square matrix."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np

from hedgerow.topologies.graph import Array
from hedgerow.topologies.importing.found import Found, refuse
from hedgerow.topologies.importing.options import Options
from hedgerow.topologies.importing.tables import of_matrix
from hedgerow.topologies.regular_file import read_regular

GROWTH = 20
"""the memory per byte of a file"""
MOST = 10**7
"""the maximum number of rows of a matrix: a short file can name any number"""


def read_market(path: Path, options: Options) -> Found:
    """Return the graph of an adjacency matrix in a Matrix Market file; nodes are numbered from 1, as the file does."""
    from scipy.io import mminfo  # noqa: PLC0415 (half a second to load)

    data = read_regular(path, growth=GROWTH)
    try:
        rows, columns, entries, form, field, symmetry = mminfo(io.BytesIO(data))
        if field == "complex":
            raise refuse(path, "holds complex numbers", "Save the moduli, or the real parts")
        if max(rows, columns) > MOST or rows != columns:
            raise ValueError(f"it has {rows} rows and {columns} columns")
        # scipy.io.mmread ends the process on some damaged files: numpy reads the numbers, and we check their places.
        lines = [line for line in data.decode().splitlines() if line.strip() and not line.lstrip().startswith("%")]
        numbers = np.loadtxt(lines[1:], ndmin=2) if len(lines) > 1 else np.empty((0, 3))
        matrix = _array(numbers, rows, symmetry) if form == "array" else _coordinates(numbers, rows, entries, field)
    except (ValueError, OverflowError, TypeError, OSError) as error:
        raise refuse(path, f"is no Matrix Market file: {str(error)[:200]}", "Check its format") from None
    return of_matrix(matrix, options, str(path), first=1)


def _coordinates(numbers: Array, n: int, entries: int, field: str) -> Any:
    """Return the matrix of rows (i, j, value), or (i, j) of a pattern; one half of a symmetric matrix suffices."""
    from scipy.sparse import coo_array  # noqa: PLC0415

    width = 2 if field == "pattern" else 3
    if len(numbers) != entries or (entries and numbers.shape[1] != width):
        raise ValueError(f"{len(numbers)} entries in place of {entries} with {width} numbers each")
    places = numbers[:, :2].astype(np.int64)
    if len(places) and (places.min() < 1 or places.max() > n or (places != numbers[:, :2]).any()):
        raise ValueError(f"an entry lies outside of 1 to {n}")
    values = np.ones(len(numbers)) if field == "pattern" else numbers[:, 2]
    return coo_array((values, (places[:, 0] - 1, places[:, 1] - 1)), shape=(n, n))


def _array(numbers: Array, n: int, symmetry: str) -> Array:
    """Return the matrix of a list of numbers, column by column; of a symmetric one, the lower half."""
    values = numbers.ravel()
    if n * n > 2 * len(values) + n:
        raise ValueError(f"{len(values)} numbers for {n} rows")
    matrix = np.zeros((n, n))
    i, j = np.triu_indices(n, 1 if symmetry == "skew-symmetric" else 0)  # transposed, these are the columns in order
    if symmetry == "general":
        i, j = (index.ravel() for index in np.indices((n, n)))
    if len(values) != len(i):
        raise ValueError(f"{len(values)} numbers in place of {len(i)}")
    matrix[j, i] = values
    return matrix


def read_sparse(path: Path, options: Options) -> Found:
    """Return the graph of an adjacency matrix that `scipy.sparse.save_npz` wrote; nodes are numbered from 0."""
    from scipy.sparse import load_npz  # noqa: PLC0415

    data = read_regular(path, growth=GROWTH)
    try:
        matrix = load_npz(io.BytesIO(data))
    except Exception as error:  # a damaged archive causes any error of zipfile, zlib and numpy
        raise refuse(
            path, f"is no sparse matrix of SciPy: {str(error)[:200]}", "Write it with scipy.sparse.save_npz"
        ) from None
    return of_matrix(matrix, options, str(path))


def of_mat(arrays: dict[str, Any], path: Path, options: Options) -> Found:
    """Return the graph of the one square matrix of a MATLAB file; nodes are numbered from 1.

    arrays: by name the rows (i, j, value) of a matrix, and its size as `n NAME`.
    """
    from scipy.sparse import coo_array  # noqa: PLC0415 (half a second to load)

    square = [name for name in arrays if f"n {name}" in arrays]
    if len(square) != 1:
        known = ", ".join(square) or "none"
        raise refuse(path, f"has no struct `mpc`, and its square matrices are: {known}", "Save one adjacency matrix")
    rows, n = arrays[square[0]], int(arrays[f"n {square[0]}"])
    i, j = rows[:, :2].astype(np.int64).T
    return of_matrix(coo_array((rows[:, 2], (i, j)), shape=(n, n)), options, str(path), first=1)
