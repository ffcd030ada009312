"""The setup of a process of a run: the environment of its libraries, and its scheduling."""

from __future__ import annotations

import contextlib
import ctypes
import functools
import os
import threading
import warnings
from collections.abc import Mapping

LONG_BYTES = 2**14
"""The size of a long message. The send buffer of Zenoh holds a few messages of 64 kB."""
_M_TRIM_THRESHOLD, _M_MMAP_MAX, _M_ARENA_MAX = -1, -4, -8
_RUNTIME = "ZENOH_RUNTIME"
KEPT = threading.local()
"""Python drops this with its other data about the thread."""
_DUTIES = ("rx", "tx", "app", "net", "acc")


def runtime_environment() -> dict[str, str]:
    """Return the environment variables that a process sets before it loads Zenoh and numpy.

    Many processes share few cores (docs/performance-notes.md). So Zenoh has one thread for each duty of its runtime.
    `tx`, which sends, also accepts connections (`acc`): the thread that accepts a connection notices every packet on
    it, and `tx` is often awake. `rx` must not do this. It waits while it passes on a long message, and meanwhile
    another thread has to notice that the socket takes it.

    Linear algebra has no threads: agents and plant do not use it, and a process that forks must have none.
    """
    duties = dict.fromkeys(_DUTIES, "worker_threads: 1") | {"acc": "handover: tx"}
    return {"OPENBLAS_NUM_THREADS": "1", _RUNTIME: _threads(duties)}


def one_network_thread() -> None:
    """Make Zenoh do all its work on one thread, in a process that has not used it yet.

    A received message and its answer then wake up one thread, not three. But a call on that thread that waits for its
    own message to leave waits forever. So another thread must send long messages. A router, which forwards long
    messages, cannot use this.
    """
    os.environ[_RUNTIME] = _threads(dict.fromkeys(_DUTIES, "handover: app") | {"app": "worker_threads: 1"})


def _threads(duties: Mapping[str, str]) -> str:
    return f"({', '.join(f'{duty}: ({who})' for duty, who in duties.items())})"


def share_the_cores() -> None:
    """Ask the kernel, on Linux, not to interrupt other processes when this one wakes up.

    Many processes answer each other on few cores. Each does its short work without a break, which makes the loop a
    fifth to a third faster (docs/performance-notes.md). Threads that start later inherit the setting.
    """
    with contextlib.suppress(AttributeError, OSError):
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


@functools.cache
def let_numbers_overflow() -> None:
    """Let our own arithmetic overflow to infinity without numpy's warnings.

    An unstable law drives a network there. Warnings about the law's own arithmetic stay on.
    """
    for package in ("agents", "plant", "orchestrator", "topologies", r"numpy\._core"):
        warnings.filterwarnings("ignore", category=RuntimeWarning, module=rf"{package}\.")


def keep_thread() -> None:
    """Keep Python's data about this thread, which belongs to Zenoh, until the process ends.

    Without this, Python would create and free that data for every message, which takes a quarter of the loop's time
    (docs/performance-notes.md). Zenoh may change to another thread, so every message calls this.
    """
    if not hasattr(KEPT, "here"):
        KEPT.here = True
        ctypes.pythonapi.PyGILState_Ensure()


def keep_memory() -> None:
    """Ask the C library, if it is glibc, to keep freed memory for the next allocation.

    Long messages are allocated and freed at every step. Without this, their pages would be returned to the kernel and
    filled with zeros each time.
    """
    with contextlib.suppress(AttributeError, OSError):
        library = ctypes.CDLL(None)
        library.mallopt(_M_MMAP_MAX, 0)
        library.mallopt(_M_ARENA_MAX, 1)
        library.mallopt(_M_TRIM_THRESHOLD, 2**31 - 1)
