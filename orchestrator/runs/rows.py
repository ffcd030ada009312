"""Arrays with one row per step, from the rows that were recorded."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from hedgerow.topologies import budget
from hedgerow.topologies.graph import Index

Value = TypeVar("Value", bound=np.generic)


def spread(values: NDArray[Any], steps: Index, rows: int, missing: Any) -> NDArray[Any]:
    """Return `rows` rows, one per step, from the rows of some ascending steps."""
    known = int(np.searchsorted(steps, rows))
    if known == rows:
        return frozen(values[:rows])
    # The file gives the steps: one wrong number could request any number of rows.
    budget.require(f"{rows} steps", rows * values[:1].nbytes)
    spread = np.full((rows, *values.shape[1:]), missing, values.dtype)
    spread[steps[:known]] = values[:known]
    return frozen(spread)


def frozen(values: NDArray[Value]) -> NDArray[Value]:
    """Return the same array, read-only."""
    values.flags.writeable = False
    return values
