"""A network of real processes in a test: launched, spoken to, killed and frozen, and gone at the end of its block.

Its processes hold on to the test by a pipe that ends with it, however that ends: `orchestrator up --lifeline`.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

import psutil

from hedgerow.orchestrator.launch.live import FaultVerbs, Healed, Injected, Live
from hedgerow.orchestrator.runs.registry import Entry
from hedgerow.orchestrator.testing.result import Result
from hedgerow.topologies.errors import Code, DeadlineError, HedgerowError, UserError
from hedgerow.topologies.faults import Fault
from hedgerow.topologies.regular_file import last_text
from hedgerow.topologies.resolve import to_yaml
from hedgerow.topologies.schema import Topology
from hedgerow.wire.session import WireError

START_DEADLINE_S = 60.0
END_DEADLINE_S = 20.0
WAIT_DEADLINE_S = 60.0
_LOOK_EVERY_S = 0.01


class _Up:
    """`orchestrator up` in a process of its own, whose run goes to a folder."""

    def __init__(self, topology: Topology, folder: Path, *options: str) -> None:
        self.folder = folder.resolve()
        self.said = self.folder.with_name(f"{folder.name}.log")
        beside = self.folder.with_name(f"{folder.name}.runtime")
        beside.mkdir()
        file = beside / "topology.yaml"
        file.write_text(to_yaml(topology), encoding="utf-8")
        command = [sys.executable, "-P", "-m", "hedgerow.orchestrator", "up", str(file), "--run-dir", str(self.folder)]
        with self.said.open("wb") as said:
            self.process = subprocess.Popen(
                [*command, "--viewer", "none", "--no-record", "--lifeline", *options],
                stdin=subprocess.PIPE,
                stdout=said,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # Ctrl-C is the test's
                env=os.environ | {"XDG_RUNTIME_DIR": str(beside)},  # nobody's `orchestrator stop` finds it
            )

    def wait(self, deadline_s: float) -> None:
        """Wait for its end; raises DeadlineError."""
        try:
            self.process.wait(deadline_s)
        except subprocess.TimeoutExpired:
            raise DeadlineError(f"{self.folder.name}: still runs after {deadline_s:g} s{self._last_words()}") from None

    def result(self) -> Result:
        """What it left; raises HedgerowError, in its own words, if it came to no verdict."""
        if not (self.folder / "verdict.json").exists():
            raise HedgerowError(f"{self.folder.name}: no verdict{self._last_words()}")
        return Result.read(self.folder)

    def _last_words(self) -> str:
        lines = last_text(self.said).splitlines()
        return "".join(f"\n    {line}" for line in lines[-8:])

    def entry(self) -> Entry:
        """How to reach its plant, once it has made its first step; raises DeadlineError or HedgerowError."""
        until = time.monotonic() + START_DEADLINE_S
        while "first_step" not in (events := {event["event"]: event for event in self.events()}):
            if self.process.poll() is not None:
                raise HedgerowError(f"{self.folder.name}: ended before its first step{self._last_words()}")
            if time.monotonic() > until:
                raise DeadlineError(f"{self.folder.name}: no step after {START_DEADLINE_S:g} s{self._last_words()}")
            time.sleep(_LOOK_EVERY_S)
        reach = events["start"]["endpoint"], events["start"]["namespace"]
        return Entry(self.folder.name, str(self.folder), self.process.pid, *reach, started=time.time())

    def events(self) -> list[dict[str, Any]]:
        from hedgerow.orchestrator.runs.files import load_events  # noqa: PLC0415 (Arrow takes a while to load)

        return load_events(self.folder)

    def processes(self) -> dict[str, int]:
        """Process ids of the plant and the agents that are there, by name: each holds a log of that name."""
        found = {}
        with contextlib.suppress(psutil.NoSuchProcess):
            for child in psutil.Process(self.process.pid).children(recursive=True):
                with contextlib.suppress(psutil.NoSuchProcess, psutil.AccessDenied):
                    logs = [Path(file.path) for file in child.open_files() if file.path.endswith(".log")]
                    found.update({log.stem: child.pid for log in logs if log.parent == self.folder / "logs"})
        return found

    def end(self) -> None:
        """Let go of it: it ends the run and its processes; killed if it does not."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        try:
            self.process.wait(END_DEADLINE_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()


def run_to_the_end(topology: Topology, folder: Path, deadline_s: float) -> Result:
    """What `orchestrator up` leaves; raises DeadlineError, or HedgerowError if it came to no verdict."""
    up = _Up(topology, folder)
    try:
        up.wait(deadline_s)
        return up.result()
    finally:
        up.end()


class Running:
    """A network that runs while a `with` block does: `with network("paper7").up() as net:`.

    Every wait raises DeadlineError past its deadline, and says what it waited for.
    """

    def __init__(
        self,
        topology: Topology,
        folder: Path,
        rate: float,
        step_deadline_s: float,
        on_result: Callable[[Result], None] = lambda _: None,
    ) -> None:
        self.topology, self.folder = topology, folder
        self._options = "--rate", str(rate), "--deadline", str(step_deadline_s)
        self._on_result = on_result
        self._frozen: set[int] = set()
        self._result: Result | None = None

    def __enter__(self) -> Running:
        self._up = _Up(self.topology, self.folder, *self._options)
        try:
            self._live = Live(self._up.entry()).__enter__()
        except BaseException:
            self._up.end()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._thaw()
        self._live.close()
        self._up.end()
        with contextlib.suppress(HedgerowError):
            self.wait()

    @property
    def fault(self) -> FaultVerbs[Injected]:
        """Faults to inject: `net.fault.drop((2, 4), steps=range(50))`, steps counted from the next that it makes."""
        return self._live.fault

    def inject(self, fault: Fault | Mapping[str, Any]) -> Injected:
        """Any fault, as a model of `hedgerow.topologies.faults` or as a file spells it; steps as in `fault`."""
        return self._live.inject(fault)

    def heal(self, number: int | None = None) -> Healed:
        """End a fault by its number, or all that can be ended."""
        return self._live.heal(number)

    def faults(self) -> dict[int, Fault]:
        """All faults by number, those of the file first; by steps of the run."""
        return self._live.faults()

    def status(self) -> dict[str, Any]:
        """`step` of `steps`, whether `running` and `paused`, the `rate`, who is `missing` and who is `lost`."""
        return self._live.status()

    def pause(self) -> int:
        """Make no step after this one; returns the first that is held."""
        return self._live.pause()

    def resume(self) -> int:
        """Go on; returns the step."""
        return self._live.resume()

    def step(self, steps: int = 1) -> int:
        """Make so many steps more and pause; returns the first of them, without waiting for it."""
        return self._live.step(steps)

    def rate(self, rate: float) -> int:
        """So many steps a second, 0 for as fast as possible; returns the step."""
        return self._live.rate(rate)

    def wait_for_step(self, step: int, deadline_s: float = WAIT_DEADLINE_S) -> int:
        """Wait until all steps before `step` are made; returns the step that the network is at."""
        return self._live.wait_for_step(step, deadline_s)

    def events(self) -> list[dict[str, Any]]:
        """What happened so far, a dict each, as events.jsonl has it."""
        return self._up.events()

    def wait_for_event(self, event: str, deadline_s: float = WAIT_DEADLINE_S) -> dict[str, Any]:
        """Wait for the first event of a name; returns it."""
        until = time.monotonic() + deadline_s
        while True:
            if found := [one for one in self.events() if one["event"] == event]:
                return found[0]
            if time.monotonic() > until:
                names = ", ".join(dict.fromkeys(one["event"] for one in self.events()))
                raise DeadlineError(
                    f"{self.folder.name}: no event {event!r} after {deadline_s:g} s; there were {names}"
                )
            time.sleep(_LOOK_EVERY_S)

    @property
    def processes(self) -> dict[str, int]:
        """Process ids by name: `plant`, and `agent-4` or, with several nodes each, `shard-0`."""
        return self._up.processes()

    def kill(self, name: str) -> None:
        """SIGKILL a process, as `processes` names it."""
        os.kill(self._pid(name), signal.SIGKILL)

    def freeze(self, name: str) -> None:
        """SIGSTOP a process: it is there, and does nothing."""
        pid = self._pid(name)
        self._frozen.add(pid)
        os.kill(pid, signal.SIGSTOP)

    def thaw(self, name: str) -> None:
        """SIGCONT a process that was frozen."""
        pid = self._pid(name)
        self._frozen.discard(pid)
        os.kill(pid, signal.SIGCONT)

    def _thaw(self) -> None:
        for pid in self._frozen & {*self.processes.values()}:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGCONT)

    def _pid(self, name: str) -> int:
        processes = self.processes
        if name not in processes:
            raise UserError(
                f"{name}: no such process; there are {', '.join(sorted(processes)) or 'none'}", code=Code.OPTION
            )
        return processes[name]

    def stop(self) -> Result:
        """End the run after the current step, and return what it leaves."""
        if self._result is None:
            with contextlib.suppress(WireError):  # it may have come to its end
                self._live.stop()
        return self.wait(END_DEADLINE_S)

    def wait(self, deadline_s: float = WAIT_DEADLINE_S) -> Result:
        """Wait for the end of the run, and return what it leaves."""
        if self._result is None:
            self._up.wait(deadline_s)
            self._result = self._up.result()
            self._on_result(self._result)
        return self._result
