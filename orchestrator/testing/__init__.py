"""Networks in tests: the fixture `network`, its scenarios, and their runs (docs/testing.md).

The pytest plugin is in this package, so each module loads at the first use of its names.
"""

from __future__ import annotations

TYPE_CHECKING = False  # the constant of typing takes time to load
if TYPE_CHECKING:
    from hedgerow.orchestrator.launch.running import Running
    from hedgerow.orchestrator.runs.difference import Estimates
    from hedgerow.orchestrator.runs.run import Run
    from hedgerow.orchestrator.testing.laws import check_law
    from hedgerow.orchestrator.testing.scenario import Networks, Scenario, VerdictError

_HOMES = {
    "Estimates": "runs.difference",
    "Networks": "testing.scenario",
    "Run": "runs.run",
    "Running": "launch.running",
    "Scenario": "testing.scenario",
    "VerdictError": "testing.scenario",
    "check_law": "testing.laws",
}
__all__ = ["Estimates", "Networks", "Run", "Running", "Scenario", "VerdictError", "check_law"]


def __getattr__(name: str) -> object:
    """Load the module of a public name at its first use."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module  # noqa: PLC0415

    return getattr(import_module(f"hedgerow.orchestrator.{_HOMES[name]}"), name)
