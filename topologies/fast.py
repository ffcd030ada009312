"""Compiled loops for large networks, if numba is installed (the extra `fast`); numpy gives the same bits without it."""

from __future__ import annotations

import functools
import importlib
import logging
from types import ModuleType

LOG = logging.getLogger("topologies")
LARGE = 4096
"""From this number of nodes on, compiled loops save more time than loading the compiler takes."""


def kernels_for(nodes: int) -> ModuleType | None:
    """Return `hedgerow.topologies.kernels` if it is faster and available; otherwise None."""
    return _kernels() if nodes >= LARGE else None


def unequal_kernels_for(nodes: int) -> ModuleType | None:
    """Return `hedgerow.topologies.unequal_kernels`, for gains or weights that differ; otherwise as `kernels_for`."""
    return _kernels("unequal_kernels") if nodes >= LARGE else None


@functools.cache
def _kernels(name: str = "kernels") -> ModuleType | None:
    try:
        return importlib.import_module(f"hedgerow.topologies.{name}")  # slow to load
    except Exception as error:  # no numba, one that fails on this machine, or no folder for the compiled code
        if not (isinstance(error, ModuleNotFoundError) and error.name == "numba"):
            LOG.warning("without compiled loops (numpy gives the same bits): %s: %s", type(error).__name__, error)
        return None
