"""The lines that pytest shows when two runs, or their estimates, are not equal."""

from __future__ import annotations

from hedgerow.orchestrator.runs.difference import Estimates, explain_estimates, explain_runs
from hedgerow.orchestrator.runs.run import Run


def explain(left: object, right: object) -> list[str] | None:
    """Return lines that explain the first difference; None for other objects."""
    if isinstance(left, Estimates) and isinstance(right, Estimates):
        return explain_estimates(left, right)
    if isinstance(left, Run) and isinstance(right, Run):
        return explain_runs(left, right)
    return None
