"""The replay agrees with every run that equals its file, and names the first node and step of any other."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hedgerow.orchestrator.launch.simulation import simulate as recorded
from hedgerow.orchestrator.metrics.replay import Replay
from hedgerow.topologies.effects import FOREVER
from hedgerow.topologies.faults import effects
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from hedgerow.topologies.schema import Topology
from hedgerow.wire.message import Telemetry
from tests.tools.examples import examples
from tests.tools.networks import Trajectory, networks, partitions, read, simulate
from tests.tools.schedules import schedules, with_faults

FAULTS = [{"kind": "crash", "node": 3, "at": 6, "restart_after": 4}, {"kind": "drop", "link": [2, 4], "steps": [3, 20]}]


@st.composite
def faulty(draw: st.DrawFn) -> Topology:
    """Any network under any faults, with a history that is too short for some of them, or none."""
    topology = draw(networks())
    more: dict[str, Any] = draw(st.sampled_from([{}, {"history": 3}, {"backfill": False}]))
    return with_faults(topology, draw(schedules(topology)), **more)


def replay(topology: Topology, rows: Sequence[Telemetry], audited: int = 10**9) -> Replay:
    replayed = Replay(topology, audited)
    replayed.take(rows)
    return replayed


def assert_agrees(replayed: Replay, ran: Trajectory) -> None:
    assert replayed.finding is None
    assert (replayed.doubt, replayed.steps) == ("", len(ran.rows))


@settings(max_examples=examples(150), deadline=None)
@given(faulty(), st.data())
def test_a_run_that_equals_its_file_agrees_with_its_replay(topology: Topology, data: st.DataObject) -> None:
    """Any network, any faults, any layout over processes, and with any number of replayed nodes."""
    ran = simulate(topology, data.draw(partitions(topology.graph.n)))
    assert_agrees(replay(topology, ran.rows), ran)
    some = data.draw(st.integers(1, topology.graph.n))
    part = replay(topology, ran.rows, some)
    assert part.nodes == some
    assert_agrees(part, ran)


@settings(max_examples=examples(60), deadline=None)
@given(faulty(), st.data())
def test_faults_that_come_while_it_runs_are_replayed_alike(topology: Topology, data: st.DataObject) -> None:
    """The last faults of the list become known only when the first of them is about to begin."""
    check_late_faults(topology, known=data.draw(st.integers(0, len(topology.faults))))


def test_a_cut_that_comes_while_messages_are_lost_is_replayed_alike() -> None:
    """The links of many steps are known ahead then, until the cut is known."""
    faults = "[{kind: drop, link: [1, 2], probability: 0.5}, {kind: cut, edge: [2, 4], steps: [10, 20]}]"
    check_late_faults(resolve(load("paper7", [f"faults={faults}"])), known=1)


def check_late_faults(topology: Topology, known: int) -> None:
    ran = simulate(topology)
    begins = [one.start for one in effects(topology.faults, topology) if one.fault >= known]
    row = min([*begins, len(ran.rows)])
    live = Replay(topology.model_copy(update={"faults": topology.faults[:known]}))
    live.take(ran.rows[:row])
    live.change(topology)
    live.take(ran.rows[row:])
    assert_agrees(live, ran)


@settings(max_examples=examples(100), deadline=None)
@given(faulty(), st.data())
def test_any_one_number_that_is_an_ulp_off_is_found(topology: Topology, data: st.DataObject) -> None:
    """The change is in w, u, ahat or margin; the step and the node are named."""
    ran = simulate(topology)
    t = data.draw(st.integers(0, len(ran.rows) - 1))
    node = data.draw(st.integers(0, topology.graph.n - 1))
    name = data.draw(st.sampled_from(["w", "u", "ahat", "margin"]))
    rows = list(ran.rows)
    field, place = (name, node) if name in ("w", "u") else ("report", (("ahat", "margin").index(name), node))
    values = getattr(rows[t], field).copy()
    values[place] = np.nextafter(values[place], -np.inf)
    rows[t] = rows[t]._replace(**{field: values})
    finding = replay(topology, rows).finding
    if np.isnan(values[place]):
        assert finding is None
        return
    assert finding is not None
    assert (finding.step, finding.node) == (t, topology.ids[node])
    assert finding.check == ("plan" if name == "w" else "law")


def test_a_crash_without_an_end_that_ends_while_it_runs() -> None:
    """A process is lost at step 3, and back at 6: its fault has an end only from then on."""
    topology = read("{name: four, b: 0.1, steps: 12, seed: 3, nodes: [1, 2, 3, 4], edges: [[1, 2], [2, 3], [3, 4]]}")
    topology = topology.model_copy()
    ended = with_faults(topology, [{"kind": "crash", "node": 2, "at": 3, "restart_after": 3}])
    endless = with_faults(topology, [{"kind": "crash", "node": 2, "at": 3}])
    assert effects(endless.faults, endless)[0].stop == FOREVER
    ran = simulate(ended)
    live = Replay(topology)
    for first, stop, then in ((0, 2, endless), (2, 5, ended), (5, 12, ended)):
        live.take(ran.rows[first:stop])
        live.change(then)
    assert_agrees(live, ran)


def test_the_tables_of_a_run_are_replayed(here: Path) -> None:
    """A recorded run agrees with its replay; one changed number is found."""
    run = recorded("paper7", f"faults={json.dumps(FAULTS)}")
    assert run.first_difference() is None
    u = run.u.copy()
    u[11, 4] *= 2
    run.__dict__["u"] = u
    finding = run.first_difference()
    assert finding is not None
    assert (finding.check, finding.step, finding.node) == ("law", 11, 5)


@pytest.mark.parametrize("lost", [0, 5])
def test_nothing_is_claimed_from_a_lost_row_on(lost: int) -> None:
    topology = read("{name: pair, b: 0.1, steps: 9, seed: 3, nodes: [1, 2], edges: [[1, 2]]}")
    ran = simulate(topology)
    replayed = replay(topology, [row for row in ran.rows if row.t != lost])
    assert replayed.finding is None
    assert (replayed.steps, bool(replayed.doubt)) == (lost, True)


def test_a_run_without_its_replay_is_unknown(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The replay is impossible: there are no claims and no failures."""

    def no_room(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr(Replay, "change", no_room)
    run = recorded("paper7")
    assert (run.verdict.verdict, run.verdict.exit_code) == ("unknown", 3)
    assert "law" not in run.verdict.content["checks"]
