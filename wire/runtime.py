"""How the libraries of a process are set up; its environment must stand before they are loaded."""

from __future__ import annotations

_DUTIES = ("rx", "tx", "app", "net", "acc")


def runtime_environment() -> dict[str, str]:
    """What to set in the environment of a process before it loads Zenoh and numpy.

    Many processes share few cores (docs/performance.md): Zenoh has one thread for each duty of its runtime, and
    linear algebra, of which agents and plant do none, has no threads; a process that forks must have none.
    """
    zenoh = f"({', '.join(f'{duty}: (worker_threads: 1)' for duty in _DUTIES)})"
    return {"OPENBLAS_NUM_THREADS": "1", "ZENOH_RUNTIME": zenoh}
