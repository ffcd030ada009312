"""Accounts of faults: each fired as scheduled and was seen where it struck, or the run is INVALID, by name and step.

plant    drop 2->4 at 10:    the row of step 10 does not cross          fired
agent 4  at 11:              "of step 10 I took in no row of 2"         seen
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hedgerow.agents.law import control
from hedgerow.orchestrator.launch.recording import Recording
from hedgerow.orchestrator.launch.simulation import simulate_into
from hedgerow.orchestrator.launch.watching import Watching
from hedgerow.orchestrator.metrics.observer import Observer
from hedgerow.orchestrator.metrics.verdict import Ending, Verdict, judge
from hedgerow.orchestrator.runs.folder import create
from hedgerow.orchestrator.views.screen import Quiet
from hedgerow.plant.faults import Lots
from hedgerow.plant.world import dynamics
from hedgerow.topologies.effects import Effect
from hedgerow.topologies.load import load, parse
from hedgerow.topologies.resolve import resolve, truth
from hedgerow.topologies.schema import Topology
from hedgerow.topologies.settings import Node
from hedgerow.wire.message import Flag
from tests.tools.examples import examples
from tests.tools.networks import Trajectory, networks, observe, read, simulate
from tests.tools.schedules import Plain, schedules, with_faults

PAPER = resolve(load("paper7"))
Counts = dict[str, int]


@st.composite
def faulty(draw: st.DrawFn, most: int = 5, steps: int = 12) -> Topology:
    """Any network under any schedule, with back-filling or without."""
    topology = draw(networks(most=most, steps=steps))
    return with_faults(topology, draw(schedules(topology)), backfill=draw(st.booleans()))


def verdict(topology: Topology, ran: Trajectory, ending: Ending | None = None) -> Verdict:
    observer, _ = observe(topology, ran)
    return judge(topology, observer, ending or Ending("run", "in-process", 0))


def struck(effect: Effect, lots: Lots, t: int) -> Sequence[int]:
    """Return the targets that one effect strikes at t."""
    if effect.table is not None:
        return effect.table.get(t, ())
    if effect.kind in ("crash", "jump"):
        return effect.targets if effect.start == t else ()
    (hit,) = lots.strikes(effect, np.array([t]))
    return [target for target, yes in zip(effect.targets, hit, strict=True) if yes]


class Recount:
    """The accounts once more: instance by instance, each looked up in telemetry."""

    def __init__(self, topology: Topology, ran: Trajectory) -> None:
        self.plain, self.graph, self.rows = Plain(topology, ran), topology.graph, ran.rows
        self.faults: list[Counts] = [
            dict.fromkeys(["scheduled", "fired", "masked", "seen"], 0) for _ in topology.faults
        ]
        for effect in self.plain.effects:
            for t in range(len(ran.rows)):
                for target in struck(effect, self.plain.lots, t):
                    self.faults[effect.fault]["scheduled"] += 1
                    for fate in getattr(self, f"_{effect.kind}")(t, target):
                        self.faults[effect.fault][fate] += 1

    def absent(self, i: int, t: int) -> bool:
        return bool(t >= 0 and self.plain.absent[t, i])

    def label(self, c: int, t: int, flag: Flag) -> bool | None:
        """Return True if the node of an incidence reports that it used this input of step t; None without a report."""
        if t + 1 == len(self.rows) or self.absent(self.graph.node[c], t + 1):
            return None
        return bool(self.rows[t + 1].used[c] & flag)

    def _drop(self, t: int, c: int) -> list[str]:
        i, j = self.graph.node[c], self.graph.neighbour[c]
        if self.absent(j, t) or self.absent(i, t):
            return ["masked"]
        fired = ["fired"] if not self.rows[t].link_up[c] else []
        return fired + (["seen"] if self.label(c, t, Flag.RECEIVE) is False else [])

    _delay = _drop

    def _cut(self, t: int, e: int) -> list[str]:
        reported = {self.label(c, t, Flag.OPEN) for c, edge in enumerate(self.graph.edge) if edge == e} - {None}
        fired = ["fired"] if not self.rows[t].edge_open[e] else []
        return fired + (["seen"] if reported == {False} else [])

    def _sensor(self, t: int, i: int) -> list[str]:
        if self.absent(i, t):
            return ["masked"]
        return ["fired", "seen"] if np.isnan(self.rows[t].u[i]) else []

    def _actuator(self, t: int, i: int) -> list[str]:
        if self.absent(i, t) or i in self.plain.struck("sensor", t):
            return ["masked"]
        edges = set(self.graph.edge[self.graph.node == i])
        reports = {self.label(c, t, Flag.OPEN) for c, e in enumerate(self.graph.edge) if e in edges} - {None}
        fired = ["fired"] if np.isnan(self.rows[t].u[i]) else []
        return fired + (["seen"] if reports == {False} else [])

    def _crash(self, t: int, i: int) -> list[str]:
        if self.absent(i, t - 1):
            return ["masked"]
        gone = np.isnan(self.rows[t].u[i]) and np.isnan(self.rows[t].report[:, i]).all()
        return ["fired", "seen"] if gone else []

    def _jump(self, *_: int) -> list[str]:
        return ["fired"]


def cannot_strike(topology: Topology, ran: Trajectory) -> set[int]:
    """Return the faults, from 1, without a target at any step of the run, for any draw."""
    effects, steps = Plain(topology, ran).effects, range(topology.steps)
    able = {
        one.fault
        for one in effects
        if any(t in steps and struck_then for t, struck_then in (one.table or {}).items())
        or (one.targets and one.start < topology.steps)
    }
    return {one.fault + 1 for one in effects} - {fault + 1 for fault in able}


@settings(max_examples=examples(150))
@given(faulty())
def test_every_failure_is_accounted_for(topology: Topology) -> None:
    """For any network and schedule, the run is valid unless a fault is beyond its end, and the counts agree."""
    ran = simulate(topology)
    judged = verdict(topology, ran)
    names = ("scheduled", "fired", "masked", "seen")
    counted = [{name: entry[name] or 0 for name in names} for entry in judged.content["faults"]]
    assert counted == Recount(topology, ran).faults
    assert all(entry["fired"] + entry["masked"] == entry["scheduled"] for entry in judged.content["faults"])
    idle = cannot_strike(topology, ran)
    assert judged.verdict == ("unknown" if idle else "valid"), judged.content["reasons"]
    assert [reason.split(" (")[0] for reason in judged.content["reasons"]] == [f"fault {k}" for k in sorted(idle)]
    assert judged.content["missing_inputs"] == np.isnan(ran.u).sum()
    assert judged.content["lost_messages"] == sum(int((row.link_up == 0).sum()) for row in ran.rows)
    json.dumps(judged.content, allow_nan=False)


@settings(max_examples=examples(60))
@given(faulty(), st.data())
def test_how_telemetry_was_bundled_is_not_seen(topology: Topology, data: st.DataObject) -> None:
    ran = simulate(topology)
    whole, parts = observe(topology, ran)[0], Observer(topology)
    first = 0
    while first < len(ran.rows):
        size = data.draw(st.integers(1, 5))
        parts.take(ran.rows[first : first + size])
        first += size
    parts.finish(ran.end)
    ending = Ending("run", "in-process", 0)
    assert judge(topology, parts, ending).content == judge(topology, whole, ending).content


@settings(max_examples=examples(60))
@given(faulty(), st.data())
def test_faults_that_come_while_it_runs_are_accounted_for_alike(topology: Topology, data: st.DataObject) -> None:
    """The last faults of the list become known only when the first of them is about to begin."""
    ran = simulate(topology)
    known = data.draw(st.integers(0, len(topology.faults)))
    begins = [one.start for one in Plain(topology, ran).effects if one.fault >= known]
    row = min([*begins, len(ran.rows)])
    live = Observer(topology.model_copy(update={"faults": topology.faults[:known]}))
    if row:
        live.take(ran.rows[:row])
    live.change(topology)
    if row < len(ran.rows):
        live.take(ran.rows[row:])
    live.finish(ran.end)
    ending = Ending("run", "in-process", 0)
    assert judge(topology, live, ending).content == verdict(topology, ran, ending).content


def test_a_healed_fault_is_judged_by_its_original_schedule() -> None:
    """Endless until step 10, when it is ended at 12: 5 .. 11 were scheduled, and not a step more."""
    ended = with_faults(PAPER, [{"kind": "cut", "edge": [2, 4], "steps": [5, 12]}])
    endless = with_faults(PAPER, [{"kind": "cut", "edge": [2, 4], "steps": [5, 2**62]}])
    ran = simulate(ended)
    observer = Observer(endless)
    observer.take(ran.rows[:10])
    observer.change(ended)
    observer.take(ran.rows[10:])
    observer.finish(ran.end)
    judged = judge(ended, observer, Ending("run", "zenoh", 7))
    assert judged.verdict == "valid"
    assert [entry["scheduled"] for entry in judged.content["faults"]] == [7]


# Each mistake is reported by the name of the check and the step.

ONE_OF_EACH: list[dict[str, Any]] = [
    {"kind": "drop", "from": 2, "to": 4, "steps": [10, 14]},
    {"kind": "delay", "link": [2, 4], "by": 3, "steps": [10, 14]},
    {"kind": "cut", "edge": [2, 4], "steps": [10, 14]},
    {"kind": "partition", "groups": [[1, 2, 3, 5], [4, 6, 7]], "steps": [10, 14]},
    {"kind": "sensor", "node": 4, "steps": [10, 14]},
    {"kind": "actuator", "node": 4, "steps": [10, 14]},
    {"kind": "crash", "node": 4, "at": 10, "restart_after": 4},
]
KINDS = pytest.mark.parametrize("fault", ONE_OF_EACH, ids=lambda fault: str(fault["kind"]))


@KINDS
def test_an_unscheduled_failure_is_noticed(fault: dict[str, Any]) -> None:
    """The plant has a fault that the file has not."""
    ran = simulate(with_faults(PAPER, [fault]))
    bad = verdict(PAPER, ran)
    assert (bad.verdict, bad.exit_code) == ("INVALID", 1)
    assert "faults fails at step 10" in bad.content["reasons"]
    assert bad.content["checks"]["links"]["ok"] == (fault["kind"] != "crash"), "each present node reports its inputs"


@KINDS
def test_a_fault_that_does_not_fire_is_noticed(fault: dict[str, Any]) -> None:
    """The file has a fault, and the plant forgets it."""
    bad = verdict(with_faults(PAPER, [fault]), simulate(PAPER))
    assert bad.content["reasons"] == ["faults fails at step 10"]
    (entry,) = bad.content["faults"]
    assert (entry["fired"], entry["seen"]) == (0, 0)
    assert entry["scheduled"] > 0


def test_a_jump_that_did_not_come_is_noticed() -> None:
    """Equation (1) is checked under the a that should hold."""
    other = next(a for a in _listed(PAPER.nodes[4]) if a != PAPER.nodes[4].a)
    jumps = with_faults(PAPER, [{"kind": "jump", "node": 4, "at": 9, "a": other}])
    for topology, ran in ((jumps, simulate(PAPER)), (PAPER, simulate(jumps))):
        check = verdict(topology, ran).content["checks"]["dynamics"]
        assert (check["ok"], check["step"]) == (False, 9)
    right = verdict(jumps, simulate(jumps))
    assert right.verdict == "valid"
    (entry,) = right.content["faults"]
    assert (entry["scheduled"], entry["fired"], entry["seen"]) == (1, 1, None)


def changed(ran: Trajectory, step: int, column: str, place: Any, value: Any) -> Trajectory:
    """The run with one number of its telemetry replaced."""
    rows = list(ran.rows)
    values = getattr(rows[step], column).copy()
    values[place] = value
    rows[step] = rows[step]._replace(**{column: values})
    return Trajectory(rows, ran.end)


def test_flow_without_an_input_is_noticed() -> None:
    """An edge is open, although one of its ends sent nothing."""
    topology = with_faults(PAPER, [{"kind": "sensor", "node": 4, "steps": [10, 14]}])
    edge = int(PAPER.graph.edge[PAPER.graph.node == 3][0])
    bad = verdict(topology, changed(simulate(topology), 12, "edge_open", edge, 1))
    assert bad.verdict == "INVALID"
    assert "missing_inputs fails at step 12" in bad.content["reasons"]


def test_an_input_that_is_missing_alone_is_noticed() -> None:
    bad = verdict(PAPER, changed(simulate(PAPER), 12, "u", 3, np.nan))
    assert {"missing_inputs fails at step 12", "faults fails at step 12"} <= {*bad.content["reasons"]}
    assert bad.content["missing_inputs"] == 1
    assert ", 1 missing input, " in bad.line()


@settings(max_examples=examples(60))
@given(faulty(), st.data())
def test_a_wrong_bit_is_noticed(topology: Topology, data: st.DataObject) -> None:
    """The bit is at any step and reporting node: it claims a message that was not delivered, or hides one; likewise for
    edges.
    """
    ran, graph = simulate(topology), topology.graph
    absent = Plain(topology, ran).absent
    telling = [(t, c) for t in range(1, len(ran.rows)) for c, i in enumerate(graph.node) if not absent[t, i]]
    if not telling:
        return
    step, c = data.draw(st.sampled_from(telling))
    flag = data.draw(st.sampled_from([Flag.OPEN, Flag.RECEIVE]))
    bad = verdict(topology, changed(ran, step, "used", c, ran.rows[step].used[c] ^ flag))
    assert bad.verdict == "INVALID"
    assert f"links fails at step {step - 1}" in bad.content["reasons"]


def test_a_drop_that_its_receiver_did_not_notice_is_noticed() -> None:
    topology = with_faults(PAPER, [{"kind": "drop", "from": 2, "to": 4, "steps": [10, 14]}])
    ran, graph = simulate(topology), PAPER.graph
    (c,) = np.flatnonzero((graph.node == 3) & (graph.neighbour == 1))
    bad = verdict(topology, changed(ran, 13, "used", c, Flag.OPEN | Flag.RECEIVE))
    assert bad.content["reasons"] == ["links fails at step 12", "faults fails at step 12"]
    (entry,) = bad.content["faults"]
    assert (entry["scheduled"], entry["fired"], entry["masked"], entry["seen"]) == (4, 4, 0, 3)


def test_one_that_should_be_dead_and_reports_is_noticed() -> None:
    topology = with_faults(PAPER, [{"kind": "crash", "node": 4, "at": 10, "restart_after": 4}])
    bad = verdict(topology, changed(simulate(topology), 12, "report", (0, 3), 0.5))
    assert bad.content["reasons"] == ["faults fails at step 12"]


# Impossible faults.


@pytest.mark.parametrize(
    ("fault", "why"),
    [
        ({"kind": "drop", "link": [2, 4], "steps": [100, 200]}, "the run has 30 steps"),
        ({"kind": "drop", "link": [2, 4], "steps": [30, 31], "probability": 0.1}, "the run has 30 steps"),
        ({"kind": "cut", "at": {40: [[2, 4]]}}, "the run has 30 steps"),
        ({"kind": "crash", "node": 4, "at": 30}, "the run has 30 steps"),
        ({"kind": "drop", "at": {10: []}}, "there is nothing that it strikes"),
        ({"kind": "partition", "groups": [[1], [7]]}, "there is nothing that it strikes"),
    ],
)
def test_a_fault_that_cannot_fire_makes_the_verdict_unknown(fault: dict[str, Any], why: str) -> None:
    topology = with_faults(PAPER, [ONE_OF_EACH[0], fault])
    unsure = verdict(topology, simulate(topology))
    assert (unsure.verdict, unsure.exit_code) == ("unknown", 3)
    (reason,) = unsure.content["reasons"]
    assert reason.startswith(f"fault 2 ({fault['kind']} ")
    assert reason.endswith(f") could not fire: {why}")


@pytest.mark.parametrize(
    ("fault", "scheduled", "beyond"),
    [
        ({"kind": "drop", "link": [2, 4], "steps": [25, 40]}, 10, 20),
        ({"kind": "drop", "link": [2, 4]}, 60, 0),
        ({"kind": "cut", "at": {3: [[2, 4]], 30: [[1, 2], [2, 4]]}}, 1, 2),
        ({"kind": "sensor", "node": 4, "steps": [0, 10], "probability": 0}, 0, 0),
        ({"kind": "crash", "node": 4, "at": 29}, 1, 0),
    ],
)
def test_instances_beyond_the_end_are_counted(fault: dict[str, Any], scheduled: int, beyond: int) -> None:
    """A fault with a step within the run, and one that might have drawn none, leave no doubt."""
    topology = with_faults(PAPER, [fault])
    judged = verdict(topology, simulate(topology))
    assert judged.verdict == "valid"
    (entry,) = judged.content["faults"]
    assert (entry["scheduled"], entry["fired"], entry["beyond"]) == (scheduled, scheduled, beyond)


def test_an_agent_that_stays_down_makes_the_verdict_unknown() -> None:
    ending = Ending("run", "zenoh", 7, restarts=5, down=["agent-4 was killed by SIGSEGV"])
    topology = with_faults(PAPER, [{"kind": "crash", "node": 4, "at": 10}])
    unsure = verdict(topology, simulate(topology), ending)
    assert unsure.exit_code == 3
    assert unsure.content["reasons"] == ["stayed down: agent-4 was killed by SIGSEGV"]
    assert (unsure.content["restarts"], unsure.content["down"]) == (5, ending.down)
    assert ", 5 restarts, 20 missing inputs, " in unsure.line()


# Metrics go by the a that holds.


def _listed(own: Node) -> tuple[float, ...]:
    assert isinstance(own.candidates, tuple)
    return own.candidates


@st.composite
def jumping(draw: st.DrawFn) -> Topology:
    """Return a network with jumps of the truth, under cuts and other faults."""
    topology = draw(networks(most=4, steps=12))
    jumps = [
        {"kind": "jump", "node": node, "at": draw(st.integers(0, 12)), "a": draw(st.sampled_from(_listed(own)))}
        for node, own in topology.nodes.items()
        for _ in range(draw(st.integers(0, 2)))
    ]
    return with_faults(topology, draw(st.permutations([*jumps, *draw(schedules(topology, most=2))])))


@settings(max_examples=examples(60))
@given(jumping())
def test_truth_twins_and_least_squares_go_by_the_a_that_holds(topology: Topology) -> None:
    ran, graph, b = simulate(topology), topology.graph, topology.network.b
    observer, batch = observe(topology, ran)
    effects = Plain(topology, ran).effects
    a, x_oracle = truth(topology), ran.x[0].copy()
    x_nominal, sxx, sxy = x_oracle.copy(), np.zeros(graph.n), np.zeros(graph.n)
    certified = True
    for t, row in enumerate(ran.rows):
        for one in effects:
            if one.kind == "jump" and one.start == t:
                a[one.targets[0]], certified = one.a, False
        certified = certified and bool(row.edge_open.all())
        assert batch.a[t].tolist() == a.tolist()
        assert batch.right[t] == (row.report[0] == a).sum()
        assert batch.x_oracle[t].tolist() == x_oracle.tolist()
        assert batch.x_nominal[t].tolist() == x_nominal.tolist()
        assert certified == (not np.isnan(batch.slack[t]))
        known = sxx > 0
        np.testing.assert_allclose(batch.a_ls[t, known], sxy[known] / sxx[known], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(batch.beta[t, known], sxy[known] / sxx[known] - a[known], rtol=1e-9, atol=1e-9)
        sxx, sxy = sxx + row.x**2, sxy + row.x * (a * row.x + row.w)
        on = row.edge_open.view(np.bool_)
        x_oracle = dynamics(a, b, graph, x_oracle, control(b, x_oracle, a), row.w, on)
        x_nominal = dynamics(a, b, graph, x_nominal, control(b, x_nominal, observer.nominal), row.w, on)
    assert observer.x_oracle_end.tolist() == x_oracle.tolist()
    claimed = judge(topology, observer, Ending("run", "in-process", 0)).content["checks"]["oracle_certificate"]
    assert (claimed["ok"], claimed["steps"]) == (True, int((~np.isnan(batch.slack)).sum()))


def test_the_contraction_is_that_of_the_a_that_holds() -> None:
    """rho is .6 with a = .3, and .9 from step 5 on: a contraction of .7 violates it at step 2, but not at step 7."""
    topology = read(
        "{name: one, b: 0.1, steps: 9, nodes: {1: {a: 0.3, candidates: [0.3, 0.9], x0: 1}},"
        " faults: [{kind: jump, node: 1, at: 5, a: 0.9}]}"
    )
    ran = simulate(topology)
    for step in (2, 7):
        bad = verdict(topology, changed(ran, step + 1, "x", 0, 0.7 * ran.x[step, 0]))
        assert (f"contraction fails at step {step}" in bad.content["reasons"]) == (step == 2)
    assert bad.content["metrics"]["rho"] == 0.9


# The files of a run.


def test_a_faulty_run_leaves_nulls_where_there_was_nothing(tmp_path: Path) -> None:
    """u, ahat and index of absent nodes, u of nodes without a reading, and the delivered rows at both ends."""
    faults = [
        {"kind": "crash", "node": 4, "at": 10, "restart_after": 4},
        {"kind": "sensor", "node": 1, "steps": [20, 22]},
        {"kind": "drop", "from": 2, "to": 3, "steps": [25, 26]},
    ]
    topology = with_faults(PAPER, faults)
    folder = create(topology, tmp_path / "run")
    judged = simulate_into(topology, folder, [range(7)], Watching(record=True), Quiet())
    assert judged.verdict == "valid"
    assert judged.content == json.loads(folder.verdict.read_text())

    rows = pq.read_table(folder.path / "telemetry.parquet").to_pylist()
    acted = [row for row in rows if row["step"] < 30]
    gone = {(t, 4) for t in range(10, 14)}
    assert {(row["step"], row["node"]) for row in acted if row["ahat"] is None} == gone
    assert {(row["step"], row["node"]) for row in acted if row["index"] is None} == gone
    assert {(row["step"], row["node"]) for row in acted if row["u"] is None} == gone | {(20, 1), (21, 1)}
    assert all(row["x"] is not None for row in rows)

    edges = pq.read_table(folder.path / "edges.parquet").to_pylist()
    closed = {(row["step"], row["i"], row["j"]) for row in edges if not row["open"]}
    assert closed == {(t, *edge) for t in range(10, 14) for edge in PAPER.pairs if 4 in edge} | {
        (t, *edge) for t in (20, 21) for edge in PAPER.pairs if 1 in edge
    }
    lost = {(row["step"], row["j"], row["i"]) for row in edges if not row["i_hears"]}
    lost |= {(row["step"], row["i"], row["j"]) for row in edges if not row["j_hears"]}
    near = {end for edge in PAPER.pairs if 4 in edge for end in edge} - {4}
    from_4, to_4 = {(t, 4, j) for t in range(10, 14) for j in near}, {(t, j, 4) for t in range(10, 14) for j in near}
    assert lost == {(25, 2, 3)} | from_4 | to_4

    reports = [json.loads(line) for line in folder.events.read_text().splitlines()]
    assert [(one["fault"], one["entry"]["kind"]) for one in reports if one["event"] == "fault"] == [
        (1, "crash"), (2, "sensor"), (3, "drop"),
    ]  # fmt: skip


def test_a_changed_run_can_be_run_again_from_its_folder(tmp_path: Path) -> None:
    later = with_faults(PAPER, ONE_OF_EACH[:2])
    folder = create(PAPER, tmp_path / "run")
    run = Recording(PAPER, folder, Watching(record=True), Ending("run", "zenoh", 7))
    run.note("before the first step", "INFO", 0)
    ran = simulate(later)
    run.take(ran.rows[:5])
    run.change(later)
    run.note("two faults more", "WARN", 5)
    run.take(ran.rows[5:])
    run.finish(ran.end)
    assert run.close().verdict == "valid"
    written = resolve(parse(folder.topology.read_bytes(), "topology.yaml", folder.path))
    assert written.faults == later.faults
    assert simulate(written).same_bits(ran)
    assert not list(folder.path.glob("*.part"))
