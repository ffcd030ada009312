"""How Zenoh's runtime is set up in the processes of a run; its environment must stand before Zenoh is loaded."""

from __future__ import annotations

_DUTIES = ("rx", "tx", "app", "net", "acc")


def runtime_environment() -> dict[str, str]:
    """What to set in the environment of a process before it loads Zenoh.

    One thread for each duty of its runtime: many processes share few cores (docs/performance.md).
    """
    return {"ZENOH_RUNTIME": f"({', '.join(f'{duty}: (worker_threads: 1)' for duty in _DUTIES)})"}
