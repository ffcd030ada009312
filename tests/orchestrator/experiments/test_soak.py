"""A network that runs for long stays as it was, and one that does not is found out."""

from __future__ import annotations

import csv
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import psutil
import pytest

from hedgerow.orchestrator.experiments.soak import LEAST_MINUTES, STEPS, Sample, look, pace_of, trends_of, with_faults
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from tests.tools.processes import orchestrator


def looks(leak_mb: float = 0.0, leak_files: float = 0.0, slower: float = 0.0) -> list[Sample]:
    """Return 20 minutes of one process with this growth per minute, or with this loss of speed."""
    samples = []
    for t in range(0, 1200, 5):
        grown, files = 100 + leak_mb * t / 60, int(20 + leak_files * t / 60)
        step = int(50 * t - slower * t * t / 120)
        samples.append(Sample(float(t), step, "plant", 1, grown, grown, 8, files))
    return samples


@pytest.mark.parametrize(
    ("samples", "what"),
    [
        (looks(), set()),
        (looks(leak_mb=0.15), set()),
        (looks(leak_mb=0.25), {"plant memory"}),
        (looks(leak_files=0.05), set()),
        (looks(leak_files=0.5), {"plant files"}),
        (looks(slower=0.1), set()),
        (looks(slower=1.0), {"pace"}),
    ],
)
def test_growth_is_detected(samples: list[Sample], what: set[str]) -> None:
    assert {trend.what for trend in trends_of(samples) if not trend.flat} == what


def test_the_pace_is_counted_between_looks() -> None:
    _, pace = pace_of(looks())
    assert pace == pytest.approx(50)


def test_a_warm_up_is_not_judged() -> None:
    """300 MB more in the first two minutes is not a leak."""
    steep = [Sample(one.t_s, one.step, "up", 1, 0, 100 + 2.5 * min(one.t_s, 120), 8, 20) for one in looks()]
    assert all(trend.flat for trend in trends_of(steep))


def test_a_process_that_took_anothers_place_is_not_judged_while_it_is_young() -> None:
    """Half a minute, killed after 12 s; the new one is at half its size for 3 s."""
    half = [t / 2 for t in range(60)]
    reborn = [Sample(t, int(50 * t), "shard-0", int(t >= 12), 0, 20 if 12 <= t < 15 else 40, 8, 20) for t in half]
    assert all(trend.flat for trend in trends_of(reborn))
    same_place = [replace(one, pid=1) for one in reborn]
    assert {trend.what for trend in trends_of(same_place) if not trend.flat} == {"shard-0 memory"}


def test_growth_across_restarted_processes_is_detected() -> None:
    reborn = [replace(one, pid=int(one.t_s // 300)) for one in looks(leak_mb=1.0)]
    assert {trend.what for trend in trends_of(reborn) if not trend.flat} == {"plant memory"}


def test_a_zombie_process_is_not_measured() -> None:
    """The kernel keeps a zombie, without memory and files, until its parent reads its exit code."""
    with subprocess.Popen([sys.executable, "-c", ""]) as ended:
        os.waitid(os.P_PID, ended.pid, os.WEXITED | os.WNOWAIT)
        assert psutil.Process(ended.pid).memory_info().rss == 0
        pids = {one.pid for one in look(psutil.Process(), 0.0, 0)}
    assert os.getpid() in pids
    assert ended.pid not in pids


def test_faults_continue_during_the_whole_run() -> None:
    topology = with_faults(resolve(load("paper7")).model_copy(update={"steps": STEPS}))
    assert {type(fault).__name__ for fault in topology.faults} == {"Drop", "Delay", "Cut", "Sensor", "Actuator"}
    assert all(getattr(fault, "steps", None) is None for fault in topology.faults)


@pytest.mark.slow
def test_the_shortest_soak_is_flat_and_leaves_a_table_and_a_picture(here: Path) -> None:
    """The speed of a busy machine proves nothing."""
    minutes = str(LEAST_MINUTES)
    done = orchestrator("soak", "paper7", "--minutes", minutes, "--rate", "50", "--processes", "3", "--run-dir", "soak")
    last = done.stdout.splitlines()[-1]
    assert (done.returncode, last[:6]) == (0, "flat: ") or last.startswith("not flat: pace:"), done.stdout + done.stderr
    assert re.search(r"\b[1-9][0-9]* restarts", last), "an agent was killed, and came back"
    with (here / "soak/soak.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["process"] for row in rows} == {"up", "fork server", "plant", "shard-0", "shard-1", "shard-2"}
    assert max(int(row["step"]) for row in rows) > 350
    assert (here / "soak/soak.png").stat().st_size > 10_000
    assert [path.name for path in here.iterdir() if path.name.startswith(".")] == []


def test_a_soak_of_nothing_is_a_mistake(here: Path) -> None:
    done = orchestrator("soak", "paper7", "--minutes", "0")
    assert done.returncode == 2
    assert done.stderr.startswith("error: --minutes 0: ")
