"""The numbers of a run for a reader: each with its meaning, and with the conclusions that it does not permit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hedgerow.orchestrator.metrics.fault_schedule import Schedule
from hedgerow.orchestrator.metrics.guarantee import rounded_up
from hedgerow.orchestrator.runs.run import Run

METRICS = {
    "nodes_right": "estimates that are the truth at the end",
    "estimate_error": "mean |â − a| at the end, over the nodes with an estimate",
    "regret": "D = Σ |x − x*|², trajectory regret",
    "regret_nominal": "D of the nominal controller",
    "cost": "C = Σ |x|² + Σ k_e u_e², cost",
    "cost_oracle": "C*, the oracle's cost",
    "cost_regret": "R = C − C*, cost regret, signed",
    "cost_ratio": "C / C*",
    "disturbance_energy": "Σ |w|²",
    "gain": "√(C / Σ |w|²), gain",
    "gain_less_x0": "the same with V(x(0)) subtracted, the maximum cost of x(0) for the oracle",
    "gamma_star": "γ*, the oracle's optimal gain",
    "rho": "ρ, contraction",
}
"""The meaning of each field of `metrics` in verdict.json; docs/theory.md has more."""


def metrics(run: Run) -> Mapping[str, Any]:
    """Return the numbers of the verdict if it has them all, otherwise those recorded so far."""
    recorded: Mapping[str, Any] = run.verdict.content.get("metrics", {})
    return recorded if METRICS.keys() <= recorded.keys() else run.metrics


def number(value: Any) -> str:
    """Return a number as text."""
    return "undefined" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)


def sentences(run: Run) -> list[str]:
    """Return sentences about the meaning of the numbers of a run."""
    m, n, right = metrics(run), len(run.ids), run.right[run.right >= 0]
    found = []
    if run.real_estimates:
        found.append(
            f"The law estimates real numbers: the mean of |â − a| is {number(m['estimate_error'])} at the end."
        )
    elif np.isfinite(run.ahat).any():
        found.append(_estimates(int(m["nodes_right"]), n, int(right.max()), run.T))
    if run.law == "hinf":
        found.append("The law is the oracle's: there is nothing to regret.")
    elif m["regret"] is None:
        found.append("D is too large for a number: the network diverged under the law.")
    elif run.law != "nominal":
        nearer = "nearer to the oracle than that" if m["regret"] < m["regret_nominal"] else "no nearer to it than a"
        found.append(
            f"D is {m['regret']:.4g}, and {m['regret_nominal']:.4g} under the nominal controller: the law was {nearer}"
            " fixed guess."
        )
    if m["cost_regret"]:
        sign = "more" if m["cost_regret"] > 0 else "less"
        found.append(f"It cost {abs(m['cost_regret']):.4g} {sign} than the oracle; either sign is possible.")
    if m["gain_less_x0"] is not None:
        found.append(_gain(m["gain_less_x0"], m["gamma_star"], run))
    if len(run.ceiling) and np.isfinite(run.ceiling[-1]):
        found.append(
            f"From x(0) = 0, no disturbance makes the gain of a law that acts within the lists larger than"
            f" {rounded_up(float(run.ceiling[-1]))}, under the edge cuts and jumps of this run."
        )
    return found


def _gain(less: float, gamma_star: float, run: Run) -> str:
    if less == 0:
        return (
            f"V(x(0)), the maximum cost of x(0) for the oracle, is more than the whole cost. So this run is too short"
            f" to compare its gain with γ* = {gamma_star:.4g}."
        )
    text = (
        f"The gain with V(x(0)) subtracted, the maximum cost of x(0) for the oracle, is {less:.4g},"
        f" and γ* = {gamma_star:.4g}."
    )
    if not run.faultless:
        return f"{text} γ* is the oracle's while all edges are open and no a jumps: here they were not, or one did."
    if run.law == "hinf":
        return f"{text} No disturbance makes the oracle's larger than γ*."
    return f"{text} γ* is the oracle's number; it does not bound the gain of this law."


def _estimates(right: int, n: int, most: int, steps: int) -> str:
    fell = f" There were up to {most} before: estimates can get worse during a run." if most > right else ""
    return f"{right} of {n} estimates are the truth after {steps} steps; this proves nothing about later steps.{fell}"


def growth(run: Run) -> list[str]:
    """Return, by fault, the part of D from the steps of its schedule, of any cause."""
    D, T = run.regret_sum, run.T
    steps: list[list[int]] = [[] for _ in run.topology.faults]
    for effect in Schedule(run.topology).effects:
        steps[effect.fault] += [effect.start, effect.stop - 1] if effect.table is None else [*effect.table]
    shares = []
    for own in steps:
        start, stop = (min(own), min(max(own) + 1, T)) if own else (0, 0)
        shares.append(f"{D[stop] - D[start]:.4g}" if start < stop else "—")
    return shares
