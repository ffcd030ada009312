"""Files of matrices: Matrix Market, and MATLAB or SciPy files with one square matrix."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

from hedgerow.topologies.importing.found import Found, refuse
from hedgerow.topologies.importing.options import Options
from hedgerow.topologies.importing.tables import of_matrix
from hedgerow.topologies.regular_file import read_regular

GROWTH = 20
"""bytes of memory for a byte of a file"""


def read_market(path: Path, options: Options) -> Found:
    """Return the graph of an adjacency matrix in a Matrix Market file; nodes are numbered from 1, as the file does."""
    from scipy.io import mmread  # noqa: PLC0415 (half a second to load)

    data = read_regular(path, growth=GROWTH)
    try:
        matrix: Any = mmread(io.BytesIO(data))
    except (ValueError, OverflowError, TypeError, OSError) as error:
        raise refuse(path, f"is no Matrix Market file: {str(error)[:200]}", "Check its format") from None
    if getattr(matrix, "dtype", None) is not None and matrix.dtype.kind == "c":
        raise refuse(path, "holds complex numbers", "Write a matrix of weights")
    return of_matrix(matrix, options, str(path), first=1)


def read_sparse(path: Path, options: Options) -> Found:
    """Return the graph of an adjacency matrix that `scipy.sparse.save_npz` wrote; nodes are numbered from 0."""
    from scipy.sparse import load_npz  # noqa: PLC0415

    data = read_regular(path, growth=GROWTH)
    try:
        matrix = load_npz(io.BytesIO(data))
    except Exception as error:  # a damaged archive raises what zipfile, zlib and numpy raise
        raise refuse(
            path, f"is no sparse matrix of SciPy: {str(error)[:200]}", "Write it with scipy.sparse.save_npz"
        ) from None
    return of_matrix(matrix, options, str(path))


def of_mat(content: dict[str, Any], path: Path, options: Options) -> Found:
    """Return the graph of the one square matrix among the variables of a MATLAB file; nodes are numbered from 1."""
    square = {
        name: value
        for name, value in content.items()
        if not name.startswith("__") and getattr(value, "ndim", 0) == 2 and value.shape[0] == value.shape[1] > 1
    }
    if len(square) != 1:
        known = ", ".join(square) or "none"
        raise refuse(path, f"has no struct `mpc`, and its square matrices are: {known}", "Save one adjacency matrix")
    return of_matrix(next(iter(square.values())), options, str(path), first=1)
