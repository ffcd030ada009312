"""Misspelt options: the one that is suggested, and the distance that chooses it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hedgerow.orchestrator.cli.spelling import EDIT, SWAP, distance, nearest
from hedgerow.topologies.errors import Exit

WORDS = st.text("abc-", max_size=6)


@given(WORDS, WORDS)
def test_the_distance_is_symmetric_and_zero_for_equal_words_only(one: str, other: str) -> None:
    assert distance(one, other) == distance(other, one)
    assert (distance(one, other) == 0) == (one == other)
    assert distance(one, other) <= EDIT * max(len(one), len(other))


@given(WORDS, st.integers(0, 4))
def test_two_letters_that_changed_places_are_the_nearest_slip(word: str, at: int) -> None:
    swapped = word[:at] + word[at : at + 2][::-1] + word[at + 2 :]
    assert distance(word, swapped) in (0, SWAP)


@pytest.mark.parametrize(
    ("word", "meant"),
    [("--stesp", "--steps"), ("--stps", "--steps"), ("--listne", "--listen"), ("--q", None), ("--zzzzzz", None)],
)
def test_the_nearest_option_is_meant(word: str, meant: str | None) -> None:
    assert nearest(word, ["--listen", "--steps", "--set", "--seed", "--quiet"]) == meant


@pytest.mark.parametrize("words", [("up", "paper7", "--stesp", "5"), ("simulate", "paper7", "--stesp", "5")])
def test_a_misspelt_option_has_one_suggestion(words: tuple[str, ...], tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "hedgerow.orchestrator", *words],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == Exit.USER_MISTAKE
    assert "--steps" in done.stderr
    assert "--listen" not in done.stderr
    assert "--set" not in done.stderr
