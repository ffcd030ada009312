"""How a process of a run is set up: the environment of its libraries, and its place among other processes."""

from __future__ import annotations

import contextlib
import os

_DUTIES = ("rx", "tx", "app", "net", "acc")


def runtime_environment() -> dict[str, str]:
    """What to set in the environment of a process before it loads Zenoh and numpy.

    Many processes share few cores (docs/performance.md): Zenoh has one thread for each duty of its runtime, and
    linear algebra, of which agents and plant do none, has no threads; a process that forks must have none.
    """
    zenoh = f"({', '.join(f'{duty}: (worker_threads: 1)' for duty in _DUTIES)})"
    return {"OPENBLAS_NUM_THREADS": "1", "ZENOH_RUNTIME": zenoh}


def share_the_cores() -> None:
    """Ask the kernel not to interrupt others when we wake up, where it can be asked (Linux).

    Many processes answer each other on few cores: each does its little work in one go, and the loop is a fifth to a
    third quicker (docs/performance.md). Threads that are made later inherit it.
    """
    with contextlib.suppress(AttributeError, OSError):
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
