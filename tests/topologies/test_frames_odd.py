"""Samples as people have them: durations, gaps, repeated columns and files with a mistake."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import hedgerow as hg
from tests.tools.refusals import refusal

NET = hg.Network("pair", b=0.1, steps=4, nodes=["p", 7], edges=[("p", 7)])
HOURS = pd.date_range("2026-03-28 23:00", periods=5, freq="1h", tz="Europe/Berlin")
VALUES = [1.0, 2.0, 3.0, 4.0, 5.0]


def samples(frame: Any, **keys: Any) -> list[float]:
    found: list[float] = NET.with_samples(frame, **keys)["nodes"]["p"]["disturbance"]["values"]
    return found


TIMES: dict[str, Any] = {
    "durations": pd.to_timedelta(range(5), unit="h"),
    "a zone with a change of clocks": HOURS,
    "dates without a zone": HOURS.tz_convert(None),
    "texts of several zones": ["2026-03-29T00:00+01:00", *(one.isoformat() for one in HOURS.tz_convert("UTC")[2:])],
    "numbers of seconds": np.arange(5) * 3600,
}


@pytest.mark.parametrize("what", TIMES)
def test_times_of_every_kind(what: str) -> None:
    frame = pd.DataFrame({"when": TIMES[what], "p": VALUES[: len(TIMES[what])]})
    assert samples(frame, time="when", step=3600)[:2] == [1.0, 2.0]
    assert samples(frame, time="when", step=1800, resample="linear") == [1.0, 1.5, 2.0, 2.5]


def test_uneven_times() -> None:
    assert samples({"t": [0, 0.4, 1.7, 3.2], "p": VALUES[:4]}, time="t", step=1) == [1, 2, 3, 3]
    assert samples({"t": [0, 0.5, 2, 4], "p": [0, 1, 4, 8]}, time="t", step=1, resample="linear") == [0, 2, 4, 6]
    assert samples({"t": [0, 0.4, 0.9, 3.2], "p": VALUES[:4]}, time="t", step=1, resample="mean") == [2, 3, 3, 4]


REFUSED: dict[str, Callable[[], Any]] = {
    "two columns of one name": lambda: pd.DataFrame([[1, 2]] * 4, columns=["p", "p"]),
    "a number and its text": lambda: pd.DataFrame([[1, 2]] * 4, columns=["7", 7]),
    "no rows": lambda: pd.DataFrame({"t": [], "p": []}),
    "a time twice": lambda: {"t": [0, 1, 1, 2], "p": VALUES[:4]},
    "a time without a value": lambda: {"t": [0, 1, np.nan, 2], "p": VALUES[:4]},
    "no date": lambda: pd.DataFrame({"t": [HOURS[0], pd.NaT], "p": VALUES[:2]}),
}


@pytest.mark.parametrize("what", REFUSED)
def test_a_frame_with_a_mistake_is_refused(what: str) -> None:
    with pytest.raises(hg.UserError) as raised:
        NET.with_samples(REFUSED[what](), time="t")
    assert raised.value.code == hg.Code.FILE_FORMAT


def test_a_long_gap_and_a_short_step_take_no_memory() -> None:
    with pytest.raises(hg.UserError) as raised:
        NET.with_samples({"t": [0, 1, 3e9], "p": VALUES[:3]}, time="t", step=1e-3)
    assert raised.value.code == hg.Code.FILE_TOO_LARGE


@pytest.mark.parametrize(
    ("content", "line"), [("p,7\n1,2\n3\n", 3), ("# a note\np,7\n1,2\n", 2), ("p,p\n1,2\n", 0), ("p\n", 0)]
)
def test_a_file_with_a_mistake_is_refused(content: str, line: int, here: Path) -> None:
    Path("w.csv").write_text(content)
    with refusal(hg.Code.FILE_FORMAT, f"w.csv:{line}" if line else "w.csv"):
        NET.with_samples("w.csv")


def test_the_ending_of_a_file_may_have_capitals(here: Path) -> None:
    pd.DataFrame({"p": VALUES}).to_parquet("W.PARQUET")
    assert samples("W.PARQUET") == VALUES[:4]
