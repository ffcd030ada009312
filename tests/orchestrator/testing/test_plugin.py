"""The fixture `network` in pytest: scenarios, results and explanations."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hedgerow.orchestrator.runs.reader import load_run
from hedgerow.orchestrator.testing import Networks, Run
from hedgerow.orchestrator.testing.explanation import explain
from hedgerow.topologies.errors import Code
from hedgerow.topologies.faults import Drop
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from tests.tools.refusals import refusal

pytest_plugins = ["pytester"]

ALONE = ("-p", "no:cacheprovider", "-p", "no:hypothesispytest")
"""The options of a pytest in a separate process, without slow and unrelated plugins."""
PAIR = "{name: pair, b: 0.1, steps: 4, defaults: {x0: 5}, nodes: {1: {}, two: {x0: 1}}, edges: [[two, 1]]}"


def test_a_dropped_link_costs_no_estimate(network: Networks) -> None:
    faultless = network("paper7").run()
    run = network("paper7").drop((2, 4), steps=range(10)).run()
    assert run.estimates_at(9) != faultless.estimates_at(9)
    assert run.estimates_at(29) == faultless.estimates_at(29)


def test_a_scenario_never_changes(network: Networks) -> None:
    """Tests may share one: each method returns another."""
    plain = network("paper7")
    dropped = plain.drop((2, 4))
    assert (len(plain.topology.faults), len(dropped.topology.faults)) == (0, 1)
    assert plain.set("steps=5").topology.steps == 5
    assert plain.topology.steps == 30
    assert dropped.cut((2, 4)).topology.faults[0] == dropped.topology.faults[0]
    assert plain == network("paper7")


def test_every_method_equals_an_entry_of_a_file(network: Networks) -> None:
    """The faults of the file come first, in its order, and added ones after them."""
    file = [{"kind": "sensor", "node": 1, "steps": [0, 1]}]
    scenario = (
        network("paper7", "nodes.4={a: 0.6, candidates: [0.3, 0.6]}", f"faults={json.dumps(file)}")
        .drop((2, 4), steps=range(10, 20), probability=0.5)
        .drop((2, 4), one_way=True)
        .drop(at={10: [(2, 4), (3, 5)]})
        .delay((4, 2), by=3, steps=(0, 9), one_way=True)
        .cut((2, 4), steps=range(3))
        .cut(at={3: [(2, 4)]})
        .partition([1, 2, 3, 5], [4, 6, 7], cut=True)
        .sensor(3, steps=(5, 9))
        .actuator(3, probability=0.25)
        .crash(4, at=12, restart_after=5)
        .crash(process=2, at=12)
        .jump(4, at=15, to=0.3)
        .inject({"kind": "drop", "at": {np.int64(3): [(np.int64(6), 4)]}})
        .inject(Drop(link=(7, 4)))
    )
    faults = scenario.topology.faults
    assert [fault.model_dump(mode="json", by_alias=True, exclude_defaults=True) for fault in faults] == [
        {"node": 1, "steps": [0, 1]},
        {"link": [2, 4], "steps": [10, 20], "probability": 0.5},
        {"from": 2, "to": 4},
        {"at": {"10": [[2, 4], [3, 5]]}},
        {"from": 4, "to": 2, "by": 3, "steps": [0, 9]},
        {"edge": [2, 4], "steps": [0, 3]},
        {"at": {"3": [[2, 4]]}},
        {"groups": [[1, 2, 3, 5], [4, 6, 7]], "cut": True},
        {"node": 3, "steps": [5, 9]},
        {"node": 3, "probability": 0.25},
        {"node": 4, "at": 12, "restart_after": 5},
        {"process": 2, "at": 12},
        {"node": 4, "at": 15, "a": 0.3},
        {"at": {"3": [[6, 4]]}},
        {"link": [7, 4]},
    ]  # fmt: skip
    assert [fault.kind for fault in faults] == [
        "sensor", "drop", "drop", "drop", "delay", "cut", "cut", "partition",
        "sensor", "actuator", "crash", "crash", "jump", "drop", "drop",
    ]  # fmt: skip


def test_a_network_is_a_name_a_file_a_folder_a_topology_or_text(network: Networks, tmp_path: Path) -> None:
    file = tmp_path / "pair.yaml"
    file.write_text(PAIR)
    wanted = network(file).run()
    assert wanted.ids == (1, "two")
    for same in (str(file), PAIR, resolve(load(str(file))), load(str(file)), wanted.folder, str(wanted.folder)):
        assert network(same).run() == wanted
    assert network(file, "steps=2", "defaults.x0=3").run().x[0].tolist() == [3.0, 1.0]
    with refusal(Code.FILE_MISSING):
        network("papr7")


def test_samples_lie_beside_the_file(network: Networks, tmp_path: Path) -> None:
    (tmp_path / "w.csv").write_text("1,two\n" + "0.5,-0.5\n" * 4)
    settings = "defaults.disturbance={kind: samples, file: w.csv}"
    (tmp_path / "pair.yaml").write_text(PAIR)
    assert network(tmp_path / "pair.yaml", settings).run().w.tolist() == [[0.5, -0.5]] * 4


def test_a_mistake_is_shown_where_it_is_made(network: Networks) -> None:
    """Not when the scenario runs: each call below is the wrong one."""
    right = network("paper7")
    for wrong, code, at in (
        (lambda: right.drop((2, 5)), Code.FAULT, "drop: link"),
        (lambda: right.drop((2, 4), steps=range(0, 10, 2)), Code.FAULT, "steps=range(0, 10, 2)"),
        (lambda: right.drop((2, 4), at={3: [(2, 4)]}), Code.FAULT, "drop"),
        (lambda: right.crash(9, at=3), Code.FAULT, "crash: node"),
        (lambda: right.crash(process=7, at=3), Code.FAULT, "crash: process"),
        (lambda: right.jump(4, to=0.123456), Code.FAULT, "jump: to"),
        (
            lambda: right.run(engine="zeno"),  # type: ignore[arg-type]
            Code.OPTION,
            "engine='zeno'",
        ),
    ):
        with refusal(code, at):
            wrong()
    with refusal(Code.TOPOLOGY):
        right.set("stepz=3")


def test_a_result_has_the_arrays_of_the_run(network: Networks) -> None:
    run = network("paper7").run(steps=12, seed=5)
    assert run.steps == run.topology.steps == 12
    assert run.topology.seed == 5
    assert run.x.shape == run.regret.shape == (13, 7)
    assert run.u.shape == run.w.shape == run.ahat.shape == run.index.shape == (12, 7)
    assert run.x[0].tolist() == [15.0] * 7
    candidates = run.topology.nodes[3].candidates
    assert isinstance(candidates, tuple)
    assert run.ahat[5, run.column(3)] == candidates[run.index[5, run.column(3)]] == run.estimates_at(5)[3]
    assert run.verdict.verdict == "valid"
    assert (run.regret**2).sum() == pytest.approx(run.verdict.content["metrics"]["regret"])
    assert [event["event"] for event in run.events] == ["start", "verdict"]
    assert (run.folder / "telemetry.parquet").exists()
    with refusal(Code.OPTION):
        run.column(8)
    with refusal(Code.OPTION):
        run.estimates_at(12)


def test_missed_messages_and_closed_edges(network: Networks) -> None:
    run = network("paper7").delay((2, 4), by=2, steps=(3, 5), one_way=True).cut((4, 2), steps=(8, 10)).run(steps=12)
    assert run.missing((2, 4)) == [3, 4]
    assert run.missing((4, 2)) == run.missing((1, 2)) == []
    assert run.open((2, 4)) == run.open((4, 2)) == [*range(8), 10, 11]
    assert run.open((1, 2)) == [*range(12)]
    for ask in (run.missing, run.open):
        with refusal(Code.OPTION):
            ask((1, 7))


def test_a_network_without_edges_has_nothing_to_miss(network: Networks) -> None:
    run = network("{name: one, b: 0.1, steps: 3, nodes: [1]}").run()
    assert run.received.shape == run.edge_open.shape == (3, 0)


def test_an_absent_node_has_no_estimate_and_no_input(network: Networks) -> None:
    run = network("paper7").crash(4, at=3, restart_after=2).run(steps=8)
    assert [run.estimates_at(t)[4] is None for t in range(8)] == [False] * 3 + [True] * 2 + [False] * 3
    assert np.flatnonzero(np.isnan(run.u[:, run.column(4)])).tolist() == [3, 4]
    assert run.index[3, run.column(4)] == -1
    assert run == network("paper7").crash(4, at=3, restart_after=2).run(steps=8), "NaN equals NaN here"


def test_two_runs_are_equal_to_the_last_bit(network: Networks) -> None:
    run, other = (network("paper7").run(seed=seed) for seed in (1, 1))
    assert run == other
    almost = load_run(run.folder)
    almost.__dict__["x"] = run.x.copy()
    almost.x[30, 6] = np.nextafter(almost.x[30, 6], np.inf)
    assert run != almost
    assert not run.x.flags.writeable
    assert run != network("paper7").run(seed=2)
    assert run != network("paper7").run(steps=29)
    assert run != "a run"


@pytest.fixture(scope="module")
def apart(network: Networks) -> tuple[Run, Run]:
    """Two runs that diverge; the first has no back-filling."""
    forgetful = network("paper7", "backfill=false")
    return forgetful.drop((2, 4), steps=range(25)).run(), forgetful.run()


def test_a_difference_is_explained(apart: tuple[Run, Run]) -> None:
    """Which node, which step first, and which messages were lost until then."""
    one, other = apart
    explained = explain(one.estimates_at(5), other.estimates_at(5))
    assert explained is not None
    assert explained[0].startswith("estimates at step 5 differ: node 2: ")
    assert explained[1].startswith("first at step 1: ahat of node 2 ")
    assert explained[2:4] == [
        "left, until then: fault 1: drop 2-4 from step 0 to 25; messages lost or late: 4->2 at 0-1, 2->4 at 0-1",
        "right, until then: no message lost or late",
    ]
    assert explain(one, other) == ["runs differ", *explained[1:]]
    assert explain(one, {"a": 1}) is None
    with pytest.raises(AssertionError):
        one.assert_same_estimates(other)
    one.assert_same_estimates(other, 0)


def test_a_failing_test_shows_the_reason_and_the_folder(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        """
        def test_estimates(network):
            run = network("paper7", "backfill=false").drop((2, 4), steps=range(25)).run()
            assert run.estimates_at(5) == network("paper7").run().estimates_at(5)

        def test_runs(network):
            assert network("paper7").cut((2, 4), steps=(3, 9)).run() == network("paper7").run()

        def test_mistake(network):
            network("paper7").drop((2, 5))

        def test_without_a_run(network):
            assert not network("paper7")
        """
    )
    ran = pytester.runpytest_subprocess("-q", *ALONE)
    ran.assert_outcomes(failed=4)
    ran.stdout.fnmatch_lines(
        [
            "E       assert estimates at step 5 differ: node 2: *",
            "E         first at step 1: ahat of node 2 *",
            "E         left, until then: fault 1: drop 2-4 from step 0 to 25; messages lost or late: 4->2 at 0-1, *",
            "* networks *",
            "  fault 1: drop 2-4 from step 0 to 25",
            "  valid: 30 of 30 steps*",
            "E       assert runs differ",
            "E         first at step 4: x of node 2 * != *; x of node 4 *",
            "E         left, until then: fault 1: cut 2-4 from step 3 to 9; no message lost or late",
            "  fault 1: cut 2-4 from step 3 to 9",
            ">       network(\"paper7\").drop((2, 5))",
            "E       hedgerow.topologies.errors.UserError: drop: link: 2 and 5 are not neighbours; *",
        ]
    )  # fmt: skip
    assert "def inject" not in ran.stdout.str(), "frames of ours in a mistake of the test's"
    assert str(ran.stdout).count("networks") == 2


def test_the_plugin_is_light(tmp_path: Path) -> None:
    """A test session without networks loads only the plugin."""
    code = "import sys, hedgerow.orchestrator.testing.pytest_plugin; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    heavy = {"numpy", "pyarrow", "zenoh", "rerun", "scipy", "pydantic", "hedgerow.topologies"}
    assert "hedgerow.orchestrator.testing.pytest_plugin" in loaded
    assert not heavy & {*loaded}
