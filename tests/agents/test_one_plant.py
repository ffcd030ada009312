"""One plant at a time in a namespace: the next one waits for its end, and each agent leaves with its own plant."""

from __future__ import annotations

import contextlib
import json
import queue
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from pathlib import Path
from typing import Any

import pytest
import zenoh

from hedgerow.agents.plant_watch import PlantWatch
from hedgerow.agents.process import Joined
from hedgerow.agents.standalone import PlaceRequest
from hedgerow.topologies.errors import Code, HedgerowError
from hedgerow.wire import keys
from hedgerow.wire.config import Config
from hedgerow.wire.handshake import room
from hedgerow.wire.session import direct, open_client, open_router
from tests.tools.processes import DEADLINE_S, Orchestrator, orchestrator
from tests.tools.refusals import refusal
from tests.tools.standalone import UP, bundle, endpoint, start

__all__ = ["endpoint", "start"]


def test_a_new_plant_ignores_agents_of_the_run_before(here: Path, endpoint: str, start: Any) -> None:
    """One agent process, elsewhere as all is: it is there when the second plant begins, and leaves."""
    bundle(endpoint, "--processes", "1", "--steps", "20")
    agent, plant = (("agents", "--config", "lab/shard-0.toml"), ("plant", "--config", "lab/plant.toml"))
    with open_router(endpoint):
        left_behind, first = start(*agent), start(*plant)
        left_behind.wait_for("ready")
        first.kill()
        with Orchestrator(
            *("up", "lab/topology.yaml", "--external", "plant,all", "--router", endpoint),
            *("--namespace", "hedgerow/paper7", *UP),
        ) as network:
            others = [start(*plant), start(*agent)]
            assert network.wait() == 0, network.output
            assert [other.wait()[0] for other in others] == [0, 0]
        code, printed = left_behind.wait()
    assert code == 3, printed


@pytest.mark.slow
def test_a_second_plant_waits_for_the_end_of_the_first(here: Path, endpoint: str, start: Any) -> None:
    bundle(endpoint, "--processes", "2", "--steps", "2000")
    up = ("up", "lab/topology.yaml", "--router", endpoint, "--namespace", "hedgerow/paper7", *UP)
    with open_router(endpoint), Orchestrator(*up, "--external", "1", "--rate", "10", "--run-dir", "first") as first:
        agent = start("agents", "--config", "lab/shard-0.toml")
        first.wait_for("running")
        by_hand = start("plant", "--config", "lab/plant.toml")
        with Orchestrator(*up, "--external", "all", "--run-dir", "second") as second:
            for one in (second, by_hand):
                one.wait_for("another plant already runs at hedgerow/paper7; waiting up to 30 s for its end")
            second.send(signal.SIGINT)
            by_hand.kill()
            assert second.wait() != 0
            assert "Ctrl-C" in second.output
            assert orchestrator("rate", "0").returncode == 0
            assert first.wait() == 0, first.output
            assert agent.wait()[0] == 0
    assert json.loads(Path("first/verdict.json").read_text())["checks"]["reference"]["ok"]


def test_a_plant_that_stays_has_its_place_to_itself(here: Path, endpoint: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hedgerow.wire.handshake.LEASE_S", 0.1)
    with open_router(endpoint), open_client(endpoint, "here") as one, open_client(endpoint, "here") as other:
        token = one.liveliness().declare_token(keys.alive(keys.PLANT, 7))
        with (
            refusal(Code.REFUSED),
            room(other, "here", list[str]().append),
        ):
            raise AssertionError("the block was entered")
        messages: list[str] = []
        monkeypatch.setattr("hedgerow.wire.handshake.LEASE_S", DEADLINE_S)

        def say(text: str) -> None:
            messages.append(text)
            token.undeclare()

        with room(other, "here", say):
            assert messages == ["another plant already runs at here; waiting up to 60 s for its end"]


def test_of_simultaneous_plants_one_starts_and_the_next_follows(endpoint: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """This holds for any numbers that they draw, and for any order of their checks."""
    monkeypatch.setattr("hedgerow.wire.handshake.LOOK_AGAIN_S", 0.01)
    monkeypatch.setattr("hedgerow.wire.handshake.LEASE_S", DEADLINE_S)
    together, inside, order = threading.Barrier(4), threading.Lock(), list[int]()

    def begin(who: int) -> None:
        with open_client(endpoint, "here") as session:
            together.wait(DEADLINE_S)
            with room(session, "here", list[str]().append):
                assert inside.acquire(blocking=False)
                order.append(who)
                list(session.liveliness().get(keys.alive("nobody", "*")))  # a while, as long as a look
                inside.release()

    with open_router(endpoint), ThreadPoolExecutor(4) as pool:
        list(pool.map(begin, range(4)))
    assert sorted(order) == [0, 1, 2, 3]


@pytest.mark.slow
def test_of_two_networks_that_begin_at_once_in_one_place_the_second_waits(here: Path, endpoint: str) -> None:
    up = (
        "up",
        "paper7",
        "--router",
        endpoint,
        "--namespace",
        "hedgerow/paper7",
        *UP,
        "--external",
        "1",
        "--rate",
        "50",
    )
    with open_router(endpoint), contextlib.ExitStack() as stack, ThreadPoolExecutor() as pool:
        two = [stack.enter_context(Orchestrator(*up, "--run-dir", name)) for name in ("one", "other")]
        goes_on = {pool.submit(network.wait_for, "waiting for agent-1"): network for network in two}
        done, _ = wait(goes_on, return_when=FIRST_COMPLETED)
        (first,) = (goes_on.pop(one) for one in done)
        ((in_the_end, other),) = goes_on.items()
        other.wait_for("another plant already runs at hedgerow/paper7")
        assert not in_the_end.done()
        first.send(signal.SIGINT)
        assert first.wait() == 3, first.output
        in_the_end.result(DEADLINE_S)
        other.send(signal.SIGINT)
        assert other.wait() == 3, other.output


def test_an_agent_that_waits_for_its_place_continues_when_the_plant_leaves(endpoint: str) -> None:
    """The first plant leaves without an answer, as after a kill; the next one gives the place."""
    place = PlaceRequest(Config("agent-3", "here", endpoint, "N", {}), 2, DEADLINE_S)

    with open_router(endpoint), open_client(endpoint, "here") as session, ThreadPoolExecutor() as pool:
        joined, left = pool.submit(place.take, session), []
        for number in (7, 8):
            with open_client(endpoint, "here") as plant:
                asked = queue.Queue[zenoh.Query]()
                declared = plant.declare_queryable(keys.join("*"), direct(asked.put))
                token = plant.liveliness().declare_token(keys.alive(keys.PLANT, number))
                left.append(asked.get(timeout=DEADLINE_S))
                if number == 8:
                    left[-1].reply(keys.join(2), json.dumps({"life": 4, "plant": number}))
                    left.pop()  # the log shows that it was the only answer
                    assert joined.result(DEADLINE_S) == Joined(4, number)
                del declared, token


@pytest.fixture
def watched(
    endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> Iterator[tuple[zenoh.Session, zenoh.Session, queue.Queue[HedgerowError]]]:
    """Provide sessions of an agent of plant 7 and of another process, and the error of the first."""
    monkeypatch.setattr("hedgerow.agents.plant_watch.PLANT_GONE_S", 0.1)
    with open_router(endpoint), open_client(endpoint, "here") as session, open_client(endpoint, "here") as other:
        yield session, other, queue.Queue()


def plant(session: zenoh.Session, number: int) -> Any:
    return session.liveliness().declare_token(keys.alive(keys.PLANT, number))


@pytest.mark.parametrize("it_was_there", [True, False])
def test_an_agent_with_a_lost_plant_ends_with_its_name(watched: Any, it_was_there: bool) -> None:
    session, other, why = watched
    token = plant(other, 7) if it_was_there else None
    with PlantWatch(session, 7, why.put):
        if token is not None:
            token.undeclare()
        assert str(why.get(timeout=DEADLINE_S)).startswith("the plant is gone: not seen for 0.1 s")


def test_an_agent_leaves_for_another_plant_only_once_its_own_is_gone(
    watched: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hedgerow.agents.plant_watch.PLANT_GONE_S", DEADLINE_S)
    session, other, why = watched
    stale, ours = plant(other, 6), plant(other, 7)
    with PlantWatch(session, 7, why.put):
        by_mistake = plant(other, 8)
        stale.undeclare()
        ours.undeclare()
        assert str(why.get(timeout=DEADLINE_S)).startswith("another run has begun here, and we are of the one before")
        by_mistake.undeclare()
