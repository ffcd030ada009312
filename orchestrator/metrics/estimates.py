"""The quality of estimates: their error, if the nearest candidate is the truth, and how often they change."""

from __future__ import annotations

import numpy as np

from hedgerow.topologies.graph import Array


def judged(ahat: Array, a: Array, candidates: Array) -> dict[str, float | None]:
    """Return the quality of the estimates, (n,) each; `candidates` (M, n).

    An estimate is right if the candidate nearest it is the truth. For an estimate from the list this is equality. For a
    real number it is the candidate that the number supports. A node without an estimate is not right, and has no error.
    """
    there = np.isfinite(ahat)
    apart = np.where(np.isnan(candidates), np.inf, np.abs(candidates - np.where(there, ahat, 0.0)))
    nearest = candidates[apart.argmin(axis=0), np.arange(len(a))]
    error = np.abs(ahat - a)[there]
    return {
        "share_right": float(((nearest == a) & there).mean()),
        "error": float(error.mean()) if len(error) else None,
    }


def switches(before: Array, after: Array) -> Array:
    """Return how many estimates change, summed over the last axis; a missing estimate changes nothing."""
    return np.asarray(((before != after) & np.isfinite(before) & np.isfinite(after)).sum(axis=-1), dtype=float)
