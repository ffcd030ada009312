"""Separate agents: the run waits for them by name, checks their versions, and takes them back when they die.

Each runs as `agent` or `plant` does on another machine, with the file of `orchestrator bundle` alone.
"""

from __future__ import annotations

import contextlib
import json
import queue
import re
import shutil
import signal
import socket
import subprocess
import sys
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
from tests.tools.processes import DEADLINE_S, Orchestrator, gone, orchestrator, parquet_bytes, run_here
from tests.tools.refusals import refusal

UP = ("--viewer", "none", "--no-record", "--verify")


class Started:
    """A process of a run that `up` did not start."""

    def __init__(self, module: str, *arguments: str) -> None:
        program = f"from hedgerow.{module}.standalone import main; main()"
        self.process = subprocess.Popen(
            [sys.executable, "-P", "-c", program, *arguments], stderr=subprocess.PIPE, text=True
        )

    def wait(self) -> tuple[int, str]:
        """Its exit code and its log, once it has ended."""
        _, printed = self.process.communicate(timeout=DEADLINE_S)
        return self.process.returncode, printed

    def wait_for(self, text: str) -> None:
        """Read its log until this text."""
        assert self.process.stderr is not None
        assert any(text in line for line in self.process.stderr), text


@pytest.fixture
def start() -> Iterator[Any]:
    """Start agents and plants; those that still run at the end are killed."""
    with contextlib.ExitStack() as stack:

        def one(module: str, *arguments: str) -> Started:
            started = Started(module, *arguments)
            stack.enter_context(started.process)
            stack.callback(started.process.kill)
            return started

        yield one


@pytest.fixture
def endpoint(here: Path) -> str:
    """Where a run is reached: a socket, so that tests never meet on a port."""
    return f"unixsock-stream/{here}/lab.sock"


def bundle(endpoint: str, *arguments: str) -> None:
    done = orchestrator("bundle", "paper7", "--out", "lab", "--router", endpoint, *arguments)
    assert done.returncode == 0, done.stderr


def verdict() -> dict[str, Any]:
    found: dict[str, Any] = json.loads(Path("runs/latest/verdict.json").read_text())
    return found


def test_two_agents_started_elsewhere_change_nothing(here: Path, endpoint: str, start: Any) -> None:
    bundle(endpoint)
    agents = [start("agents", "--config", f"lab/agent-{name}.toml") for name in (3, 5)]
    with Orchestrator("up", "paper7", "--external", "3, agent-5", "--listen", endpoint, *UP) as network:
        assert network.wait() == 0, network.output
        assert network.children.keys() == {"plant", *(f"agent-{name}" for name in (1, 2, 4, 6, 7))}
    assert verdict()["checks"]["reference"]["ok"]
    assert [agent.wait()[0] for agent in agents] == [0, 0]


def test_all_processes_separate_except_the_observer(here: Path, endpoint: str, start: Any) -> None:
    bundle(endpoint, "--processes", "2", "--steps", "20")
    with open_router(endpoint):
        with Orchestrator(
            "up",
            "lab/topology.yaml",
            "--external",
            "plant,all",
            "--router",
            endpoint,
            "--namespace",
            "hedgerow/paper7",
            *UP,
        ) as network:
            network.wait_for("waiting for plant, shard-0, shard-1")
            others = [start("plant", "--config", "lab/plant.toml")]
            others += [start("agents", "--config", f"lab/shard-{p}.toml") for p in (0, 1)]
            assert network.wait() == 0, network.output
            assert network.children == {}
        assert [one.wait()[0] for one in others] == [0, 0, 0]
    assert orchestrator("simulate", "lab/topology.yaml", "--run-dir", "here", "--no-record").returncode == 0
    assert parquet_bytes(Path("here")) == parquet_bytes(Path("runs/latest"))


def test_a_restarted_agent_continues_at_the_current_step(here: Path, endpoint: str, start: Any) -> None:
    bundle(endpoint, "--steps", "300")
    arguments = ("agents", "--config", "lab/agent-3.toml")
    first = start(*arguments)
    with Orchestrator(
        "up", "paper7", "--steps", "300", "--rate", "100", "--external", "3", "--listen", endpoint, *UP
    ) as network:
        network.wait_for("running")
        second = start(*arguments)
        second.wait_for("agent 3 is there already")
        first.process.send_signal(signal.SIGKILL)
        network.wait_for("going on without agent 3: its process died")
        network.wait_for("agent 3 is back")
        assert network.wait() == 0, network.output
    assert verdict()["verdict"] == "valid"
    assert verdict()["checks"]["reference"]["ok"]
    assert second.wait()[0] == 0


def test_a_planned_crash_of_an_agent_elsewhere_ends_no_process(here: Path, endpoint: str, start: Any) -> None:
    crash = "faults=[{kind: crash, node: 3, at: 5, restart_after: 5}]"
    bundle(endpoint, "--set", crash)
    agent = start("agents", "--config", "lab/agent-3.toml")
    with Orchestrator("up", "paper7", "--set", crash, "--external", "3", "--listen", endpoint, *UP) as network:
        assert network.wait() == 0, network.output
    assert verdict()["checks"]["reference"]["ok"]
    assert agent.wait()[0] == 0


def test_another_release_and_another_network_are_refused_at_both_ends(here: Path, endpoint: str, start: Any) -> None:
    bundle(endpoint, "--seed", "8")
    old = (
        "import hedgerow.wire.handshake as h; h.release = lambda _: '0.0.1';"
        "from hedgerow.agents.standalone import main; main()"
    )
    with Orchestrator("up", "paper7", "--external", "3", "--listen", endpoint, "--wait", "30", *UP) as network:
        network.wait_for("waiting for agent-3")
        code, printed = start("agents", "--config", "lab/agent-3.toml").wait()
        assert code == 2
        assert "agent-3: network " in printed
        assert "`orchestrator bundle`" in printed, "the fix is a command"
        done = subprocess.run(
            [sys.executable, "-P", "-c", old, "--config", "lab/agent-3.toml"],
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 2
        assert "hedgerow 0.0.1" in done.stderr
        network.wait_for("agent 3 is refused: hedgerow 0.0.1 there, ")
        network.send(signal.SIGINT)
        network.wait()


def test_an_agent_that_a_killed_run_left_behind_makes_room_for_the_next(here: Path, endpoint: str, start: Any) -> None:
    bundle(endpoint, "--steps", "300")
    command = ("up", "lab/topology.yaml", "--external", "3", "--listen", endpoint, *UP)
    left_behind = start("agents", "--config", "lab/agent-3.toml")
    with Orchestrator(*command, "--rate", "5") as network:
        network.wait_for("running")
        children = network.children
        network.send(signal.SIGKILL)
        network.wait()
    assert gone(children)
    with Orchestrator(*command) as network:
        code = left_behind.wait()[0]
        assert code == 3
        again = start("agents", "--config", "lab/agent-3.toml")
        assert network.wait() == 0, network.output
        assert again.wait()[0] == 0
    assert verdict()["verdict"] == "valid"
    assert verdict()["checks"]["reference"]["ok"]


def test_an_agent_that_waits_at_the_end_of_a_run_does_not_join_the_next(here: Path, endpoint: str, start: Any) -> None:
    def up(seed: int) -> Orchestrator:
        bundle(endpoint, "--seed", str(seed))
        return Orchestrator("up", "lab/topology.yaml", "--external", "3,5", "--listen", endpoint, *UP)

    with up(1) as network:
        of_seed_1 = start("agents", "--config", "lab/agent-3.toml")
        of_seed_1.wait_for("has its place")
        network.send(signal.SIGINT)
        network.wait()
    shutil.rmtree("lab")
    with up(2) as network:
        others = [start("agents", "--config", f"lab/agent-{name}.toml") for name in (5, 3)]
        assert network.wait() == 0, network.output
        assert [one.wait()[0] for one in others] == [0, 0]
    # It was refused; or, where that run was over before it asked, it waits for the next.
    of_seed_1.process.terminate()
    assert "ready" not in of_seed_1.wait()[1]
    assert verdict()["checks"]["reference"]["ok"]


def test_one_of_two_agents_for_one_place_gets_it(here: Path, endpoint: str, start: Any) -> None:
    bundle(endpoint)
    with Orchestrator("up", "lab/topology.yaml", "--external", "3,5", "--listen", endpoint, *UP) as network:
        twice = [start("agents", "--config", "lab/agent-3.toml") for _ in range(2)]
        network.wait_for("waiting for agent-3")
        for one in twice:
            one.wait_for("looking for")
        five = start("agents", "--config", "lab/agent-5.toml")
        assert network.wait() == 0, network.output
        assert five.wait()[0] == 0
    assert verdict()["verdict"] == "valid"
    assert verdict()["checks"]["information"]["ok"], "every received message was sent"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["int", "term"])
def test_a_plant_that_must_end_sends_end_to_all(here: Path, endpoint: str, start: Any, number: int) -> None:
    bundle(endpoint, "--processes", "2", "--steps", "100000")
    up = ("up", "lab/topology.yaml", "--external", "plant,all", "--router", endpoint, "--namespace", "hedgerow/paper7")
    with open_router(endpoint), Orchestrator(*up, "--viewer", "none", "--no-record") as network:
        plant = start("plant", "--config", "lab/plant.toml", "--rate", "20")
        agents = [start("agents", "--config", f"lab/shard-{p}.toml") for p in (0, 1)]
        network.wait_for("running")
        plant.process.send_signal(number)
        assert network.wait() == 3, network.output
        assert [one.wait()[0] for one in (plant, *agents)] == [0, 0, 0]
    assert re.search(r"unknown \(stopped at step [1-9][0-9]*: stopped on request\)", network.output), network.output


def test_a_new_plant_ignores_agents_of_the_run_before(here: Path, endpoint: str, start: Any) -> None:
    """One agent process, elsewhere as all is: it is there when the second plant begins, and leaves."""
    bundle(endpoint, "--processes", "1", "--steps", "20")
    agent, plant = (("agents", "--config", "lab/shard-0.toml"), ("plant", "--config", "lab/plant.toml"))
    with open_router(endpoint):
        left_behind, first = start(*agent), start(*plant)
        left_behind.wait_for("ready")
        first.process.kill()
        with Orchestrator(
            *("up", "lab/topology.yaml", "--external", "plant,all", "--router", endpoint),
            *("--namespace", "hedgerow/paper7", *UP),
        ) as network:
            others = [start(*plant), start(*agent)]
            assert network.wait() == 0, network.output
            assert [other.wait()[0] for other in others] == [0, 0]
        code, printed = left_behind.wait()
    assert code == 3, printed


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)], ids=["int", "term"])
@pytest.mark.parametrize(("module", "config"), [("agents", "agent-1"), ("plant", "plant")])
def test_a_process_that_waits_for_a_router_ends_on_request(
    here: Path, start: Any, module: str, config: str, number: int, code: int
) -> None:
    """Another program has the port, and never answers."""
    with socket.create_server(("127.0.0.1", 0)) as mute:
        mute.settimeout(DEADLINE_S)
        bundle(f"tcp/127.0.0.1:{mute.getsockname()[1]}")
        waiting = start(module, "--config", f"lab/{config}.toml")
        waiting.wait_for("looking for")
        connection, _ = mute.accept()
        with connection:
            waiting.process.send_signal(number)
            assert waiting.wait()[0] == code


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
            by_hand.process.kill()
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


@pytest.mark.parametrize(("form", "protocol"), [((), "tcp"), (("--secure",), "tls")], ids=["open", "secure"])
def test_a_bundle_uses_one_port_for_operator_and_agents(here: Path, form: tuple[str, ...], protocol: str) -> None:
    bundle(f"{protocol}/localhost:8123", *form)
    printed = Path("lab/README.md").read_text()
    assert printed.count(f"--listen {protocol}/0.0.0.0:8123") == 2
    assert "7447" not in printed


@pytest.mark.parametrize(
    ("arguments", "option"),
    [
        (("up", "paper7", "--router", "bench"), "--router bench"),
        (("up", "paper7", "--external", "3", "--listen", "bench:7447"), "--listen bench:7447"),
        (("bundle", "paper7", "--router", "bench", "--out", "lab"), "--router bench"),
    ],
)
def test_an_invalid_endpoint_is_refused_at_once(here: Path, arguments: tuple[str, ...], option: str) -> None:
    done = run_here(*arguments)
    assert done.returncode == 2
    assert done.stderr == f"error: {option}: is no endpoint; write tcp/HOST:PORT, or tls/HOST:PORT\n"
    assert [*here.glob("[!.]*")] == []


def test_a_certificate_names_no_address_in_brackets(here: Path) -> None:
    """Zenoh would try for ever."""
    done = run_here("keys", "paper7", "--out", "lab", "--router", "tls/[::1]:7447")
    assert done.returncode == 2
    assert done.stderr.startswith("error: --router tls/[::1]:7447: ")
    assert [*here.glob("[!.]*")] == []


@pytest.mark.parametrize(
    "words",
    [
        "up paper7 --router tcp/bench:0",
        "up paper7 --external 3 --listen tcp/0.0.0.0:65536",
        "bundle paper7 --out lab --router tcp/bench",
        "keys paper7 --out lab --router tls/bench:99999",
    ],
)
def test_a_port_is_from_1_to_65535(here: Path, words: str) -> None:
    done = run_here(*words.split())
    assert done.returncode == 2
    assert done.stderr == f"error: {' '.join(words.split()[-2:])}: write a port from 1 to 65535 after the host\n"
    assert [*here.glob("[!.]*")] == []


@pytest.mark.parametrize("namespace", ["", "a//b", "a/**", "a#b"])
@pytest.mark.parametrize("command", ["up", "bundle --out lab", "compose"])
def test_a_namespace_is_a_key_without_wildcards(here: Path, command: str, namespace: str) -> None:
    done = run_here(*command.split(), "paper7", "--namespace", namespace)
    assert done.returncode == 2
    assert done.stderr.startswith(f"error: --namespace {namespace}: is no key of Zenoh's; ")
    assert [*here.glob("[!.]*")] == []


@pytest.mark.parametrize(
    ("module", "option", "number"),
    [
        *(("agents", "--wait", number) for number in ("nan", "inf", "-1", "0")),
        ("plant", "--wait", "nan"),
        ("plant", "--deadline", "nan"),
        *(("plant", "--rate", number) for number in ("nan", "-5")),
        *(("up", option, "nan") for option in ("--rate", "--deadline", "--wait")),
        ("up", "--wait", "0"),
        ("compose", "--rate", "nan"),
    ],
)
def test_seconds_and_rates_are_numbers_that_can_be_waited_for(
    here: Path, start: Any, module: str, option: str, number: str
) -> None:
    if module in ("up", "compose"):
        done = run_here(module, "paper7", option, number)
        code, printed = done.returncode, done.stderr
    else:
        code, printed = start(module, option, number).wait()
    assert code == 2
    assert option in printed
    assert number in printed
    assert [*here.glob("[!.]*")] == []


def test_a_missing_process_is_named(here: Path, endpoint: str) -> None:
    with Orchestrator("up", "paper7", "--external", "3,5", "--listen", endpoint, "--wait", "2", *UP) as network:
        assert network.wait() == 3, network.output
    assert "agent 3, agent 5" in network.output


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("--external", "9"), "--external 9: "),
        (("--external", "3"), "--listen tcp/0.0.0.0:7447"),
        (("--external", "plant"), "--external plant: "),
        (("--listen", "tcp/0.0.0.0:7447"), "--external"),
    ],
)
def test_impossible_options_are_refused_at_once(here: Path, arguments: tuple[str, ...], named: str) -> None:
    done = run_here("up", "paper7", *arguments)
    assert done.returncode == 2
    assert named in done.stderr


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", "lab.toml: "),
        ("a = ", "lab.toml: "),
        ('process = "agent-3"\nnamespace = "h"\nrouter = "tcp/x:1"\nnetwork = "0"\n', "config of agent-3: "),
        ('process = "plant"\nnamespace = "h"\nrouter = "tcp/x:1"\nnetwork = "0"\n', "`hedgerow-plant`"),
        (None, "`orchestrator bundle`"),
    ],
)
def test_a_wrong_file_is_a_mistake_and_no_traceback(here: Path, start: Any, text: str | None, named: str) -> None:
    if text is not None:
        Path("lab.toml").write_text(text)
    for check in ((), ("--check",)):
        code, log = start("agents", "--config", "lab.toml", *check).wait()
        assert code == 2, log
        assert named in log
        assert "Traceback" not in log
