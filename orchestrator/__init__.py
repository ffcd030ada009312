"""The operator: launches a network, observes it, records it, and judges the run.

from hedgerow.orchestrator import load_run    # what a run left, as arrays and tables (docs/data.md)
from hedgerow.orchestrator import simulate    # a run in this process, and what it left
"""

from __future__ import annotations

TYPE_CHECKING = False  # the one of typing, which takes a while to load: every command and every process comes by here
if TYPE_CHECKING:
    from hedgerow.orchestrator.launch.simulation import simulate
    from hedgerow.orchestrator.runs.reader import RecordedRun, load_run

__all__ = ["RecordedRun", "load_run", "simulate"]


def __getattr__(name: str) -> object:
    """Load what makes and reads runs when it is first asked for."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if name == "simulate":
        from hedgerow.orchestrator.launch import simulation as module  # noqa: PLC0415
    else:
        from hedgerow.orchestrator.runs import reader as module  # type: ignore[no-redef]  # noqa: PLC0415

    return getattr(module, name)
