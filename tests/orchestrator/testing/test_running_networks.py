"""Networks of real processes in the fixture `network`: control, faults, and no remaining process."""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import psutil
import pytest

from hedgerow.orchestrator.runs import registry
from hedgerow.orchestrator.testing import Networks
from hedgerow.topologies.errors import Code
from tests.tools.refusals import refusal

pytest_plugins = ["pytester"]

ALONE = ("-p", "no:cacheprovider", "-p", "no:hypothesispytest")
"""The options of a pytest in a separate process, without slow and unrelated plugins."""

EVERYTHING = (
    {"kind": "drop", "link": [2, 4], "probability": 0.4},
    {"kind": "delay", "from": 4, "to": 6, "by": 2, "steps": [3, 20]},
    {"kind": "cut", "edge": [3, 5], "steps": [6, 9]},
    {"kind": "partition", "groups": [[1, 2], [3, 4]], "steps": [9, 13]},
    {"kind": "sensor", "node": 3, "steps": [5, 9], "probability": 0.5},
    {"kind": "actuator", "node": 7, "steps": [12, 15]},
    {"kind": "crash", "node": 6, "at": 8, "restart_after": 4},
    {"kind": "crash", "process": 1, "at": 20, "restart_after": 3},
    {"kind": "jump", "node": 5, "at": 15, "a": "random"},
)


@pytest.mark.parametrize("processes", [None, 3])
def test_both_engines_give_the_same_bits(network: Networks, processes: int | None) -> None:
    """All kinds of faults are in the run, for one process per node and for three processes."""
    scenario = network("paper7").set(f"faults={json.dumps(EVERYTHING)}")
    if processes:
        scenario = scenario.set(f"processes={processes}")
    real, reference = scenario.run(engine="zenoh"), scenario.run()
    assert real == reference
    assert (real.received == reference.received).all()
    assert (real.edge_open == reference.edge_open).all()
    assert real.verdict.content["engine"] == "zenoh"
    assert real.verdict.content["processes"] == (processes or 7)
    assert real.verdict.content["restarts"] == 2 if processes is None else 1


def processes_of(folder: Path) -> list[psutil.Process]:
    """Return every process of runs in this folder or below it; their registry is beside the run."""
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error, OSError):  # it ends while it is looked at
            inside = process.environ().get("XDG_RUNTIME_DIR", "").startswith(str(folder.resolve()))
            if inside and process.status() != psutil.STATUS_ZOMBIE:
                found.append(process)
    return found


def wait_until(holds: Callable[[], bool], what: str, within_s: float = 60.0) -> None:
    """Return once it holds; fail by name past the deadline."""
    until = time.monotonic() + within_s
    pause = threading.Event()
    while not holds():
        assert time.monotonic() < until, f"{what}: not after {within_s:g} s"
        pause.wait(0.1)


ALL_OF_PAPER7 = 11
"""`up`, the relay of its standard error, the fork server, the plant and seven agents."""


def test_a_run_that_takes_too_long_is_ended_and_named(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    with refusal(Code.DEADLINE):
        Networks(lambda _: folder)("paper7").run(engine="zenoh", steps=10**6, deadline_s=2)
    assert folder.with_name("run.runtime").exists(), "what is looked for has another name now"
    wait_until(lambda: processes_of(folder) == [], "all are gone")  # a process that was still loading ends a bit later


def test_both_engines_report_a_law_that_cannot_be_loaded(network: Networks) -> None:
    engines: tuple[Literal["in-process"], Literal["zenoh"]] = "in-process", "zenoh"
    for engine in engines:
        with refusal(Code.LAW):
            network("paper7", "law=no.such:Law").run(engine=engine)


@pytest.mark.slow
def test_a_network_is_spoken_to_while_it_runs(network: Networks) -> None:
    """Faults by call, a real SIGKILL and a real freeze; and the same course again from its folder, to the bit."""
    with network("paper7", "seed=3").up(rate=200, step_deadline_s=3.0) as net:
        assert {*net.processes} == {"plant", *(f"agent-{k}" for k in range(1, 8))}
        assert net.folder.name not in [entry.run for entry in registry.running()], "no other user may stop it"
        lost = net.fault.drop((2, 4), steps=range(20))
        with refusal(Code.FAULT, "drop: link"):
            net.fault.drop((2, 5))
        cut = net.fault.cut((1, 2))
        assert (lost.number, cut.number) == (1, 2)
        net.wait_for_step(cut.step + 10)
        healed = net.heal(2)
        assert healed.numbers == (2,)

        before = net.processes["agent-6"]
        net.kill("agent-6")
        assert net.wait_for_event("lost")["who"] == "agent 6"
        net.wait_for_event("back")
        assert net.processes["agent-6"] != before

        net.freeze("agent-4")
        wait_until(lambda: net.status()["lost"] == ["agent 4"], "agent 4 is lost")
        net.wait_for_step(net.status()["step"] + 10)
        net.thaw("agent-4")
        wait_until(lambda: net.status()["lost"] == [], "agent 4 is back")
        with refusal(Code.OPTION, "agent-9"):
            net.kill("agent-9")
        with refusal(Code.DEADLINE):
            net.wait_for_event("flood", deadline_s=0.1)
        net.wait_for_step(net.status()["step"] + 10)
        assert [fault.kind for fault in net.faults().values()] == ["drop", "cut", "crash", "crash"]
        run = net.stop()

    assert processes_of(net.folder) == []
    assert run.missing((2, 4))[:20] == [*range(lost.step, lost.step + 20)]
    assert {*range(cut.step, healed.step)}.isdisjoint(run.open((1, 2)))
    assert run.verdict.content["restarts"] == 1
    again = network(run.folder).run(steps=run.steps)
    assert again == run
    assert (again.received == run.received).all()


def test_the_clock_of_a_network_is_the_tests(network: Networks) -> None:
    """A paused network makes exactly the requested steps."""
    with network("paper7").up(processes=3) as net:
        assert {*net.processes} == {"plant", "shard-0", "shard-1", "shard-2"}
        at = net.pause()
        net.wait_for_step(at)
        net.step(7)
        net.wait_for_step(at + 7)
        status = net.status()
        assert (status["step"], status["paused"]) == (at + 7, True)
        run = net.stop()
    assert run.steps == at + 7


def test_a_network_may_come_to_its_end(network: Networks) -> None:
    with network("paper7").up(steps=None) as net:
        assert net.wait_for_step(30) == 30
        assert net.wait().steps == 30
        with refusal(Code.UNKNOWN):
            net.wait_for_step(31)
    assert net.stop() == network("paper7").run()


def test_nothing_of_a_network_remains_after_its_test_fails(network: Networks) -> None:
    """This includes a frozen agent, which cannot notice that all others have ended."""
    net = network("paper7").up(rate=50)

    def test_that_fails() -> None:
        with net:
            net.freeze("agent-4")
            assert len(processes_of(net.folder)) == ALL_OF_PAPER7
            assert net.status()["paused"], "nobody paused it"

    with pytest.raises(AssertionError, match="nobody paused it"):
        test_that_fails()
    assert processes_of(net.folder) == []


WAITING = {
    "up": "with network('paper7').up(rate=50) as net: net.wait_for_step(900_000, deadline_s=600)",
    "run": "network('paper7').run(engine='zenoh', steps=10**6, deadline_s=600)",
}


@pytest.mark.slow
@pytest.mark.parametrize(("body", "how"), [("up", signal.SIGINT), ("run", signal.SIGKILL)])
def test_nothing_remains_after_pytest_is_interrupted_or_killed(
    pytester: pytest.Pytester, body: str, how: signal.Signals
) -> None:
    pytester.makepyfile(f"def test_that_waits(network):\n    {WAITING[body]}\n")
    command = [sys.executable, "-m", "pytest", "-q", *ALONE, f"--basetemp={pytester.path / 'runs'}"]
    process = subprocess.Popen(command, cwd=pytester.path, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        wait_until(lambda: len(processes_of(pytester.path)) == ALL_OF_PAPER7, "the network runs")
        process.send_signal(how)
        explained, _ = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == (2 if how is signal.SIGINT else -how), explained
    wait_until(lambda: processes_of(pytester.path) == [], "all are gone")


@pytest.mark.slow
def test_tests_may_run_in_parallel(pytester: pytest.Pytester) -> None:
    """Networks of one name run in two workers of pytest-xdist, and wait for each other."""
    pytester.makepyfile(
        """
        import pathlib, time
        import pytest

        @pytest.mark.parametrize(("mine", "other", "steps"), [("a", "b", 5), ("b", "a", 9)])
        def test_every_network_is_its_own(network, mine, other, steps):
            with network("paper7").up(rate=200) as net:
                pathlib.Path(mine).touch()
                until = time.monotonic() + 60
                while not pathlib.Path(other).exists():
                    assert time.monotonic() < until
                    net.wait_for_step(net.status()["step"] + 1)
                lost = net.fault.drop((2, 4), steps=range(steps))
                net.wait_for_step(lost.step + 20)
                run = net.stop()
            assert run.missing((2, 4)) == [*range(lost.step, lost.step + steps)]
            assert network(run.folder).run(steps=run.steps) == run
        """
    )
    ran = pytester.runpytest_subprocess("-q", "-n", "2", *ALONE)
    ran.assert_outcomes(passed=2)
    assert processes_of(pytester.path) == []
