"""Compiled loops for large networks, where numba is installed (the extra `fast`); numpy gives the same bits without."""

from __future__ import annotations

import functools
import importlib
import logging
from types import ModuleType

LOG = logging.getLogger("topologies")
LARGE = 4096
"""From so many nodes on, what compiled loops save is more than what it takes to load a compiler."""


def kernels_for(nodes: int) -> ModuleType | None:
    """`hedgerow.topologies.kernels`, if it pays and is to be had."""
    return _kernels() if nodes >= LARGE else None


def unequal_kernels_for(nodes: int) -> ModuleType | None:
    """`hedgerow.topologies.unequal_kernels`, for gains or weights that differ; else as `kernels_for`."""
    return _kernels("unequal_kernels") if nodes >= LARGE else None


@functools.cache
def _kernels(name: str = "kernels") -> ModuleType | None:
    try:
        return importlib.import_module(f"hedgerow.topologies.{name}")  # slow to load
    except Exception as error:  # no numba, one that fails on this machine, or nowhere to keep what it compiles
        if not (isinstance(error, ModuleNotFoundError) and error.name == "numba"):
            LOG.warning("compiled loops are left out, numpy gives the same bits: %s: %s", type(error).__name__, error)
        return None
