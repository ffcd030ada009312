"""Properties of a run that read one column of its tables, or compute it again from them."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from hedgerow.topologies.graph import Array, Mask


def states(name: str) -> cached_property[Array]:
    """Return a property that reads a column of telemetry, (T + 1, n)."""
    return cached_property(lambda run: run._of_nodes(name, run.T + 1, np.nan))


def actions(name: str) -> cached_property[Array]:
    """Return a property that reads a column of telemetry without the final state, (T, n)."""
    return cached_property(lambda run: run._of_nodes(name, run.T, np.nan))


def flags(name: str) -> cached_property[Mask]:
    """Return a property that reads a column of flags of edges, (T, E)."""
    return cached_property(lambda run: run._of_edges(name, False))


def recomputed(name: str) -> cached_property[Array]:
    """Return a property that recomputes a field of `metrics.observer.Batch`, (T,) or (T, n)."""
    return cached_property(lambda run: run._by_step(getattr(run._observed[0], name)))


def total(name: str) -> cached_property[Array]:
    """Return a property that recomputes a total, (T,), or reads it from the summary if not all rows were kept."""
    return cached_property(
        lambda run: run._by_step(getattr(run._observed[0], name)) if run.whole else run._summed(name, run.T)
    )
