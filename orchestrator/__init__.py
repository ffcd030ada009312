"""The operator: launches a network, observes it, records it, and judges the run.

from orchestrator import load_run    # what a run left, as arrays and tables (docs/data.md)
"""

from __future__ import annotations

TYPE_CHECKING = False  # the one of typing, which takes a while to load: every command and every process comes by here
if TYPE_CHECKING:
    from orchestrator.recorded import RecordedRun, load_run

__all__ = ["RecordedRun", "load_run"]


def __getattr__(name: str) -> object:
    """Load what reads runs when it is first asked for."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from orchestrator import recorded  # noqa: PLC0415

    return getattr(recorded, name)
