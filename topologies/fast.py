"""Compiled loops for large networks, where numba is installed (the extra `fast`); numpy gives the same bits without."""

from __future__ import annotations

import functools
from types import ModuleType

LARGE = 4096
"""From so many nodes on, what compiled loops save is more than what it takes to load a compiler."""


def kernels_for(nodes: int) -> ModuleType | None:
    """`hedgerow.topologies.kernels`, if it pays and is to be had."""
    return _kernels() if nodes >= LARGE else None


@functools.cache
def _kernels() -> ModuleType | None:
    try:
        from hedgerow.topologies import kernels  # noqa: PLC0415  # slow to load
    except (ImportError, RuntimeError):  # no numba, or nowhere to keep what it compiles
        return None
    return kernels
