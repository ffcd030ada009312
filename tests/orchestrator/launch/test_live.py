"""Control of a running network: the requests, the answers, and their record in the run."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hedgerow.orchestrator.cli import main as cli
from hedgerow.orchestrator.launch.live import Live, checked, groups, pair
from hedgerow.topologies.describe import describe
from hedgerow.topologies.effects import FOREVER
from hedgerow.topologies.errors import Code, TopologyError, UserError
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from hedgerow.topologies.schema import Topology
from tests.tools.networks import read
from tests.tools.processes import Orchestrator, orchestrator
from tests.tools.refusals import refusal

LINE = "{name: line, b: 0.1, steps: 9, nodes: [1, 2, 3, a-b, c], edges: [[1, 2], [2, 3], [3, a-b], [a-b, c]]}"


def named(*nodes: str) -> Topology:
    """Return a ring of nodes with these names."""
    ring = [[i, j] for i, j in zip(nodes, [*nodes[1:], nodes[0]], strict=True)][: len(nodes) if len(nodes) > 2 else 1]
    return read(json.dumps({"name": "ring", "b": 0.1, "steps": 3, "nodes": list(nodes), "edges": ring}))


@pytest.mark.parametrize(
    ("text", "meant"),
    [("1-2", (1, 2)), ("2-1", (2, 1)), ("3-a-b", (3, "a-b")), ("a-b-c", ("a-b", "c")), ("a-b,c", ("a-b", "c"))],
)
def test_two_nodes_are_named_as_a_person_names_them(text: str, meant: tuple[Any, Any]) -> None:
    assert pair(text, read(LINE)) == meant


@pytest.mark.parametrize("text", ["2-9", "2,9", "a-x-c", "12"])
def test_an_unknown_name_is_reported(text: str) -> None:
    with refusal(Code.OPTION, text):
        pair(text, read(LINE))


def test_a_name_of_two_readings_is_asked_about() -> None:
    topology = named("a", "b-c", "a-b", "c")  # a ring: a to b-c, and a-b to c, are edges both
    with refusal(Code.OPTION):
        pair("a-b-c", topology)
    assert pair("a,b-c", topology) == ("a", "b-c")


def reading(text: str, topology: Topology) -> tuple[Any, Any] | str:
    """Return the result of `pair`: the two nodes, or the question."""
    try:
        return pair(text, topology)
    except UserError as error:
        return str(error)


NAMES = st.text("ab-", min_size=1, max_size=4).filter(lambda name: name[0] != "-")


@given(names=st.lists(NAMES, min_size=2, max_size=5, unique=True))
def test_every_edge_can_be_named(names: list[str]) -> None:
    """With a '-' it is found or asked about, never mistaken for another; with a comma it is found."""
    topology = named(*names)
    for i, j in topology.pairs:
        assert pair(f"{i},{j}", topology) == (i, j)
        read_as = reading(f"{i}-{j}", topology)
        assert read_as == (i, j) or f"{i},{j}" in read_as


def test_groups_are_named_with_commas_and_a_slash() -> None:
    assert groups("1,2/3,a-b,c", read(LINE)) == [[1, 2], [3, "a-b", "c"]]
    with refusal(Code.OPTION):
        groups("1,2/9", read(LINE))


WORDS: dict[str, dict[str, Any]] = {
    "drop 2-4 from step 10 to 20": {"kind": "drop", "link": [2, 4], "steps": [10, 20]},
    "drop 2->4 with probability 0.3 at every step": {"kind": "drop", "from": 2, "to": 4, "probability": 0.3},
    "drop of 3 by a table from step 10 to 13": {"kind": "drop", "at": {10: [[2, 4], [4, 2]], 12: [[2, 4]]}},
    "delay 2-4 by 3 at every step": {"kind": "delay", "link": [2, 4], "by": 3},
    "cut 2-4 from step 10 to 20": {"kind": "cut", "edge": [2, 4], "steps": [10, 20]},
    "partition 1,2,3/4,5 with its edges from step 1 to 2": {
        "kind": "partition", "groups": [[1, 2, 3], [4, 5]], "steps": [1, 2], "cut": True,
    },
    "sensor 3 from step 5": {"kind": "sensor", "node": 3, "steps": [5, FOREVER]},
    "actuator 3 with probability 0.5 from step 5 to 9": {
        "kind": "actuator", "node": 3, "steps": [5, 9], "probability": 0.5,
    },
    "crash 4 from step 12 to 17": {"kind": "crash", "node": 4, "at": 12, "restart_after": 5},
    "crash process 2 from step 12": {"kind": "crash", "process": 2, "at": 12},
    "jump 4 to 0.3 from step 15": {"kind": "jump", "node": 4, "at": 15, "a": 0.3},
}  # fmt: skip


def paper7() -> Topology:
    return resolve(load("paper7", ["nodes.4={a: 0.6, candidates: [0.3, 0.6]}"]))


@pytest.mark.parametrize("words", WORDS)
def test_a_fault_in_a_few_words(words: str) -> None:
    assert describe(checked(WORDS[words], paper7())) == words


@pytest.mark.parametrize(
    "entry",
    [
        {"kind": "drop", "link": [2, 5]},
        {"kind": "drop", "link": [2, 9]},
        {"kind": "drop", "link": [2, 4], "from": 2},
        {"kind": "drop", "link": [2, 4], "steps": [5, 5]},
        {"kind": "drop", "link": [2, 4], "probability": 1.5},
        {"kind": "dorp", "link": [2, 4]},
        {"link": [2, 4]},
        {"kind": "cut", "at": {3: [[1, 7], [2, 4]]}},
        {"kind": "delay", "link": [2, 4]},
        {"kind": "partition", "groups": [[1, 2], [2, 3]]},
        {"kind": "crash", "process": 7, "at": 1},
        {"kind": "jump", "node": 4, "at": 1, "a": 0.5},
        {"kind": "sensor", "node": 4, "stepz": [1, 2]},
    ],
    ids=json.dumps,
)
def test_a_mistake_of_a_file_has_the_same_message_in_a_live_fault(entry: dict[str, Any]) -> None:
    with pytest.raises(UserError) as here:
        checked(entry, paper7())
    with pytest.raises(TopologyError) as there:
        resolve(load("paper7", ["nodes.4={a: 0.6, candidates: [0.3, 0.6]}", f"faults={json.dumps([entry])}"]))
    kind = entry.get("kind", "fault")
    printed = [str(problem).removeprefix("fault 1").removeprefix(": ") for problem in there.value.problems]
    assert str(here.value).splitlines() == [f"{kind}: {one}" for one in printed]


# Over a real network.


@pytest.fixture
def running(here: Path) -> Iterator[Orchestrator]:
    """paper7 running for ever, past its first step."""
    candidates = "nodes.4={a: 0.6, candidates: [0.3, 0.6]}"
    options = ("--steps", "1000000", "--rate", "200", "--viewer", "none", "--no-record", "--set", candidates)
    with Orchestrator("up", "paper7", *options) as network:
        network.wait_for("running")
        yield network


def say(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Return the output of the command; raise the exception that the command line would print as an error."""
    capsys.readouterr()
    assert (cli.app(list(arguments), standalone_mode=False) or 0) == 0
    return capsys.readouterr().out


def json_of(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    answer: dict[str, Any] = json.loads(say(capsys, *arguments, "--json"))
    return answer


def listed(capsys: pytest.CaptureFixture[str], key: str, wanted: list[Any], within_s: float = 60.0) -> list[Any]:
    """One thing of every fault in the list, once it is as wanted: the file is written a moment after the answer."""
    until = time.monotonic() + within_s
    pause = threading.Event()
    while (found := [fault[key] for fault in json_of(capsys, "fault", "list")["faults"]]) != wanted:
        if time.monotonic() > until:
            break
        pause.wait(0.05)
    return found


INJECTED: list[tuple[str, dict[str, Any]]] = [
    ("drop 2-4 --for 50", {"kind": "drop", "link": [2, 4], "steps": [0, 50]}),
    ("drop 2-4 --one-way --probability 0.3 --after 5", {
        "kind": "drop", "from": 2, "to": 4, "steps": [5, FOREVER], "probability": 0.3,
    }),
    ("delay 2-4 --by 3 --after 5 --for 5", {"kind": "delay", "link": [2, 4], "by": 3, "steps": [5, 10]}),
    ("cut 2-4", {"kind": "cut", "edge": [2, 4]}),
    ("partition 1,2,3,5/4,6,7 --cut --for 3", {
        "kind": "partition", "groups": [[1, 2, 3, 5], [4, 6, 7]], "steps": [0, 3], "cut": True,
    }),
    ("sensor 3 --for 4", {"kind": "sensor", "node": 3, "steps": [0, 4]}),
    ("actuator 3 --for 4", {"kind": "actuator", "node": 3, "steps": [0, 4]}),
    ("crash 5 --restart-after 5", {"kind": "crash", "node": 5, "at": 0, "restart_after": 5}),
    ("crash --process 6 --restart-after 2 --after 9", {"kind": "crash", "process": 6, "at": 9, "restart_after": 2}),
    ("jump 4 --to 0.3", {"kind": "jump", "node": 4, "at": 0, "a": 0.3}),
]  # fmt: skip


def shifted(entry: dict[str, Any], by: int) -> dict[str, Any]:
    """Return the same fault `by` steps later."""
    if "at" in entry:
        return entry | {"at": entry["at"] + by}
    return entry | {"steps": [min(t + by, FOREVER) for t in entry["steps"]] if "steps" in entry else [by, FOREVER]}


@pytest.mark.slow
def test_every_fault_comes_by_command_and_the_run_can_be_repeated(
    running: Orchestrator, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each is acknowledged with its number and step, listed, and written to the file; the folder gives the same run."""
    expected = []
    for number, (command, entry) in enumerate(INJECTED, start=1):
        answer = json_of(capsys, "fault", *command.split())
        assert answer["fault"] == number
        begins = entry["at"] if "at" in entry else entry.get("steps", [0])[0]
        expected.append(shifted(entry, answer["step"] - begins))
        assert answer["entry"] == expected[-1]
    steps = [entry["at"] if "at" in entry else entry["steps"][0] for entry in expected]
    healed = json_of(capsys, "heal", "4")
    assert healed["faults"] == [4]
    expected[3]["steps"][1] = healed["step"]
    with Live() as live:
        live.wait_for_step(max(steps) + 20)
        rest = live.heal()
        assert rest.numbers == (2,)
        expected[1]["steps"][1] = rest.step
        live.wait_for_step(rest.step + 10)
    assert listed(capsys, "entry", expected) == expected
    (line,) = [line.split() for line in say(capsys, "fault", "list").splitlines() if line.split()[0] == "6"]
    assert {"over", "sensor", "3", f"{steps[5]}", f"{steps[5] + 4}"} <= set(line)

    stopped = orchestrator("stop")
    assert stopped.returncode == 0, stopped.stderr
    verdict = json.loads((here / "runs/latest/verdict.json").read_text())
    events = [json.loads(line) for line in (here / "runs/latest/events.jsonl").read_text().splitlines()]
    assert [event["entry"] for event in events if event["event"] == "fault"][3]["kind"] == "cut"
    again = orchestrator(
        "simulate", "runs/latest", "--no-record", "--run-dir", "again", "--steps", str(verdict["steps_done"])
    )
    assert again.returncode == 0, again.stdout + again.stderr
    assert (here / "again/telemetry.parquet").read_bytes() == (here / "runs/latest/telemetry.parquet").read_bytes()


def test_a_command_reports_its_effect_or_its_refusal(
    running: Orchestrator, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    printed = say(capsys, "fault", "drop", "2-4", "--for", "50000", "--run", "paper7")
    run, step = printed.partition(":")[0], int(printed.split()[-3])
    assert run == Path("runs/latest").resolve().name
    assert printed == f"{run}: fault 1: drop 2-4 from step {step} to {step + 50000}\n"
    assert say(capsys, "fault", "heal", "1").startswith(f"{run}: fault 1 healed from step ")
    assert say(capsys, "heal") == f"{run}: no fault to heal\n"
    with refusal(Code.FAULT):
        say(capsys, "heal", "7")
    with refusal(Code.FAULT):
        say(capsys, "fault", "drop", "2-5")
    with refusal(Code.FAULT):
        say(capsys, "fault", "jump", "4", "--to", "0.4")
    with refusal(Code.NETWORK_MISSING) as unknown:
        say(capsys, "fault", "list", "--run", "nobody")
    assert run in str(unknown.value), "it lists the runs that exist"
    say(capsys, "fault", "cut", "2-4", "--after", "100000")
    say(capsys, "fault", "actuator", "3")
    assert listed(capsys, "when", now := ["over", "to come", "now"]) == now

    refused = orchestrator("fault", "sensor", "9")
    assert (refused.returncode, refused.stdout) == (2, "")
    assert refused.stderr == "error: sensor: node: 9 is no node; the nodes are 1, 2, 3, 4, 5, 6, 7\n"


def test_the_clock_is_held_and_let_go(running: Orchestrator, here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A paused network makes only the requested steps; a wait for more has a deadline, and then names the network."""
    assert say(capsys, "rate", "0").endswith("\n")
    at = json_of(capsys, "pause")["step"]
    with Live() as live:
        live.wait_for_step(at)
        assert json_of(capsys, "step", "5")["run"] == live.run
        assert live.wait_for_step(at + 5) == at + 5
        with refusal(Code.DEADLINE):
            live.wait_for_step(at + 6, deadline_s=0.2)
        assert say(capsys, "status").startswith(f"{live.run}: step {at + 5} of 1000000, paused\n")
        say(capsys, "resume")
        live.wait_for_step(at + 50)
        with refusal(Code.OPTION):
            live.wait_for_step(1000001)
        live.stop()
        with refusal(Code.UNKNOWN):
            live.wait_for_step(1000000)
    assert running.wait() == 3


def test_commands_without_a_running_network(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for command in ("pause", "resume", "step", "heal", "rate 5", "fault list", "fault drop 1-2"):
        with refusal(Code.NETWORK_MISSING):
            say(capsys, *command.split())


def test_a_future_fault_cannot_be_healed(running: Orchestrator, here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The fault is in the file as it was given, and the file can be read."""
    cut = json_of(capsys, "fault", "cut", "2-4", "--after", "500000")
    with Live() as live:
        with refusal(Code.FAULT):
            live.heal(1)
        assert live.heal().numbers == ()
        live.stop()
    assert running.wait() == 3
    (fault,) = load("runs/latest").faults
    assert list(fault.written()["steps"]) == cut["entry"]["steps"] == [cut["step"], FOREVER]
