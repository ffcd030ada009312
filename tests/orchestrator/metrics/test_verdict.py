"""The verdict distinguishes a run that is broken on purpose from a good one, and names its step."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import fields, replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hedgerow.agents.law import Array, Minimax, control
from hedgerow.orchestrator.ground.assignment import layout, truth_of, views_of
from hedgerow.orchestrator.metrics.observer import Batch, Observer
from hedgerow.orchestrator.metrics.verdict import Comparison, Ending, Verdict, judge, law_limit
from hedgerow.orchestrator.runs.reference import run
from hedgerow.plant.world import dynamics
from hedgerow.topologies.load import bundled, load
from hedgerow.topologies.resolve import resolve, truth
from hedgerow.topologies.schema import Topology
from hedgerow.wire.message import REPORT_ROWS, TAKEN, End, Telemetry
from tests.tools.examples import examples
from tests.tools.networks import Trajectory, listed, networks, observe, read, simulate

PAPER = resolve(load("paper7"))
GOOD = simulate(PAPER)
"""Thirty steps of the paper's network without a mistake."""


def verdict(ran: Trajectory, topology: Topology = PAPER, ending: Ending | None = None) -> Verdict:
    observer, _ = observe(topology, ran)
    return judge(topology, observer, ending or Ending("run", "in-process", 1))


def failures(judged: Verdict) -> list[str]:
    """The reasons, each without the node and the values that it names."""
    return [reason.partition(": ")[0] for reason in judged.content["reasons"]]


def altered(step: int, **columns: Any) -> Trajectory:
    """Return the good run with other telemetry at one step."""
    rows = list(GOOD.rows)
    rows[step] = rows[step]._replace(**columns)
    return Trajectory(rows, GOOD.end)


def one_ulp_off(values: Array, node: int = 2) -> Array:
    """One node's number, moved to the next float."""
    values = values.copy()
    values[node] = np.nextafter(values[node], np.inf)
    return values


class Careless(Minimax):
    """A law other than (6): it acts on half of its state."""

    def act(self, x: Array) -> Array:
        return control(self.b, 0.5 * x, self.ahat)


CARELESS = f"{__name__}:Careless"


def test_a_good_run_is_valid() -> None:
    """There are seven claims, each checked at every step; the used inputs of the last step are not reported."""
    good = verdict(GOOD)
    assert (good.verdict, good.exit_code) == ("valid", 0)
    assert good.line().startswith("valid: 30 of 30 steps")
    checked = {name: check["steps"] for name, check in good.content["checks"].items()}
    of_the_law = ["dynamics", "contraction", "oracle_certificate", "estimates"]
    assert checked == dict.fromkeys([*of_the_law, "missing_inputs", "faults"], 30) | {"links": 29}
    lost = [good.content[name] for name in ("missing_inputs", "lost_messages", "forgotten_rows", "restarts")]
    assert (lost, good.content["down"], good.content["faults"]) == ([0] * 4, [], [])
    assert "missing" not in good.line()


@pytest.mark.parametrize("node", range(7))
@pytest.mark.parametrize("step", [1, 17, 29])
def test_a_state_that_is_one_ulp_off_is_noticed(step: int, node: int) -> None:
    """x(t) is not equation (1) of step t - 1."""
    bad = verdict(altered(step, x=one_ulp_off(GOOD.rows[step].x, node)))
    assert (bad.verdict, bad.exit_code) == ("INVALID", 1)
    assert f"dynamics fails at step {step - 1}" in failures(bad)
    assert bad.line().startswith(f"INVALID (dynamics fails at step {step - 1}")


def test_the_last_state_is_checked_too() -> None:
    ran = Trajectory(GOOD.rows, GOOD.end._replace(x=one_ulp_off(GOOD.end.x)))
    assert failures(verdict(ran)) == ["dynamics fails at step 29"]


def test_the_first_of_many_wrong_steps_is_named() -> None:
    rows = [row._replace(x=one_ulp_off(row.x)) if row.t >= 9 else row for row in GOOD.rows]
    bad = verdict(Trajectory(rows, GOOD.end))
    assert "dynamics fails at step 8" in failures(bad)


def test_an_input_that_is_not_equation_6_is_noticed() -> None:
    """An agent acts on half of its state in a correct world: only that claim fails."""
    shards = layout(PAPER, None)
    views = views_of(PAPER, shards)
    views[3] = replace(views[3], law=CARELESS)
    *rows, end = run(truth_of(PAPER, shards), views)
    assert isinstance(end, End)
    bad = verdict(Trajectory([row for row in rows if isinstance(row, Telemetry)], end))
    assert bad.verdict == "INVALID"
    assert failures(bad) == ["estimates fails at step 0"]


def test_an_estimate_that_is_no_candidate_is_noticed() -> None:
    """u is (6) of ahat, but ahat is a number from nowhere."""
    row = GOOD.rows[12]
    report = row.report.copy()
    report[0, 4] = np.nextafter(report[0, 4], 1.0)
    u = control(PAPER.b, row.x, report[0])
    bad = verdict(altered(12, report=report, u=u))
    assert "estimates fails at step 12" in failures(bad)


@pytest.mark.parametrize("column", ["x", "u", "w"])
def test_nan_is_never_valid(column: str) -> None:
    values = getattr(GOOD.rows[6], column).copy()
    values[1] = np.nan
    bad = verdict(altered(6, **{column: values}))
    assert bad.verdict == "INVALID"
    json.dumps(bad.content, allow_nan=False)


def one_sided(topology: Topology, ahat: Sequence[Sequence[float]]) -> Trajectory:
    """The plant is wrong: from step 2 on, the edge carries flow at its first end only."""
    a, b, graph = truth(topology), topology.b, topology.graph
    x = np.array([own.x0 for own in topology.nodes.values()], dtype=float)
    rows, on, no_w = [], np.ones(1, np.uint8), np.zeros(2)
    up, used = np.ones(2, np.uint8), np.full(2, TAKEN, np.uint8)
    for t in range(topology.steps):
        report = np.zeros((REPORT_ROWS, 2))
        report[0] = ahat[t % 2]
        u = control(b, x, report[0])
        rows.append(Telemetry(t, x, u, no_w, report, on, up, used))
        x = dynamics(a, b, graph, x, u, no_w, np.ones(1, np.bool_))
        if t >= 2:
            x[1] = a[1] * rows[-1].x[1]
    return Trajectory(rows, End(topology.steps, x, 0.0))


def test_one_sided_flow_and_its_effect_on_stability_are_noticed() -> None:
    """Two nodes, b = .1, a = .97: with switching estimates such a plant is unstable."""
    topology = read(
        "{name: pair, b: 0.1, steps: 4, nodes: [1, 2], edges: [[1, 2]],"
        " defaults: {a: 0.97, x0: 1, candidates: [0.97, 0.03, 0.979]}}"
    )
    ran = one_sided(topology, [[0.979, 0.979], [0.03, 0.979]])
    bad = verdict(ran, topology)
    assert failures(bad)[0] == "dynamics fails at step 2"
    assert "contraction fails at step 3" in failures(bad)
    assert bad.content["checks"]["estimates"]["ok"], "its agents did nothing wrong"


def test_a_users_law_has_no_claims_of_the_paper() -> None:
    """No claim covers (6) or its contraction; but the dynamics must hold."""
    topology = PAPER.model_copy(update={"law": CARELESS})
    ran = simulate(topology)
    own = verdict(ran, topology)
    assert own.verdict == "valid"
    assert set(own.content["checks"]) == {"dynamics", "oracle_certificate", "missing_inputs", "links", "faults"}
    rows = [row._replace(w=row.w + 1.0) if row.t == 5 else row for row in ran.rows]
    assert failures(verdict(Trajectory(rows, ran.end), topology)) == ["dynamics fails at step 5"]


@given(st.sets(st.integers(0, 29), min_size=1, max_size=28), st.integers(1, 30))
@settings(max_examples=examples(50))
def test_lost_telemetry_makes_the_verdict_unknown(lost: set[int], size: int) -> None:
    """For any lost rows and any batches, the run is not blamed: the verdict is unknown."""
    rows = [row for row in GOOD.rows if row.t not in lost]
    observer = Observer(PAPER)
    for k in range(0, len(rows), size):
        observer.take(rows[k : k + size])
    observer.finish(GOOD.end)
    unsure = judge(PAPER, observer, Ending("run", "in-process", 1))
    assert (unsure.verdict, unsure.exit_code) == ("unknown", 3)
    shown = f"{len(lost)} steps of telemetry lost, the first {min(lost)}"
    assert unsure.content["reasons"] == [shown]
    assert unsure.content["lost_rows"] == 7 * len(lost)
    judged = [t for t in range(30) if not {t, t + 1} & lost]
    assert unsure.content["checks"]["dynamics"]["steps"] == len(judged)


def test_a_violation_beside_lost_rows_is_still_a_violation_of_its_step() -> None:
    """Rows 5 and 6 are lost; x(20) is wrong: INVALID, at step 19, in one batch as in many."""
    ran = altered(20, x=one_ulp_off(GOOD.rows[20].x))
    bad = verdict(Trajectory([row for row in ran.rows if row.t not in (5, 6)], ran.end))
    assert bad.verdict == "INVALID"
    assert failures(bad)[0] == "dynamics fails at step 19"
    assert failures(bad)[-1] == "2 steps of telemetry lost, the first 5"


def test_a_run_that_was_stopped_is_unknown() -> None:
    """12 of 30 steps, all of them good: exit code 3, with the reason."""
    rows = GOOD.rows[:12]
    ran = Trajectory(rows, End(12, GOOD.rows[12].x, 0.5))
    stopped = verdict(ran, ending=Ending("run", "in-process", 1, stopped="stopped at step 12"))
    assert (stopped.verdict, stopped.exit_code) == ("unknown", 3)
    assert stopped.content["reasons"] == ["stopped at step 12"]
    assert (stopped.content["steps_done"], stopped.content["steps"]) == (12, 30)
    assert stopped.line().startswith("unknown (stopped at step 12): 12 of 30 steps")


def test_a_run_without_a_single_row_is_unknown() -> None:
    """The run was stopped before its first step: there are no metrics, and no division by zero."""
    observer = Observer(PAPER)
    observer.finish(End(0, observer.x0, 0.0))
    nothing = judge(PAPER, observer, Ending("run", "in-process", 1, stopped="stopped at step 0"))
    assert (nothing.exit_code, nothing.content["metrics"]) == (3, {})
    assert "0 of 30 steps" in nothing.line()
    json.dumps(nothing.content, allow_nan=False)


def test_a_final_state_that_never_came_is_unknown() -> None:
    observer = Observer(PAPER)
    observer.take(GOOD.rows)
    unsure = judge(PAPER, observer, Ending("run", "in-process", 1))
    assert unsure.exit_code == 3
    assert unsure.content["reasons"] == ["the final state is missing"]


def test_a_run_that_differs_from_its_reference_is_invalid() -> None:
    differs = verdict(GOOD, ending=Ending("run", "zenoh", 7, comparison=Comparison(False, 3, "node 1")))
    assert differs.exit_code == 1
    assert differs.content["reasons"][0].startswith("reference fails")
    equal = verdict(GOOD, ending=Ending("run", "zenoh", 7, comparison=Comparison(True)))
    assert equal.exit_code == 0
    assert equal.content["checks"]["reference"]["ok"]


@pytest.mark.parametrize(
    ("comparison", "shown"), [(None, False), (Comparison(True), True), (Comparison(False, 3, "x"), False)]
)
def test_the_line_names_a_comparison_that_found_equal_bits(comparison: Comparison | None, shown: bool) -> None:
    judged = verdict(GOOD, ending=Ending("run", "zenoh", 7, comparison=comparison))
    assert ("reference" in judged.content["checks"]) == (comparison is not None)
    *_, last = judged.line().split(", ")
    assert last.endswith("equal") == shown


def test_without_a_disturbance_there_is_no_gain() -> None:
    """With w = 0 from rest, every ratio is undefined, and written as null, never as NaN."""
    topology = read("{name: still, b: 0.1, steps: 5, nodes: [1, 2], edges: [[1, 2]]}")
    still = verdict(simulate(topology), topology)
    assert still.verdict == "valid"
    metrics = still.content["metrics"]
    assert (metrics["gain"], metrics["gain_less_x0"], metrics["cost_ratio"]) == (None, None, None)
    assert "at rest" in still.line()
    json.dumps(still.content, allow_nan=False)


@pytest.mark.parametrize(
    ("x0", "faults", "shown"),
    [
        (0, "", "gain 1.367 (gamma* 2.974 of the oracle)"),
        (15, "", "gain 10.7 with x(0), "),
        (0, "{kind: cut, edge: [2, 4], steps: [9, 10]}", "(gamma* 2.974 of the oracle without faults)"),
        (0, "{kind: drop, link: [2, 4], steps: [9, 10]}", "(gamma* 2.974 of the oracle)"),
    ],
)
def test_gains_are_reported_with_their_references(x0: float, faults: str, shown: str) -> None:
    topology = resolve(load("paper7", [f"defaults.x0={x0}", f"faults=[{faults}]"]))
    assert shown in verdict(simulate(topology), topology).line()


@pytest.mark.parametrize(
    ("gains", "limit"),
    [
        ({"estimates": (3.6541, True), "edges": (3.7551, True), "jumps": (47.4, True)}, "estimates"),
        ({"estimates": (3.6541, False), "edges": (3.7551, True), "jumps": (47.4, True)}, "edges"),
        ({"estimates": (3.6541, False), "edges": (3.7551, False), "jumps": (47.4, True)}, "jumps"),
        ({"estimates": (19.58502, True), "edges": (19.58501, True)}, "estimates"),
        ({"estimates": (3.6541, False)}, None),
    ],
)
def test_the_limit_of_the_law_is_named_with_a_premise_that_held(
    gains: dict[str, tuple[float, bool]], limit: str | None
) -> None:
    bounds = {name: {"gain": gain, "held": held} for name, (gain, held) in gains.items()}
    found = law_limit({"gain_bounds": {"bounds": bounds}})
    assert found == (None if limit is None else (limit, gains[limit][0]))


def in_batches(topology: Topology, ran: Trajectory, cuts: Sequence[int]) -> tuple[Observer, Batch]:
    """Return the metrics of a run with rows in batches that end at `cuts`."""
    observer = Observer(topology)
    ends = sorted({*cuts, len(ran.rows)})
    batches = [observer.take(ran.rows[i:j]) for i, j in zip([0, *ends], ends, strict=False)]
    observer.finish(ran.end)
    columns = {field.name: np.concatenate([getattr(batch, field.name) for batch in batches]) for field in fields(Batch)}
    return observer, Batch(**columns)


BUNDLED = {name: (topology := resolve(load(name)), simulate(topology)) for name in bundled()}


@given(st.data())
@settings(max_examples=examples(60))
def test_batches_of_any_size_give_the_same_numbers(data: st.DataObject) -> None:
    """How telemetry was bundled on its way is not seen in D, R, the costs or anything recorded."""
    topology, ran = BUNDLED[data.draw(st.sampled_from(sorted(BUNDLED)))]
    cuts = data.draw(st.lists(st.integers(1, len(ran.rows)), max_size=8) | st.just(range(1, 25)))
    whole, one = observe(topology, ran)
    parts, many = in_batches(topology, ran, cuts)
    for field in fields(Batch):
        a, b = getattr(one, field.name), getattr(many, field.name)
        assert a.tobytes() == b.tobytes(), field.name
    assert one.cost_regret.tobytes() == many.cost_regret.tobytes()
    assert whole.summary() == parts.summary()
    ending = Ending("run", "in-process", 1)
    assert judge(topology, whole, ending).content == judge(topology, parts, ending).content


@given(networks())
@settings(max_examples=examples(40))
def test_the_metrics_are_their_formulas(topology: Topology) -> None:
    """D, R, gain and beta, from the states of the run and of its twin under the hinf law."""
    ran = simulate(topology)
    twin = simulate(topology.model_copy(update={"law": "hinf"}))
    observer, batch = observe(topology, ran)
    i, j = topology.graph.edges.T
    weights = 1.0 if topology.graph.weights is None else topology.graph.weights

    def stage_costs(run_: Trajectory) -> Array:
        edge_inputs = run_.u[:, j] - run_.u[:, i]
        return np.asarray((run_.x[:-1] ** 2).sum(axis=1) + (weights * edge_inputs**2).sum(axis=1))

    assert_close = partial(np.testing.assert_allclose, rtol=1e-9, atol=1e-12)
    r = np.abs(ran.x - twin.x)
    assert_close(batch.regret, r[:-1])
    assert_close(batch.regret_sum, np.cumsum((r[:-1] ** 2).sum(axis=1)))
    assert observer.regret_sum == pytest.approx((r**2).sum(), rel=1e-9, abs=1e-12)
    c, c_star = np.cumsum(stage_costs(ran)), np.cumsum(stage_costs(twin))
    assert_close(batch.cost_sum, c)
    np.testing.assert_allclose(batch.cost_regret, c - c_star, rtol=1e-9, atol=1e-9 * (1 + c[-1]))
    energy = np.cumsum((ran.w**2).sum(axis=1))
    undefined = energy == 0
    assert (np.isnan(batch.gain()) == undefined).all()
    np.testing.assert_allclose(batch.gain()[~undefined], np.sqrt(c[~undefined] / energy[~undefined]), rtol=1e-9)
    models = listed(topology)
    for k, a in enumerate(truth(topology)):
        x = ran.x[:-1, k]
        sxx = np.concatenate([[0.0], np.cumsum(x * x)[:-1]])
        some = sxx > 0
        assert (np.isnan(batch.beta[:, k]) == ~some).all()
        a_ls = a + batch.beta[some, k]
        scale = 1 + np.abs(a_ls)
        assert (np.abs(batch.a_ls[some, k] - a_ls) < 1e-6 * scale).all(), "a_LS = a + beta"
        clear = some & (batch.margin[:, k] > 1e-9 * (1 + c[-1]))
        right = batch.ahat[:, k] == a
        nearest = np.abs(batch.a_ls[clear, k, None] - models[k]).argmin(axis=1)
        assert (right[clear] == (np.asarray(models[k])[nearest] == a)).all(), "the estimate is the one nearest a_LS"
