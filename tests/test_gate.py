"""The gate between two revisions: its intervals, its verdict, and the one command that runs both."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.gate import cases, lost, ratio, unclear, unpack
from hedgerow.topologies.errors import Exit
from hedgerow.topologies.load import load

SPEEDS = st.floats(1e-3, 1e6)


@given(factor=st.floats(0.1, 10), speeds=st.lists(SPEEDS, min_size=2, max_size=10))
def test_a_constant_factor_is_found_under_any_load(factor: float, speeds: list[float]) -> None:
    one = ratio([(speed, factor * speed) for speed in speeds])
    assert one.mean == pytest.approx(factor)
    assert one.low == pytest.approx(factor) == pytest.approx(one.high)


@given(pairs=st.lists(st.tuples(SPEEDS, SPEEDS), min_size=2, max_size=10))
def test_the_interval_holds_the_mean_and_the_other_way_round_is_the_inverse(pairs: list[tuple[float, float]]) -> None:
    one, back = ratio(pairs), ratio([(b, a) for a, b in pairs])
    assert one.low <= one.mean * (1 + 1e-9)
    assert one.mean <= one.high * (1 + 1e-9)
    assert one.mean * back.mean == pytest.approx(1)


@pytest.mark.parametrize(
    ("speeds", "is_lost", "is_unclear"),
    [
        ([0.8, 0.81, 0.79], True, False),
        ([0.8, 0.81], False, True),
        ([0.8, 1.3, 0.7], False, True),
        ([1.0, 0.99, 1.02], False, False),
    ],
)
def test_speed_is_lost_only_if_the_whole_interval_shows_it(
    speeds: list[float], is_lost: bool, is_unclear: bool
) -> None:
    one = ratio([(1.0, speed) for speed in speeds])
    assert lost(one, 0.9) is is_lost
    assert unclear(one, 0.9) is is_unclear


def test_a_name_that_is_no_revision_is_refused(tmp_path: object) -> None:
    with pytest.raises(SystemExit):
        unpack("--no-such-revision", tmp_path)  # type: ignore[arg-type]


def test_the_files_of_every_case_can_be_read(tmp_path: Path) -> None:
    files = [Path(case.arguments[1]) for case in cases(tmp_path, quick=True)]
    written = {file for file in files if file.suffix == ".yaml"}
    assert written == set(tmp_path.iterdir())
    assert {load(str(file)).graph.n for file in written} == {20, 10_000}


@pytest.mark.slow
def test_one_command_compares_two_revisions() -> None:
    command = [
        sys.executable,
        "-m",
        "benchmarks.gate",
        "HEAD",
        "HEAD",
        "--quick",
        "--json",
        "--only",
        "simulate paper7",
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == Exit.VALID, done.stderr
    assert {one["case"] for one in json.loads(done.stdout)["ratios"]} == {"simulate paper7"}
