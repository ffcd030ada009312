"""A law that estimates real numbers has an error, and no right or wrong; a law that chooses has both."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import hedgerow as hg
from tests.tools.laws import LeastSquares


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.usefixtures("here")
def test_the_error_of_a_law_that_estimates_real_numbers_is_its_metric() -> None:
    run = hg.simulate("paper7", law=LeastSquares)
    assert run.real_estimates
    assert run.verdict.content["real_estimates"]
    error = float(np.abs(run.ahat[-1] - run.a[-1]).mean())
    assert run.verdict.content["metrics"]["estimate_error"] == run.metrics["estimate_error"] == pytest.approx(error)
    assert run.wrong.sum() <= (run.index >= 0).sum(), "only a candidate can be wrong"
    assert not run.wrong[-1].any()


@pytest.mark.usefixtures("here")
def test_a_law_that_chooses_from_the_list_is_right_or_wrong() -> None:
    run = hg.simulate("paper7")
    assert not run.real_estimates
    assert not run.verdict.content["real_estimates"]
    assert (run.wrong == (run.ahat != run.a)).all()
    assert len(run.ids) - run.wrong[-1].sum() == run.verdict.content["metrics"]["nodes_right"]


@pytest.mark.usefixtures("here")
def test_a_law_without_estimates_has_no_error() -> None:
    assert hg.simulate("paper7", law="tests.tools.laws:Damped").metrics["estimate_error"] is None
