"""Faults that end exactly with the run: no process waits for a step that never happens."""

from __future__ import annotations

import signal
import tempfile
from pathlib import Path

import pytest

from hedgerow.orchestrator.launch.comparison import compare, first_difference
from hedgerow.orchestrator.launch.recording import Recording
from hedgerow.orchestrator.launch.watching import Watching
from hedgerow.orchestrator.metrics.verdict import Ending
from hedgerow.orchestrator.runs.folder import create
from hedgerow.orchestrator.runs.reader import load_run
from hedgerow.orchestrator.testing.scenario import Networks
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from tests.tools.networks import simulate
from tests.tools.processes import Orchestrator, orchestrator, parquet_bytes
from tests.tools.verdicts import verdict_of

UP = ("--viewer", "none", "--no-record", "--verify")


@pytest.mark.parametrize(
    "faults",
    [
        "{kind: crash, node: 3, at: 29, restart_after: 1}",
        "{kind: crash, node: 3, at: 28, restart_after: 2}",
        "{kind: crash, node: 3, at: 29}",
        "{kind: crash, node: 3, at: 28, restart_after: 1}",
        "{kind: crash, node: 3, at: 0, restart_after: 30}",
        "{kind: drop, link: [2, 4], steps: [29, 30]}, {kind: crash, node: 4, at: 29, restart_after: 1}",
    ],
)
def test_a_fault_that_ends_with_the_run_is_valid_and_equal_to_the_reference(here: Path, faults: str) -> None:
    done = orchestrator("up", "paper7", *UP, "--set", f"faults=[{faults}]")
    assert done.returncode == 0, done.stdout + done.stderr
    assert verdict_of()["steps_done"] == 30
    assert verdict_of()["checks"]["reference"]["ok"]


def test_a_signal_while_the_reference_is_computed_is_no_verdict_on_the_run(
    here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (here / "t").mkdir()
    monkeypatch.setenv("TMPDIR", str(here / "t"))
    with Orchestrator("up", "paper7", *UP, "--steps", "3000", "--processes", "1") as network:
        network.wait_until(lambda: any((here / "t").glob("hedgerow-*/reference/telemetry.*")))
        network.send(signal.SIGINT)
        assert network.wait() == 3, network.output
    assert verdict_of()["verdict"] == "unknown"
    assert verdict_of()["steps_done"] == 3000
    assert "reference" not in verdict_of()["checks"]
    assert not list((here / "t").iterdir())


def test_a_comparison_that_cannot_be_made_is_none(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    topology = resolve(load("paper7"))
    run = Recording(topology, create(topology, Path("run")), Watching(record=False), Ending("run", "zenoh", 7))
    monkeypatch.setattr(tempfile, "tempdir", str(here / "gone"))
    assert compare(run).equal is None


def test_the_first_value_that_differs_is_named(here: Path) -> None:
    for name, x0 in (("one", "1"), ("other", "2")):
        setting = f"nodes.3.x0={x0}"
        assert orchestrator("simulate", "paper7", "--no-record", "--run-dir", name, "--set", setting).returncode == 0
    difference = first_difference(Path("one"), Path("other"))
    assert difference is not None
    assert (difference.step, difference.node, difference.column) == (0, "3", "x")
    assert (difference.value, difference.reference) == (1.0, 2.0)
    assert first_difference(Path("one"), Path("one")) is None


@pytest.mark.parametrize("order", [(0, 1, 1, 2), (0, 1, 2, 0), (0, 0, 1, 2)])
def test_a_row_that_comes_twice_is_refused(tmp_path: Path, order: tuple[int, ...]) -> None:
    topology = resolve(load("paper7", ["steps=3"]))
    ran = simulate(topology)
    tables = []
    for name, steps in (("once", (0, 1, 2)), ("twice", order)):
        folder = create(topology, tmp_path / name)
        run = Recording(topology, folder, Watching(record=False), Ending(name, "zenoh", 7))
        for step in steps:
            run.take([ran.rows[step]])
        run.finish(ran.end)
        judged = run.close()
        assert judged.verdict == "valid"
        assert judged.content["refused_rows"] == 7 * (len(steps) - 3)
        tables.append(parquet_bytes(folder.path))
    assert tables[0] == tables[1]


def test_rows_in_another_order_are_no_valid_run(tmp_path: Path) -> None:
    topology = resolve(load("paper7", ["steps=3"]))
    ran = simulate(topology)
    run = Recording(topology, create(topology, tmp_path / "run"), Watching(record=False), Ending("run", "zenoh", 7))
    run.take([ran.rows[0], ran.rows[2], ran.rows[1]])
    run.finish(ran.end)
    assert run.close().verdict == "unknown"


def test_a_plant_that_is_killed_in_the_fixture_leaves_a_result(network: Networks) -> None:
    with network("paper7").up(rate=50, steps=1000) as net:
        net.wait_for_step(5)
        net.kill("plant")
        result = net.stop()
    assert result.verdict.verdict == "unknown"
    assert "SIGKILL" in " ".join(result.verdict.content["reasons"])
    # The last step has no state after it: the plant was killed before it could send one.
    assert result.steps == result.verdict.content["steps_done"] - 1
    assert result.x.shape == (result.steps + 1, 7)


def test_ctrl_c_after_the_last_step_changes_nothing(here: Path) -> None:
    with Orchestrator("up", "paper7", "--viewer", "none", "--no-record", "--steps", "40") as network:
        network.wait_until(lambda: last_step_is_recorded(39))
        network.send(signal.SIGINT)
        assert network.wait() == 0, network.output
    assert verdict_of()["steps_done"] == 40


def last_step_is_recorded(step: int) -> bool:
    log = Path("runs/latest/logs/plant.log")
    return log.exists() and f"end at step {step + 1}" in log.read_text(encoding="utf-8")


def test_steps_recorded_before_a_full_disk_can_be_exported(here: Path) -> None:
    """The first rows arrive together: rows that do not fit must not affect the others."""
    full = orchestrator("simulate", "paper7", "--steps", "3000", "--no-record", largest=150_000)
    assert full.returncode == 3, full.stdout + full.stderr
    assert verdict_of()["verdict"] == "unknown"
    done = orchestrator("export", "runs/latest", "--to", "csv", "--out", "tables")
    assert done.returncode == 0, done.stderr
    assert load_run("runs/latest").T >= 64
