"""Compiled loops for large networks, if numba is installed (the extra `fast`); numpy gives the same bits without it."""

from __future__ import annotations

import functools
import importlib
import logging
from types import ModuleType

LOG = logging.getLogger("topologies")
LARGE = 4096
"""From this number of nodes on, compiled loops save more time than loading the compiler takes."""
WORTH = 10**7
"""From this number of steps times (150 + nodes) on, they save at least a second; loading them takes less."""
_in_long_runs = False
"""True in a process that makes long runs of small networks"""


def prepare(nodes: int, steps: int) -> None:
    """Have this process use compiled loops for networks of all sizes if so long a run repays the time to load them."""
    global _in_long_runs  # noqa: PLW0603 (the loops stay loaded as long as the process)
    _in_long_runs |= steps * (150 + nodes) >= WORTH


def kernels_for(nodes: int) -> ModuleType | None:
    """Return `hedgerow.topologies.kernels` if it is faster and available; otherwise None."""
    return _kernels() if _in_long_runs or nodes >= LARGE else None


def unequal_kernels_for(nodes: int) -> ModuleType | None:
    """Return `hedgerow.topologies.unequal_kernels`, for gains or weights that differ; otherwise as `kernels_for`."""
    return _kernels("unequal_kernels") if _in_long_runs or nodes >= LARGE else None


@functools.cache
def _kernels(name: str = "kernels") -> ModuleType | None:
    try:
        return importlib.import_module(f"hedgerow.topologies.{name}")  # slow to load
    except Exception as error:  # no numba, one that fails on this machine, or no folder for the compiled code
        if not (isinstance(error, ModuleNotFoundError) and error.name == "numba"):
            LOG.warning("without compiled loops (numpy gives the same bits): %s: %s", type(error).__name__, error)
        return None
