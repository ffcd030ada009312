"""Samples from data frames and files: by node id, with times, resampled to steps."""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hedgerow as hg
from hedgerow.topologies.frames import by_steps
from hedgerow.topologies.network import Group
from hedgerow.topologies.reading import Times

PAIR: dict[str, Any] = {"name": "pair", "b": 0.1, "steps": 3, "nodes": ["p", 7], "edges": [["p", 7]]}
COLUMNS = {"p": [1.0, 2.0, 3.0], "7": [4.0, 5.0, 6.0]}


def samples_of(network: hg.Topology) -> dict[int | str, list[float]]:
    group = network.network.disturbance[0]
    assert isinstance(group, Group)
    assert group.kind == "samples"
    return {network.ids[k]: row.tolist() for k, row in zip(group.nodes, group.values["values"], strict=True)}


@pytest.mark.parametrize("make", [dict, pd.DataFrame, pl.DataFrame, pa.table])
def test_a_data_frame_has_a_column_per_node(make: type) -> None:
    net = hg.Network(**PAIR).with_samples(make(COLUMNS))
    assert samples_of(net.topology) == {"p": [1, 2, 3], 7: [4, 5, 6]}


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_a_file_has_a_column_of_times(suffix: str, here: Path) -> None:
    frame = pd.DataFrame({"hour": [0.0, 1.0, 2.0], **COLUMNS})
    if suffix == "csv":
        frame.to_csv("w.csv", index=False)
    else:
        frame.to_parquet("w.parquet")
    part = {"kind": "samples", "file": f"w.{suffix}", "time": "hour", "step": 0.5, "resample": "linear"}
    expected = {"p": [1, 1.5, 2], 7: [4, 4.5, 5]}
    assert samples_of(hg.load({**PAIR, "defaults": {"disturbance": part}})) == expected
    net = hg.Network(**PAIR).with_samples(f"w.{suffix}", time="hour", step=0.5, resample="linear")
    assert samples_of(net.topology) == expected


def test_the_user_names_files_anywhere_and_a_text_does_not(here: Path) -> None:
    (here / "data").mkdir()
    (here / "own").mkdir()
    pd.DataFrame(COLUMNS).to_csv("data/w.csv", index=False)
    part = {"kind": "samples", "file": str(here / "data/w.csv"), "header": "ids"}
    expected = {"p": [1, 2, 3], 7: [4, 5, 6]}
    assert samples_of(hg.load({**PAIR, "defaults": {"disturbance": part}})) == expected
    Path("own/pair.yaml").write_text("{name: pair, b: 0.1, steps: 3, nodes: [p, 7], edges: [[p, 7]]}")
    part["file"] = "data/w.csv"
    assert samples_of(hg.load("own/pair.yaml", defaults={"disturbance": part})) == expected
    Path("own/other.yaml").write_text(
        "{name: pair, b: 0.1, steps: 3, nodes: [p, 7], edges: [[p, 7]], "
        "defaults: {disturbance: {kind: samples, file: ../data/w.csv}}}"
    )
    with pytest.raises(hg.TopologyError):
        hg.load("own/other.yaml")


def test_a_bundled_network_takes_samples_of_the_working_folder(here: Path) -> None:
    ids = list(hg.load("paper7").ids)
    pd.DataFrame({str(node): np.arange(40.0) + k for k, node in enumerate(ids)}).to_parquet("w.parquet")
    network = hg.load("paper7", defaults={"disturbance": {"kind": "samples", "file": "w.parquet"}}, nodes=ids)
    assert samples_of(network)[ids[1]][:2] == [1.0, 2.0]


@pytest.mark.parametrize("stamps", ["dates", "texts", "objects"])
def test_dates_count_in_seconds(stamps: str) -> None:
    dates = pd.date_range("2026-01-01", periods=4, freq="30s")
    values = {
        "dates": dates.to_numpy(),
        "texts": [str(one) for one in dates],
        "objects": [datetime.datetime(2026, 1, 1, 0, 0, 30) + k * datetime.timedelta(seconds=30) for k in range(4)],
    }[stamps]
    found = by_steps("w", {"t": values, "p": [0.0, 1.0, 2.0, 3.0]}, ["p"], Times("t", 60))
    assert found == {"p": [0.0, 2.0]}


def test_a_mean_covers_its_step_and_a_step_without_samples_holds() -> None:
    columns = {"t": [0.0, 0.5, 3.0, 3.5], "p": [1.0, 3.0, 5.0, 9.0]}
    assert by_steps("w", columns, ["p"], Times("t", 1, "mean")) == {"p": [2.0, 3.0, 3.0, 7.0]}


@given(st.lists(st.floats(-5, 5), min_size=1, max_size=30), st.floats(0.01, 10))
def test_equal_steps_change_no_sample(values: list[float], pace: float) -> None:
    times = (np.arange(len(values)) * pace).tolist()
    for how in ("hold", "mean"):
        assert by_steps("w", {"t": times, "p": values}, ["p"], Times("t", pace, how))["p"] == values


@pytest.mark.parametrize(
    ("columns", "times"),
    [
        ({"p": [1, 2, 3], "r": [1, 2, 3]}, None),
        ({"p": [1, 2, None]}, None),
        ({"p": [1, 2, "x"]}, None),
        ({"p": [1, 2, 1e300]}, None),
        ({"p": [1, 2]}, None),
        ({}, None),
        ({"p": [1, 2, 3]}, "t"),
        ({"p": [1, 2, 3], "t": [0, 2, 1]}, "t"),
        ({"p": [1, 2, 3], "t": ["noon", "one", "two"]}, "t"),
        ({"p": [1, 2, 3], "t": [0, 0.1, 0.2]}, "t"),
    ],
)
def test_samples_that_are_wrong_are_refused(columns: dict[str, list[object]], times: str | None) -> None:
    net = hg.Network(**PAIR)
    with pytest.raises(hg.UserError) as raised:
        net.with_samples(columns, time=times, step=None if times is None else 1.0)
    assert raised.value.code in (hg.Code.FILE_FORMAT, hg.Code.TOPOLOGY)
