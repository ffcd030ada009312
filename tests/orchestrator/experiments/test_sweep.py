"""Many runs of one network give one table, the same for any number of processes and interruptions."""

from __future__ import annotations

import contextlib
import csv
import errno
import json
import math
import os
import signal
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hedgerow.orchestrator.experiments.sweep import boxes, summary
from hedgerow.orchestrator.experiments.sweep.folder import SweepFolder, default_out
from hedgerow.orchestrator.experiments.sweep.plan import Chunk, Plan, plan, split, typed
from hedgerow.orchestrator.experiments.sweep.runs import METRICS, Failure, Row, answer, run_here
from hedgerow.orchestrator.experiments.sweep.summary import spread, values_of
from hedgerow.topologies.errors import Code, TopologyError, UserError
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from tests.tools.networks import read
from tests.tools.processes import DEADLINE_S, Orchestrator, gone, orchestrator
from tests.tools.refusals import refusal

SINUSOID = (
    "{kind: sinusoid, amplitude: {random: [0.1, 1]}, omega: {random: [0, 3.14159]}, phase: {random: [0, 6.28318]}}"
)
WHITE = "{kind: white, std: 1}"
THEORY_TREES = 100
"""The minimum number of trees behind the shares in docs/theory.md, which have a sampling error."""


def rows(out: Path) -> list[dict[str, Any]]:
    """The table of a sweep."""
    table: list[dict[str, Any]] = pq.read_table(out / "sweep.parquet").to_pylist()
    return table


def made(what: Plan, out: Path) -> list[list[Row]]:
    """Return the runs of a plan by setting; make the missing ones here, and write the table."""
    with SweepFolder(what, out) as folder:
        for chunk in what.chunks(folder.rows):
            found = answer(what, chunk)
            assert not isinstance(found, Failure), found
            folder.append(found)
        folder.write_table()
        return [folder.asked(k) for k in range(len(what.settings))]


def of(*sets: str, seeds: str = "0:2", engine: str = "in-process") -> Plan:
    """A plan of paper7."""
    return plan("paper7", seeds, list(sets), engine)


def lines(out: Path) -> int:
    """Return the number of stored runs of a sweep."""
    file = out / "runs.jsonl"
    return file.read_bytes().count(b"\n") if file.exists() else 0


def wait_for_runs(out: Path, runs: int) -> None:
    """Wait until this number of runs is stored."""
    deadline, pause = time.monotonic() + DEADLINE_S, threading.Event()
    while lines(out) < runs:
        assert time.monotonic() < deadline, f"{lines(out)} runs in {out}"
        pause.wait(0.01)


def workers(sweeping: Orchestrator) -> dict[str, int]:
    """All processes below a sweep, by number."""
    below = psutil.Process(sweeping.pid).children(recursive=True)
    return {str(child.pid): child.pid for child in below}


# The shares of right estimates.


def agrees(shares: Sequence[float], figure: float) -> bool:
    """Return True if runs agree with a rounded figure of other runs, within four standard errors of the difference.

    The nodes of a run share its flows, so a run is one sample (a cluster). Its spread is at least that of seven
    independent nodes.
    """
    deviation = max(float(np.std(shares, ddof=1)), math.sqrt(figure * (1 - figure) / 7))
    error = deviation * math.sqrt(1 / len(shares) + 1 / THEORY_TREES)
    return abs(float(np.mean(shares)) - figure) <= 4 * error + 0.005


def test_shares_of_right_estimates_after_30_steps_are_those_of_the_theory(here: Path) -> None:
    made(of("defaults.x0=0,15", f"defaults.disturbance=none, {SINUSOID}, {WHITE}", seeds="0:60"), here / "out")
    table = rows(here / "out")
    for x0, w, figure in ((0, SINUSOID, 0.21), (15, SINUSOID, 0.87), (0, WHITE, 0.46), (15, "none", 1.0)):
        shares = [r["share_right"] for r in table if (r["defaults.x0"], r["defaults.disturbance"]) == (x0, w)]
        assert len(shares) == 60
        assert agrees(shares, figure), (x0, w, np.mean(shares))
        assert not agrees(shares, figure - 0.2), "a test that 60 runs cannot fail proves nothing"


@pytest.mark.slow
def test_shares_of_right_estimates_after_3000_steps_are_those_of_the_theory(here: Path) -> None:
    for x0, w, figure in ((0, SINUSOID, 0.21), (15, SINUSOID, 0.31), (0, WHITE, 0.90)):
        made(of(f"defaults.x0={x0}", f"defaults.disturbance={w}", "steps=3000", seeds="0:6"), here / f"{figure}")
        shares = [row["share_right"] for row in rows(here / f"{figure}")]
        assert agrees(shares, figure), (x0, w, np.mean(shares))


# The content of a row.


def test_a_row_agrees_with_the_verdict_of_its_run(here: Path) -> None:
    made(plan("ring6", "3:5", ["law=minimax,nominal", "steps=5,8"], "in-process"), here / "out")
    table = rows(here / "out")
    assert [(r["law"], r["steps"], r["seed"]) for r in table] == [
        (law, steps, seed) for law in ("minimax", "nominal") for steps in (5, 8) for seed in (3, 4)
    ]
    row = table[3]
    run = ["--law", "minimax", "--steps", "8", "--seed", "4", "--no-record", "--run-dir", "run"]
    assert orchestrator("simulate", "ring6", *run).returncode == 0
    verdict = json.loads((here / "run/verdict.json").read_text(encoding="utf-8"))
    assert {name: row[name] for name in METRICS} == verdict["metrics"]
    assert row["share_right"] == verdict["metrics"]["nodes_right"] / 6
    assert (row["verdict"], row["reasons"]) == ("valid", "")


def test_the_same_over_real_processes_is_the_same_table(here: Path) -> None:
    for engine in ("zenoh", "in-process"):
        made(of("steps=10", seeds="1:2", engine=engine), here / engine)
    assert (here / "zenoh/sweep.parquet").read_bytes() == (here / "in-process/sweep.parquet").read_bytes()


def test_a_metric_that_is_undefined_is_null(tmp_path: Path) -> None:
    what = of("defaults.disturbance=none")
    assert "undefined" in summary.table(what, made(what, tmp_path / "out"))
    assert [row["gain"] for row in rows(tmp_path / "out")] == [None, None]


def test_a_law_that_fails_makes_its_runs_unknown_and_no_others(here: Path) -> None:
    (here / "mine.py").write_text(
        "from hedgerow.agents.law import Minimax\n\nclass Tired(Minimax):\n"
        "    def learn(self, x, flow, x_next, sample):\n"
        "        if sample.t == 20: raise RuntimeError('tired')\n",
        encoding="utf-8",
    )
    swept = orchestrator("sweep", "paper7", "--seeds", "0:2", "--set", "law=minimax,mine:Tired", "--out", "out")
    assert swept.returncode == 3, swept.stderr
    table = rows(here / "out")
    assert [row["verdict"] for row in table] == ["valid", "valid", "unknown", "unknown"]
    assert "tired" in table[2]["reasons"]
    assert swept.stdout.splitlines()[-1].startswith("unknown (first seed 0, law=mine:Tired: ")


# Interruption, kill and continuation.

LINE401 = str(Path(__file__).parents[2] / "tools" / "line401.yaml")
LONG = ("sweep", LINE401, "--seeds", "0:24", "--set", "law=minimax,hinf")


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The table of one job without interruption."""
    out = tmp_path_factory.mktemp("sweep") / "out"
    assert orchestrator(*LONG, "--jobs", "1", "--out", str(out)).returncode == 0
    return (out / "sweep.parquet").read_bytes()


def test_a_stopped_and_killed_sweep_continues_to_the_same_bytes(here: Path, undisturbed: bytes) -> None:
    command, out = (*LONG, "--jobs", "3", "--out", "out"), here / "out"
    with Orchestrator(*command) as sweeping:
        wait_for_runs(out, 4)
        below = workers(sweeping)
        sweeping.send(signal.SIGINT)
        assert sweeping.wait() == 3, sweeping.output
        assert gone(below)
    there = lines(out)
    assert f"{there} of 48" in sweeping.output
    assert "Traceback" not in sweeping.output
    assert not (out / "sweep.parquet").exists()
    with Orchestrator(*command) as sweeping:
        wait_for_runs(out, there + 4)
        below = workers(sweeping)
        sweeping.send(signal.SIGKILL)
        assert sweeping.wait() == -signal.SIGKILL
        assert gone(below)
    with (out / "runs.jsonl").open("a", encoding="utf-8") as file:
        file.write('{"setting": 0, "se')  # as if it had been killed while it wrote
    there = lines(out)
    swept = orchestrator(*command)
    assert swept.returncode == 0, swept.stderr
    assert (out / "sweep.parquet").read_bytes() == undisturbed


def is_a_worker_that_takes_ctrl_c(pid: int) -> bool:
    """Return True if the interpreter has started so far that SIGINT would raise KeyboardInterrupt."""
    with contextlib.suppress(psutil.Error, OSError):
        caught = Path(f"/proc/{pid}/status").read_text().partition("SigCgt:")[2].split()[0]
        return "spawn_main" in " ".join(psutil.Process(pid).cmdline()) and bool(
            int(caught, 16) & 1 << signal.SIGINT - 1
        )
    return False


def test_ctrl_c_finds_a_worker_deaf_from_its_first_instruction_on(here: Path) -> None:
    pause = threading.Event()
    with Orchestrator(*LONG, "--jobs", "2", "--out", "out") as sweeping:
        deadline = time.monotonic() + DEADLINE_S
        while not any(map(is_a_worker_that_takes_ctrl_c, workers(sweeping).values())):
            assert time.monotonic() < deadline, sweeping.output
            pause.wait(0.001)
        os.killpg(sweeping.pid, signal.SIGINT)  # as a terminal does
        assert sweeping.wait() == 3, sweeping.output
    assert "Traceback" not in sweeping.output


def test_a_killed_worker_costs_nothing(here: Path, undisturbed: bytes) -> None:
    with Orchestrator(*LONG, "--jobs", "2", "--out", "out") as sweeping:
        wait_for_runs(here / "out", 2)
        for pid in workers(sweeping).values():
            psutil.Process(pid).kill()
        assert sweeping.wait() == 0, sweeping.output
    assert (here / "out/sweep.parquet").read_bytes() == undisturbed


def test_a_sweep_with_dying_workers_is_reported(here: Path) -> None:
    (here / "deadly.py").write_text(
        "import multiprocessing, os, signal\nfrom hedgerow.agents.law import Minimax\n\nclass Deadly(Minimax):\n"
        "    def learn(self, x, flow, x_next):\n"
        "        if multiprocessing.parent_process():  # a worker, and not the process that tests the contract\n"
        "            os.kill(os.getpid(), signal.SIGKILL)\n"
        "        super().learn(x, flow, x_next)\n",
        encoding="utf-8",
    )
    swept = orchestrator("sweep", "paper7", "--seeds", "0:2", "--set", "law=deadly:Deadly", "--jobs", "1")
    assert swept.returncode == 3
    assert swept.stderr.startswith("error: seed 0, law=deadly:Deadly: ")


def test_seeds_may_grow(tmp_path: Path) -> None:
    made(of(seeds="0:3"), tmp_path / "out")
    more = of(seeds="1:5")
    with SweepFolder(more, tmp_path / "out") as folder:
        assert folder.there == 2
    made(more, tmp_path / "out")
    assert [row["seed"] for row in rows(tmp_path / "out")] == [1, 2, 3, 4]
    assert default_out(more) == default_out(of(seeds="0:3")) != default_out(of("steps=4"))


# Mistakes.


@pytest.mark.parametrize(
    ("seeds", "sets", "code", "at"),
    [
        ("5:2", [], Code.OPTION, "--seeds 5:2"),
        ("7", [], Code.OPTION, "--seeds 7"),
        ("-3:2", [], Code.OPTION, "--seeds -3:2"),
        ("0:2", ["stepz=3"], Code.TOPOLOGY, "--set stepz=3"),
        ("0:2", ["defaults.x1=3,4"], Code.TOPOLOGY, "--set defaults.x1=3"),
        ("0:2", ["b=0.1,3"], Code.TOPOLOGY, "--set b=3"),
        ("0:2", ["law=minimax,guess"], Code.TOPOLOGY, "--set law=guess"),
        ("0:2", ["law=minimax,minimax"], Code.OPTION, "--set law=minimax,minimax"),
        ("0:2", ["law=minimax,"], Code.OPTION, "--set law=minimax,"),
        ("0:2", ["law=hinf", "law=minimax"], Code.OPTION, "--set law=minimax"),
        ("0:2", ["seed=1,2"], Code.OPTION, "--set seed=1,2"),
        ("0:2", ["law"], Code.OPTION, "--set law"),
        ("0:20000000", [], Code.OPTION, ""),
    ],
)
def test_a_mistake_is_one_line_with_a_fix(seeds: str, sets: list[str], code: Code, at: str) -> None:
    with refusal(code, at) as mistake:
        plan("paper7", seeds, sets, "in-process")
    assert "\n" not in str(mistake.value)
    assert not isinstance(mistake.value, TopologyError)


@pytest.mark.parametrize(
    ("other", "differs"),
    [
        (of("steps=3,5"), "steps"),
        (of("law=minimax"), "law"),
        (of("steps=3,4", engine="zenoh"), "engine"),
        (plan("ring6", "0:2", ["steps=3,4"], "in-process"), "name"),
    ],
)
def test_a_folder_holds_one_sweep(tmp_path: Path, other: Plan, differs: str) -> None:
    with SweepFolder(of("steps=3,4"), tmp_path / "out"):
        pass
    with refusal(Code.OUTPUT, f"--out {tmp_path / 'out'}") as refused, SweepFolder(other, tmp_path / "out"):
        pass
    assert differs in str(refused.value)


def test_a_changed_file_is_a_new_sweep(tmp_path: Path) -> None:
    text = "{name: one, b: 0.1, steps: 3, nodes: {1: {x0: %d}}}"
    file = tmp_path / "one.yaml"
    file.write_text(text % 1, encoding="utf-8")
    with SweepFolder(plan(str(file), "0:2", [], "in-process"), tmp_path / "out"):
        pass
    file.write_text(text % 2, encoding="utf-8")
    changed = plan(str(file), "0:2", [], "in-process")
    with refusal(Code.OUTPUT), SweepFolder(changed, tmp_path / "out"):
        pass


def test_a_foreign_folder_is_not_changed(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").touch()
    with (
        refusal(Code.OUTPUT),
        SweepFolder(of(), tmp_path),
    ):
        pass


@pytest.mark.parametrize("damage", ['{"setting": 0}', "[]", "precious"])
def test_a_damaged_line_is_named(tmp_path: Path, damage: str) -> None:
    made(of(seeds="0:2"), tmp_path / "out")
    with (tmp_path / "out/runs.jsonl").open("a", encoding="utf-8") as file:
        file.write(f"{damage}\n")
    with (
        refusal(Code.FILE_FORMAT),
        SweepFolder(of(seeds="0:3"), tmp_path / "out"),
    ):
        pass


def test_a_full_disk_keeps_the_finished_runs_and_the_same_command_continues(here: Path, undisturbed: bytes) -> None:
    command = (*LONG, "--jobs", "1", "--out", "out")
    done = orchestrator(*command, largest=10_000)
    assert done.returncode == 2
    assert os.strerror(errno.EFBIG) in done.stderr
    assert "Traceback" not in done.stderr
    assert orchestrator(*command).returncode == 0
    assert (here / "out/sweep.parquet").read_bytes() == undisturbed


def test_two_sweeps_do_not_share_a_folder(tmp_path: Path) -> None:
    one, two = SweepFolder(of(), tmp_path / "out"), SweepFolder(of(), tmp_path / "out")
    with one, refusal(Code.OUTPUT), two:
        pass


def test_a_seed_with_an_impossible_network_is_named() -> None:
    # The file's own seed draws lists of which one holds this a; another seed's does not.
    a = resolve(load("paper7")).nodes[1].candidates[0]  # type: ignore[index]
    what = of(f"faults=[{{kind: jump, node: 1, at: 3, a: {a!r}}}]", seeds="1:9")
    failed = answer(what, Chunk(0, (1, 2)))
    assert isinstance(failed, Failure)
    assert failed.text.startswith("seed 2, faults=[")
    assert isinstance(failed.error(), UserError)


# The parts.


@given(st.lists(st.sampled_from(["3", "0.5", "[1, 2]", "{a: 1, b: [2, 3]}", "'a, b'", '"]"', "minimax"]), min_size=1))
def test_values_are_split_at_commas_outside_brackets_and_quotes(values: list[str]) -> None:
    assert split(", ".join(values)) == values


def test_columns_are_numbers_where_all_values_are() -> None:
    assert typed(["30", "300"]) == [30, 300]
    assert [type(value) for value in typed(["1", "0.5"])] == [float, float]
    assert typed(["true", "false"]) == [True, False]
    assert typed(["1", "none"]) == ["1", "none"]


def test_metrics_do_not_depend_on_how_telemetry_was_batched(monkeypatch: pytest.MonkeyPatch) -> None:
    network = read((Path(__file__).parents[3] / "topologies/paper7.yaml").read_text(encoding="utf-8"))
    whole = run_here(network)["metrics"]
    monkeypatch.setattr("hedgerow.orchestrator.metrics.observer.ROWS", 7)
    assert run_here(network)["metrics"] == whole


def test_the_summary_and_the_boxes_are_the_quartiles_of_the_table(here: Path) -> None:
    swept = orchestrator(
        "sweep", "paper7", "--seeds", "0:9", "--set", "steps=4,12", "--set", "law=minimax", "--out", "o"
    )
    assert swept.returncode == 0, swept.stderr
    by_steps = {steps: [row for row in rows(here / "o") if row["steps"] == steps] for steps in (4, 12)}
    with (here / "o/summary.csv").open(encoding="utf-8", newline="") as file:
        found = {(line["steps"], line["metric"]): line for line in csv.DictReader(file)}
    for steps, own in by_steps.items():
        regret = values_of(own, "regret")
        assert float(found[str(steps), "regret"]["median"]) == np.median(regret)
        assert f"{np.median(regret):.3g} [" in swept.stdout
        assert float(found[str(steps), "share_right"]["error"]) == spread(values_of(own, "share_right")).error
    heading = next(line for line in swept.stdout.splitlines() if "nodes right" in line)
    assert heading.split()[:2] == ["steps", "runs"], "a key with one value needs no column"
    figure = boxes.draw(of("steps=4,12", "law=minimax", seeds="0:9"), list(by_steps.values()))
    for axis, metric in zip(figure.axes, boxes.PANELS, strict=True):
        medians = [np.median(values_of(own, metric)) for own in by_steps.values()]
        drawn = [line.get_ydata()[0] for line in axis.lines if line.get_linewidth() == 1.5]  # type: ignore[index]
        assert drawn == medians
    assert [label.get_text() for label in figure.axes[-1].get_xticklabels()] == ["4", "12"]
    assert all((here / "o" / name).stat().st_size > 1000 for name in ("boxes.pdf", "boxes.png"))


# Over a cluster.
