"""The bounds on the gain of the law that the verdict of a run holds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from hedgerow.orchestrator.metrics.gain_bound import Premise
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.graph import Array

if TYPE_CHECKING:
    from hedgerow.orchestrator.runs.run import Run


def ceiling(run: Run) -> Array:
    """Return the least bound on the gain that holds at each step, NaN without one, (T,)."""
    least = np.full(run.T, np.nan)
    for premise in Premise:
        bound = bound_of(run, premise)
        if isinstance(bound.get("gain"), float) and isinstance(bound.get("steps"), int):
            covered = least[: max(0, bound["steps"])]
            np.fmin(covered, bound["gain"], out=covered)
    return least


def slack(run: Run, premise: str) -> Array:
    """Return the slack of the certificate of the law at each step, (T,); see `Run.certificate_slack`."""
    bound = bound_of(run, premise)
    run.need_all("the slack of a certificate")
    if not isinstance(bound.get("p"), list) or len(bound["p"]) != len(run.ids):
        raise UserError(f"{run.folder}: verdict.json has no bound under the premise {premise!r}", code=Code.FILE_FORMAT)
    p, steps = np.array(bound["p"]), bound["steps"]
    end, start = (run.x[1:] ** 2 * p).sum(axis=1), float((run.x[0] ** 2 * p).sum())
    whole: Array = bound["g"] * run.energy_sum + start - end - run.cost_sum
    return np.where(np.arange(run.T) < steps, whole, np.nan)


def ceiling_slack(run: Run) -> Array:
    """Return the slack of the bound in `ceiling` at each step, NaN without one, (T,)."""
    if is_recorded(run):
        return run._summed("ceiling_slack", run.T)
    return computed_slack(run)


def computed_slack(run: Run) -> Array:
    """Return the slack of the bound in `ceiling` at each step, computed from the states, NaN without one, (T,)."""
    found = np.full(run.T, np.nan)
    # The strongest premise last: where it holds, its bound is the least.
    for premise in reversed(Premise):
        if isinstance(bound_of(run, premise).get("p"), list):
            own = slack(run, premise)
            found = np.where(np.isnan(own), found, own)
    return found


def is_recorded(run: Run) -> bool:
    """Return True if the summary has the slack: older runs, and runs without a summary, do not."""
    return "summary" in run.tables and "ceiling_slack" in run.tables["summary"].schema.names


def bound_of(run: Run, premise: str) -> Mapping[str, Any]:
    """Return the entry of one bound in the verdict; empty if there is none."""
    found: Any = run.verdict.content
    for key in ("gain_bounds", "bounds", premise):
        found = found.get(key) if isinstance(found, Mapping) else None
    return found if isinstance(found, Mapping) else {}
