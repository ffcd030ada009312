"""Scores of set-membership that differ by rounding tie, and the first candidate of the list wins."""

from __future__ import annotations

import pytest

import hedgerow as hg

EAGER = """
name: eager
b: 0.1
steps: 300
defaults: {{x0: 0, a: 0.3, candidates: {listed}}}
nodes:
  1: {{disturbance: {{kind: constant, value: {w}}}}}
  2: {{disturbance: {{kind: constant, value: -{w}}}}}
edges: [[1, 2]]
"""


@pytest.mark.parametrize("w", [1.0, 0.1, 0.3, 7.7])
def test_under_a_constant_disturbance_the_first_candidate_wins(w: float) -> None:
    for listed, first in (("[0.3, 0.979]", 0.3), ("[0.979, 0.3]", 0.979)):
        run = hg.simulate(EAGER.format(listed=listed, w=w), law="set-membership")
        assert (run.ahat == first).all()
