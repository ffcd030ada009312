"""How a process of a run is set up: the environment of its libraries, and its place among other processes."""

from __future__ import annotations

import contextlib
import ctypes
import os
import threading
import warnings
from collections.abc import Mapping

LONG_BYTES = 2**14
"""A message so long is more than Zenoh takes at once: what waits to be sent has room for a few of 64 kB."""
_M_TRIM_THRESHOLD, _M_MMAP_MAX, _M_ARENA_MAX = -1, -4, -8
_RUNTIME = "ZENOH_RUNTIME"
KEPT = threading.local()
"""Python forgets it with the rest of what it knows of a thread."""
_DUTIES = ("rx", "tx", "app", "net", "acc")


def runtime_environment() -> dict[str, str]:
    """What to set in the environment of a process before it loads Zenoh and numpy.

    Many processes share few cores (docs/performance.md): Zenoh has one thread for each duty of its runtime, and
    linear algebra, of which agents and plant do none, has no threads; a process that forks must have none.
    """
    return {"OPENBLAS_NUM_THREADS": "1", _RUNTIME: _threads(dict.fromkeys(_DUTIES, "worker_threads: 1"))}


def one_network_thread() -> None:
    """Have Zenoh do all its duties in one thread, in a process that has not loaded it yet or not used it.

    To hear and to answer wakes up one thread then, not three. But who waits on that thread until what it says is on its
    way waits for itself: what is long must be said by another, and a router, which has to pass on what is long, cannot
    live so.
    """
    os.environ[_RUNTIME] = _threads(dict.fromkeys(_DUTIES, "handover: app") | {"app": "worker_threads: 1"})


def _threads(duties: Mapping[str, str]) -> str:
    return f"({', '.join(f'{duty}: ({who})' for duty, who in duties.items())})"


def share_the_cores() -> None:
    """Ask the kernel not to interrupt others when we wake up, where it can be asked (Linux).

    Many processes answer each other on few cores: each does its little work in one go, and the loop is a fifth to a
    third quicker (docs/performance.md). Threads that are made later inherit it.
    """
    with contextlib.suppress(AttributeError, OSError):
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


def let_numbers_overflow() -> None:
    """Have our own arithmetic say that a number grew too large by its being infinite, and not by numpy's warnings.

    A law that is not stable drives a network there; of its own arithmetic it is warned.
    """
    for package in ("agents", "plant", "orchestrator", "topologies", r"numpy\._core"):
        warnings.filterwarnings("ignore", category=RuntimeWarning, module=rf"{package}\.")


def keep_thread() -> None:
    """Have Python keep what it knows of this thread, which is one of Zenoh's, until the process ends.

    Else it would make that for every message, map memory for it, and throw both away: a quarter of the loop's time
    (docs/performance.md). Zenoh may go on with another thread, so that every message asks for it.
    """
    if not hasattr(KEPT, "here"):
        KEPT.here = True
        ctypes.pythonapi.PyGILState_Ensure()


def keep_memory() -> None:
    """Ask the C library, where it is glibc, to keep what is freed for what comes next.

    Long messages come and go at every step, and their pages would be given back, and filled with zeros, each time.
    """
    with contextlib.suppress(AttributeError, OSError):
        library = ctypes.CDLL(None)
        library.mallopt(_M_MMAP_MAX, 0)
        library.mallopt(_M_ARENA_MAX, 1)
        library.mallopt(_M_TRIM_THRESHOLD, 2**31 - 1)
