"""A run that diverges is reported as such, without numpy's warnings, and its checks still judge the run."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import hedgerow as hg
from hedgerow.agents.law import Array, Minimax
from hedgerow.agents.loading import LawError
from hedgerow.orchestrator.experiments.sweep.runs import run_here

NETWORK = """
name: flipped
b: 0.2
steps: 200
law: minimax
defaults: {a: 0.3, candidates: [0.3, 0.7], disturbance: {kind: sinusoid, amplitude: 1, omega: 0.7}}
nodes: {1: {x0: 5}, 2: {}, 3: {}}
edges: [[1, 2], [2, 3]]
"""


class Flipped(Minimax):
    """A law with the wrong sign, and too large: the network is unstable under it."""

    def act(self, x: Array) -> Array:
        return np.asarray(-60 * super().act(x))


LAW = f"{__name__}:Flipped"


@pytest.fixture
def file(here: Path) -> Path:
    (path := here / "flipped.yaml").write_text(NETWORK)
    return path


@pytest.mark.parametrize(("steps", "is_finite"), [(10, True), (200, False)])
def test_a_valid_run_that_diverges_says_so(file: Path, steps: int, is_finite: bool) -> None:
    """Warnings are errors in these tests."""
    found = hg.simulate(file, law=LAW, steps=steps).verdict
    assert found.verdict == "valid"
    assert found.content["diverged"]
    assert (found.content["metrics"]["cost"] is not None) == is_finite
    assert found.line() != dataclasses.replace(found, content={**found.content, "diverged": False}).line()


def test_a_run_that_ends_at_an_infinite_input_has_diverged(file: Path) -> None:
    with pytest.raises(LawError):
        hg.simulate(file, law=LAW, steps=400)
    content = hg.load_run("runs/latest").verdict.content
    assert (content["verdict"], content["diverged"]) == ("unknown", True)


@pytest.mark.parametrize(
    "settings",
    [
        {"law": "minimax"},
        {"law": "minimax", "nodes.1.x0": 1e99},
        {"law": LAW, "steps": 1},
        {"law": "minimax", "nodes.1.x0": 0, "defaults.disturbance": None},
    ],
)
def test_other_runs_have_not_diverged(file: Path, settings: dict[str, object]) -> None:
    assert not run_here(hg.load(file, **settings))["diverged"]


def test_a_comparison_counts_the_seeds_of_its_folder(file: Path) -> None:
    whole = hg.compare(file, [LAW], seeds=range(4), out="cmp", steps=10)
    part = hg.compare(file, [LAW], seeds=range(2), out="cmp", steps=10)
    assert (whole.seeds_there, part.seeds_there) == (4, 4)
    assert len(part.plan.seeds) == 2
    assert part.method.startswith(alone := hg.compare(file, [LAW], seeds=range(2), out="alone", steps=10).method)
    assert part.method != alone
