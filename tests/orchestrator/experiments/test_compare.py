"""`orchestrator compare` and `hg.compare`: the same numbers as single runs, paired tests, and stored results."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hedgerow as hg
from hedgerow.orchestrator.experiments.compare import Compared, compare
from hedgerow.orchestrator.experiments.compare.plan import comparison
from hedgerow.orchestrator.experiments.compare.runs import answer
from hedgerow.orchestrator.experiments.compare.statistics import Cell, cells, holm, paired
from hedgerow.orchestrator.experiments.compare.tables import findings
from hedgerow.orchestrator.experiments.sweep.plan import Chunk
from hedgerow.orchestrator.metrics.estimates import judged, switches
from hedgerow.orchestrator.runs import batch
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.resolve import resolve
from tests.tools.networks import simulate
from tests.tools.processes import orchestrator

TREES = {
    "name": "trees",
    "b": 0.1,
    "steps": 25,
    "graph": {"kind": "random_tree", "nodes": 5},
    "defaults": {"x0": 2, "candidates": {"random": 4}},
}


@pytest.mark.parametrize("faults", [[], [{"kind": "jump", "node": 3, "at": 9, "a": "random"}]])
def test_many_runs_at_once_are_the_runs_by_themselves(faults: list[object]) -> None:
    """Every law of the project, with disturbances that are drawn, and one that sees the state."""
    plan = comparison({**TREES, "faults": faults}, ["all"], ["sinusoid", "confuse+ar1"], range(3))
    for k, setting in enumerate(plan.settings):
        assert batch.run(setting.topology, range(3)).good.all()
        together = answer(plan, Chunk(k, (0, 1, 2)))
        alone = [answer(plan, Chunk(k, (seed,))) for seed in range(3)]
        assert together == [row for one in alone for row in one], setting.values  # type: ignore[union-attr]


def test_a_row_agrees_with_the_trajectory() -> None:
    plan = comparison(TREES, ["minimax"], ["white"], range(1))
    topology = resolve(plan.settings[0].topology.model_copy(update={"seed": 0}))
    ran = simulate(topology)
    ahat, a = ran.report[:, 0], topology.network.a
    rows = answer(plan, Chunk(0, (0,)))
    assert isinstance(rows, list)
    (row,) = rows
    assert row["share_right"] == (ahat[-1] == a).mean()
    assert row["error"] == pytest.approx(np.abs(ahat[-1] - a).mean(), rel=1e-12)
    assert row["switches"] == (ahat[1:] != ahat[:-1]).sum() / 5


def test_an_estimate_between_candidates_supports_the_nearest() -> None:
    found = judged(
        np.array([0.31, 0.62, np.nan]), np.array([0.3, 0.9, 0.3]), np.array([[0.3, 0.6, 0.3], [0.6, 0.9, np.nan]])
    )
    assert found["share_right"] == pytest.approx(1 / 3)
    assert found["error"] == pytest.approx((0.01 + 0.28) / 2)
    assert switches(np.array([[1.0, 2.0, np.nan]]), np.array([[1.0, 3.0, 4.0]])).tolist() == [1.0]


@given(st.lists(st.floats(0, 1), max_size=12))
def test_holm_is_its_definition(p: list[float]) -> None:
    """The k-th smallest p is multiplied by the number of remaining ones, and never below the one before."""
    found = holm(np.array(p))
    largest = 0.0
    for k, place in enumerate(sorted(range(len(p)), key=lambda i: (p[i], i))):
        largest = max(largest, (len(p) - k) * p[place])
        assert found[place] == pytest.approx(min(1.0, largest))


def cell(law: str, values: list[float], metric: str = "share_right") -> Cell:
    return Cell("white", law, metric, np.array(values))


def test_the_findings_follow_from_the_numbers() -> None:
    """A law wins if the test decides so; the oracle never wins; undecided pairs are named."""
    draw = np.random.default_rng(1)
    noise = draw.normal(size=40) / 100
    made = [
        cell("good", list(0.9 + noise)),
        cell("bad", list(0.2 + draw.normal(size=40) / 100)),
        cell("same", list(0.9 + noise + draw.normal(size=40) / 1e6)),
        cell("hinf", [1.0] * 40),
    ]
    (share, *_) = findings(made, paired(made), "white")
    assert "better than bad" in share
    assert "not distinguishable from" in share
    assert "hinf" not in share
    two = [cell("one", [1.0, 2.0], "regret"), cell("other", [3.0, 4.0], "regret")]
    assert not any(test.decided for test in paired(two)), "two seeds decide nothing"


def test_intervals_and_undefined_numbers() -> None:
    one = cell("a", [1.0, 2.0, 3.0, math.nan])
    assert (one.n, one.mean) == (3, 2.0)
    assert one.half == pytest.approx(4.302652729911275 / math.sqrt(3))
    nothing = cell("a", [math.nan, math.nan])
    assert nothing.n == 0
    assert math.isnan(nothing.mean)
    assert math.isnan(nothing.half)


def test_the_oracle_and_the_nominal_law_are_always_included() -> None:
    plan = comparison(TREES, ["notch", "hinf"], ["white"], range(2))
    assert plan.laws == ["notch", "hinf", "nominal"]


def test_a_comparison_in_python_leaves_its_folder_and_is_found_again(tmp_path: Path) -> None:
    found = hg.compare(TREES, ["minimax", "notch"], ["sinusoid", {"kind": "none"}], range(4), out=tmp_path / "c")
    assert isinstance(found, Compared)
    assert found.exit_code == 0
    assert found.mean("hinf", "share_right") == 1.0
    assert found.mean("hinf", "regret") == 0.0
    assert "notch" in str(found)
    assert math.isnan(found.mean("notch", "gain", '{"kind": "none"}'))
    assert {path.name for path in (tmp_path / "c").iterdir()} >= {
        *("runs.csv", "means.csv", "tests.csv", "compare.md", "compare.pdf", "compare.png"),
    }
    with (tmp_path / "c/runs.csv").open() as file:
        assert len(list(csv.DictReader(file))) == 4 * 4 * 2
    before = (tmp_path / "c/runs.jsonl").read_bytes()
    again = hg.compare(TREES, ["minimax", "notch"], ["sinusoid", {"kind": "none"}], range(4), out=tmp_path / "c")
    assert (tmp_path / "c/runs.jsonl").read_bytes() == before
    assert [one.mean for one in again.cells if one.n] == [one.mean for one in found.cells if one.n]


def test_finished_runs_are_not_repeated(tmp_path: Path) -> None:
    """A comparison that was stopped in the middle of a line continues after the last complete one."""
    plan = comparison(TREES, ["minimax"], ["white"], range(3))
    whole = compare(plan, tmp_path / "c", 1, quiet=True)
    assert whole is not None
    lines = (tmp_path / "c/runs.jsonl").read_text().splitlines(keepends=True)
    changed = {**json.loads(lines[0]), "regret": 77.0}
    (tmp_path / "c/runs.jsonl").write_text(json.dumps(changed) + "\n" + lines[1][:20])
    found = compare(plan, tmp_path / "c", 1, quiet=True)
    assert found is not None
    (regret,) = (one for one in found.cells if (one.law, one.metric) == ("minimax", "regret"))
    (before,) = (one for one in cells(plan, whole.rows) if (one.law, one.metric) == ("minimax", "regret"))
    assert regret.values[0] == 77.0
    assert regret.values[1:].tolist() == before.values[1:].tolist()
    with pytest.raises(UserError):
        compare(comparison(TREES, ["notch"], ["white"], range(3)), tmp_path / "c", 1, quiet=True)


@pytest.mark.parametrize(
    ("laws", "disturbances", "code"),
    [(["minimax"], ["sinusoyd"], Code.OPTION), (["minimax"], ["white", "white"], Code.OPTION)],
)
def test_a_mistake_is_refused(laws: list[str], disturbances: list[str], code: Code) -> None:
    with pytest.raises(UserError) as caught:
        comparison(TREES, laws, disturbances, range(2))
    assert caught.value.code == code


def test_a_sweep_computes_the_theta_of_every_seed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    ran = orchestrator("sweep", "paper7", "--seeds=0:2", "--set=law=robust,notch", "--set=steps=5", "--out=s")
    assert ran.returncode == 0, ran.stdout + ran.stderr


@pytest.mark.slow
def test_the_command_compares_and_names_the_winner(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    ran = orchestrator(
        *("compare", "paper7", "--law=minimax", "--law=notch", "--disturbances=sinusoid", "--seeds=0:20"),
        *("--set=defaults.x0=0", "--steps=150", "--jobs=2", "--out=c"),
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert "nodes right: notch is best" in ran.stdout
    listed = orchestrator("laws", "--json")
    assert {"notch", "forgetting", "robust"} <= {row["name"] for row in json.loads(listed.stdout)}
