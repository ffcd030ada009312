"""A test fails at a run that is not valid, unless it expects one."""

from __future__ import annotations

from typing import Literal

import pytest

from hedgerow.orchestrator.testing import Networks, VerdictError, scenario
from hedgerow.topologies.errors import Code


@pytest.mark.parametrize("engine", ["in-process", "zenoh"])
def test_a_fault_that_cannot_strike_fails_the_test(network: Networks, engine: Literal["in-process", "zenoh"]) -> None:
    late = network("paper7", "steps=20").drop((2, 4), steps=range(80, 90))
    with pytest.raises(VerdictError) as failed:
        late.run(engine=engine, processes=1)
    assert failed.value.code == Code.VERDICT
    assert failed.value.run.verdict.verdict == "unknown"
    assert failed.value.run.missing((2, 4)) == []


def test_a_test_may_expect_a_run_that_is_not_valid(network: Networks) -> None:
    run = network("paper7", "steps=20").drop((2, 4), steps=range(80, 90)).run(check=False)
    assert run.verdict.verdict == "unknown"
    assert len(run.verdict.content["reasons"]) == 1


def test_a_running_network_that_is_stopped_is_no_error(network: Networks) -> None:
    with network("paper7").up(rate=100, processes=1) as net:
        net.wait_for_step(2)
        run = net.stop()
    assert run.verdict.verdict == "unknown"


def test_a_running_network_raises_at_its_end(network: Networks, monkeypatch: pytest.MonkeyPatch) -> None:
    """A stopped run is as bad as an INVALID one here, at `stop` and at the end of the block."""
    monkeypatch.setattr(scenario, "INVALID", "unknown")
    with network("paper7").up(rate=100, processes=1) as net:
        net.wait_for_step(2)
        with pytest.raises(VerdictError):
            net.stop()
    with pytest.raises(VerdictError), network("paper7").up(rate=100, processes=1) as net:
        net.wait_for_step(2)


def test_the_error_of_the_test_comes_first(network: Networks, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scenario, "INVALID", "unknown")
    with pytest.raises(ZeroDivisionError), network("paper7").up(rate=100, processes=1) as net:
        net.wait_for_step(10**9 // 0)
