"""The runs of a sweep or a comparison that are not valid, in a few lines."""

from __future__ import annotations

from collections.abc import Sequence

from hedgerow.orchestrator.experiments.sweep.plan import Plan
from hedgerow.orchestrator.experiments.sweep.runs import Row
from hedgerow.orchestrator.metrics.verdict import EXIT_CODES, INVALID, UNKNOWN, VALID

MAX_LINES, MAX_SEEDS = 20, 8


def lines(plan: Plan, rows: Sequence[Sequence[Row]]) -> list[str]:
    """Return one line per setting and verdict except valid: its seeds, and the reasons of the first of them."""
    groups: dict[tuple[str, int], list[Row]] = {}
    for k, own in enumerate(rows):
        for row in own:
            if row["verdict"] != VALID:
                groups.setdefault((row["verdict"], k), []).append(row)
    ordered = sorted(groups, key=lambda key: ((INVALID, UNKNOWN).index(key[0]), key[1]))
    found = [_line(plan, *key, groups[key], len(rows[key[1]])) for key in ordered[:MAX_LINES]]
    if len(ordered) > MAX_LINES:
        runs = sum(len(groups[key]) for key in ordered[MAX_LINES:])
        found.append(f"and {runs} runs of {len(ordered) - MAX_LINES} other settings")
    return found


def _line(plan: Plan, verdict: str, setting: int, failed: Sequence[Row], runs: int) -> str:
    seeds = ", ".join(str(row["seed"]) for row in failed[:MAX_SEEDS]) + ", …" * (len(failed) > MAX_SEEDS)
    which = f"seed{'s' * (len(failed) > 1)} {seeds} ({len(failed)} of {runs} runs)"
    first = failed[0]["reasons"]
    other = len({row["reasons"] for row in failed} - {first})
    more = f"; {other} other reason{'s' * (other > 1)}" if other else ""
    return f"{verdict}: {plan.label(setting)}: {which}: {first}{more}"


def worst(rows: Sequence[Sequence[Row]]) -> str:
    """Return the worst verdict of all runs."""
    verdicts = {row["verdict"] for own in rows for row in own}
    return next(one for one in (INVALID, UNKNOWN, VALID) if one in verdicts)


def exit_code(rows: Sequence[Sequence[Row]]) -> int:
    """Return 0 if all runs are valid, 1 if one is not, 3 if one is unknown."""
    return int(EXIT_CODES[worst(rows)])
