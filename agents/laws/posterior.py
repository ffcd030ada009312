"""Posterior weights of the candidates under white Gaussian noise, in an order of operations that no layout changes."""

from __future__ import annotations

import numpy as np

from hedgerow.agents.law import Array
from hedgerow.agents.laws.exponential import exp


def weights(J: Array, sigma: float) -> Array:
    """Return exp(-(J_m - min J) / (2 sigma^2)), (M, k), for costs J (M, k): the posterior up to its sum.

    The largest weight is 1. Infinite costs, of padding, have weight 0.
    """
    return exp((J.min(axis=0) - J) / (2.0 * sigma * sigma))


def total(rows: Array) -> Array:
    """Return the sum over the rows, (k,), added from the first to the last row.

    `rows.sum(axis=0)` adds in an order that depends on the number of columns, and so on the layout over processes.
    """
    found: Array = np.array(rows[0])
    for row in rows[1:]:
        found += row
    return found


def checked(sigma: float) -> float:
    """Return a standard deviation; ValueError if it is not above 0."""
    if not sigma > 0:
        raise ValueError(f"sigma {sigma} is not above 0")
    return sigma
