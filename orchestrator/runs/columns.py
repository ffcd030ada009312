"""Arrow columns over the memory of numpy arrays.

pyarrow's own conversions load pandas if it is installed, which takes half a second of CPU in the first steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from hedgerow.topologies.graph import Mask

_TYPES = {np.dtype(name): getattr(pa, name)() for name in ("int32", "int64", "float64")} | {np.dtype(bool): pa.bool_()}


def column(values: NDArray[Any], missing: Mask | None = None) -> pa.Array:
    """Return the numbers or booleans of an array, row by row; null where they are missing (None: nowhere)."""
    values = np.ascontiguousarray(values).ravel()
    data = _bits(values) if values.dtype == bool else pa.py_buffer(values)
    known = None if missing is None or not missing.any() else _bits(~missing.ravel())
    return pa.Array.from_buffers(_TYPES[values.dtype], len(values), [known, data])


def names(texts: Sequence[str]) -> pa.Array:
    """Return a column of texts."""
    encoded = [text.encode() for text in texts]
    offsets = np.cumsum([0, *map(len, encoded)], dtype=np.int32)
    return pa.Array.from_buffers(
        pa.string(), len(texts), [None, pa.py_buffer(offsets), pa.py_buffer(b"".join(encoded))]
    )


def _bits(values: Mask) -> pa.Buffer:
    return pa.py_buffer(np.packbits(values, bitorder="little"))
