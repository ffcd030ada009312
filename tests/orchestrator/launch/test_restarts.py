"""An agent on Ray is restarted as one that `up` forked: a life that never reached the router uses up no restart."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from hedgerow.orchestrator.launch.ray_agents import READY, Fleet, _Placed
from hedgerow.orchestrator.launch.restarts import MOST_BACKOFF_S, RESTARTS, UNREACHED_S, Restarts
from hedgerow.orchestrator.runs.folder import create
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve


def test_lives_that_reached_the_router_are_counted() -> None:
    restarts = Restarts()
    assert [restarts.after_death(True, float(k)) is not None for k in range(RESTARTS + 1)] == [True] * RESTARTS + [
        False
    ]


def test_lives_that_did_not_are_restarted_for_some_time() -> None:
    restarts, now = Restarts(), 0.0
    while (pause := restarts.after_death(False, now)) is not None:
        assert 0 < pause <= MOST_BACKOFF_S
        now += pause
    assert UNREACHED_S <= now < UNREACHED_S + MOST_BACKOFF_S
    assert restarts.deaths == 0


def test_a_life_that_reaches_the_router_restarts_that_time() -> None:
    restarts = Restarts()
    restarts.after_death(False, 0.0)
    restarts.after_death(True, 1.0)
    assert restarts.after_death(False, 2 * UNREACHED_S) is not None
    assert restarts.deaths == 1


@pytest.mark.parametrize("first", range(RESTARTS + 2))
def test_before_the_first_step_every_death_counts(first: int) -> None:
    """One life that reached the router does not let a start that fails go on for longer."""
    restarts = Restarts()
    for k in range(RESTARTS + 1):
        assert not restarts.failed
        restarts.after_death(k >= first, float(k))
    assert restarts.failed


@pytest.mark.parametrize(("reached", "restarted"), [(True, RESTARTS), (False, 3 * RESTARTS)])
def test_an_agent_on_ray_is_ended_when_its_restarts_are_used_up(
    reached: bool, restarted: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ended: list[Any] = []
    ray = SimpleNamespace(kill=ended.append)
    folder = create(resolve(load("paper7")), tmp_path / "run")
    fleet = Fleet(SimpleNamespace(cluster=SimpleNamespace(ray=ray)), folder, lambda: None, print)  # type: ignore[arg-type]
    agent = _Placed("agent-1", "its actor", None)
    lines = ["looking for the plant", *([f"{READY}shard 0"] if reached else [])]
    for pid in range(restarted + 1):
        fleet._take(agent, "host", pid + 1, [])
        fleet._take(agent, "host", pid + 1, lines)
    assert not ended
    fleet._take(agent, "host", restarted + 2, [])
    assert ended == (["its actor"] if reached else [])
