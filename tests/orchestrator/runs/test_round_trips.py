"""The answer times of processes: recorded by step, shown, summarised, and separate from the reproducible tables."""

from __future__ import annotations

import json
import os
import signal
import tempfile
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hedgerow.orchestrator.metrics.observer import Observer
from hedgerow.orchestrator.runs.round_trips import RoundTrips, line
from hedgerow.orchestrator.views.rerun.stream import RerunStream
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from hedgerow.wire.message import RoundTripTimes
from tests.orchestrator.views.test_rerun_stream import read as read_rrd
from tests.tools.processes import Orchestrator, orchestrator

NAN = float("nan")


@given(
    st.lists(st.tuples(st.floats(1e-6, 1e3), st.one_of(st.just(NAN), st.floats(1e-6, 1e3))), min_size=1, max_size=60),
    st.integers(1, 7),
)
def test_the_figures_are_those_of_all_answers(rows: list[tuple[float, float]], at_once: int) -> None:
    """For any batches: the maximum has an error of a microsecond, a percentile 1 %; a process without answers has
    none.
    """
    seconds = np.array(rows)
    with tempfile.TemporaryDirectory() as folder:
        trips = RoundTrips(["agent-1", "shard-1", "agent-9"], Path(folder))
        third = np.hstack([seconds, np.full((len(rows), 1), NAN)])
        ms = np.round(1e3 * third, 3)
        for first in range(0, len(rows), at_once):
            trips.take(RoundTripTimes(5 + first, third[first : first + at_once]))
        trips.close()
        summary = trips.summary()
        table = pl.read_parquet(Path(folder) / "round_trips.parquet")
    assert summary["agent-9"] == {"answers": 0, "median_ms": None, "p99_ms": None, "max_ms": None}
    for p, name in enumerate(("agent-1", "shard-1")):
        there = np.sort(ms[:, p][~np.isnan(ms[:, p])])
        assert summary[name]["answers"] == len(there)
        if len(there):
            figures = [summary[name][key] for key in ("median_ms", "p99_ms", "max_ms")]
            exact = [there[int(np.ceil(share * len(there))) - 1] for share in (0.5, 0.99, 1.0)]
            np.testing.assert_allclose(np.array(figures, float), exact, rtol=0.011, atol=1e-3)
            assert figures[-1] == there[-1]
    assert table["step"].to_list() == np.repeat(np.arange(5, 5 + len(rows)), 3).tolist()
    found = table["round_trip_ms"].fill_null(NAN).to_numpy().reshape(-1, 3)
    np.testing.assert_array_equal(found, ms)


def test_of_many_processes_the_line_names_the_slowest() -> None:
    figures = {"answers": 9, "median_ms": 1.0, "max_ms": 30.25}
    summary = {f"agent-{k}": {**figures, "p99_ms": float(k)} for k in range(20)}
    assert line(summary).startswith(
        "round trips, median/99 %/most [ms], the slowest of 20: agent-19 1/19/30.2, agent-18"
    )
    assert line(dict(list(summary.items())[:1])) == "round trips, median/99 %/most [ms]: agent-0 1/0/30.2"
    assert line({"agent-1": {"answers": 0}}) == ""


@pytest.mark.parametrize("processes", [7, 40])
def test_the_viewer_has_a_line_a_process_or_the_quantiles_of_many(tmp_path: Path, processes: int) -> None:
    topology = resolve(load("paper7"))
    names = [f"agent-{k}" for k in range(processes)]
    stream = RerunStream(topology, Observer(topology), "run", tmp_path / "run.rrd", None, processes=names)
    seconds = np.arange(1.0, 1 + 3 * processes).reshape(3, processes)
    stream.round_trips(RoundTripTimes(4, seconds[:2]), 0.0)
    stream.round_trips(RoundTripTimes(6, seconds[2:]), 1.0)
    assert stream.close(60.0)
    steps, shown = read_rrd(tmp_path / "run.rrd", "round_trip_ms")
    assert steps == [4, 5, 6]
    if processes == 7:
        np.testing.assert_array_equal(shown, 1e3 * seconds)
    else:
        np.testing.assert_array_equal(shown[:, 0], 1e3 * seconds.max(axis=1))
        assert shown.shape == (3, 3)


def test_a_sleeping_agent_has_the_longest_answer_time(here: Path) -> None:
    arguments = ("paper7", "--steps", "400", "--rate", "200", "--viewer", "none", "--no-record", "--verify")
    with Orchestrator("up", *arguments) as network:
        network.wait_for("running")
        os.kill(network.children["agent-3"], signal.SIGSTOP)
        network.wait_for_log("plant", "repeated, still without shards [2]")
        os.kill(network.children["agent-3"], signal.SIGCONT)
        assert network.wait() == 0, network.output
    trips = json.loads(Path("runs/latest/verdict.json").read_text())["round_trips"]
    assert list(trips) == [f"agent-{k}" for k in range(1, 8)]
    assert all(one["answers"] == 400 for one in trips.values())
    assert trips["agent-3"]["max_ms"] > 500
    assert all(one["median_ms"] <= one["p99_ms"] <= one["max_ms"] for one in trips.values())
    table = pl.read_parquet("runs/latest/round_trips.parquet")
    assert table.shape == (400 * 7, 3)
    longest = table.sort("round_trip_ms")[-1].row(0, named=True)
    assert (longest["process"], longest["round_trip_ms"]) == ("agent-3", trips["agent-3"]["max_ms"])
    # The other agents have answered that step before or right after it slept: they did not wait.
    then = table.filter(pl.col("step") == longest["step"])["round_trip_ms"].sort()
    assert then[-2] < 500


def test_in_one_process_nothing_crosses_a_wire(here: Path) -> None:
    assert orchestrator("simulate", "paper7", "--run-dir", "run", "--no-record").returncode == 0
    assert json.loads(Path("run/verdict.json").read_text())["round_trips"] is None
    assert not Path("run/round_trips.parquet").exists()
