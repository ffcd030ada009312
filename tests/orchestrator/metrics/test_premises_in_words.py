"""Outputs that show a bound name the truth that it holds for, and the x(0) that it holds from."""

from __future__ import annotations

import pytest

import hedgerow as hg
from hedgerow.orchestrator.metrics.gain_bound import Premise
from hedgerow.orchestrator.metrics.verdict import gain_text

PAIR = {"name": "pair", "b": 0.1, "steps": 20, "nodes": [1, 2], "edges": [[1, 2]]}
DEFAULTS = {"a": 0.3, "candidates": [0.3, 0.5]}
CUT = {"kind": "cut", "edge": [1, 2], "steps": [5, 6]}
JUMP = {"kind": "jump", "node": 1, "at": 5, "a": 0.5}


def test_bound_lists_the_bounds_of_this_truth_apart_from_the_one_of_any() -> None:
    lines = hg.bound({**PAIR, "defaults": DEFAULTS}).text().splitlines()
    this, any_ = (next(k for k, line in enumerate(lines) if line.startswith(f"for {word}")) for word in ("the", "any"))
    numbers = [k for k, line in enumerate(lines) if line.startswith(("oracle", "at most"))]
    assert [this < k < any_ for k in numbers] == [True] * (len(numbers) - 1) + [False]


def test_a_bound_under_jumps_alone_needs_no_truth() -> None:
    """It is the same for every truth of the lists; the others differ."""
    found = [hg.bound({**PAIR, "defaults": {**DEFAULTS, "a": a}}).bounds for a in (0.3, 0.5)]
    for premise in Premise:
        low, high = (bounds[premise].gain for bounds in found)
        assert (low != pytest.approx(high, rel=1e-6)) == premise.needs_truth


@pytest.mark.parametrize(
    ("faults", "truth"), [([], "for this truth"), ([CUT], "for this truth"), ([JUMP], "for any a(t)")]
)
def test_the_verdict_line_names_the_truth_of_its_bound(faults: list[dict[str, object]], truth: str) -> None:
    line = hg.simulate({**PAIR, "defaults": DEFAULTS | {"x0": 1}, "faults": faults}).verdict.line()
    assert truth in line
    assert ("for this truth" in line) != ("for any a(t)" in line)


def test_a_gain_with_x0_stands_beside_a_bound_from_zero() -> None:
    limit = ("at most 3", "for this truth")
    assert "at most 3 from x(0) = 0" in gain_text(10.0, 2.0, 1.0, True, limit)
    assert "x(0)" not in gain_text(2.0, 2.0, 1.0, True, limit)
