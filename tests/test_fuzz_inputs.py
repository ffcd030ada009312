"""Inputs of every kind as no one should write them, each within 5 s and 256 MB: a short run of another seed."""

from __future__ import annotations

import os

import pytest

from tests.tools.fuzz import fuzz
from tests.tools.fuzz_inputs import KINDS

SEED = 1
CASES = int(os.environ.get("HEDGEROW_FUZZ_CASES", "6"))
"""of each kind"""


@pytest.mark.slow
def test_an_input_is_refused_in_words_or_good() -> None:
    counts, findings = fuzz("inputs", SEED, range(CASES * len(KINDS)))
    assert not findings, "\n".join(map(str, findings))
    assert sum(counts.values()) == CASES * len(KINDS)
    assert {name.rpartition(" ")[2] for name in counts} == {"good", "refused"}
