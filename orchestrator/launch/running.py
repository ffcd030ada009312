"""A network of real processes that this process has started: controlled, interrupted, and ended with its block.

`orchestrator up --lifeline` runs it. Its standard input is a pipe from this process, so the network ends with this
process, for any reason.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any

import psutil

from hedgerow.orchestrator.launch.live import Live
from hedgerow.orchestrator.runs.files import load_events
from hedgerow.orchestrator.runs.reader import load_run
from hedgerow.orchestrator.runs.registry import Entry
from hedgerow.orchestrator.runs.run import Run
from hedgerow.topologies.errors import Code, DeadlineError, Exit, HedgerowError, UserError
from hedgerow.topologies.paths import real_path
from hedgerow.topologies.regular_file import last_text
from hedgerow.topologies.resolve import save
from hedgerow.topologies.schema import Topology
from hedgerow.wire.session import WireError

START_DEADLINE_S = 60.0
END_DEADLINE_S = 20.0
WAIT_DEADLINE_S = 60.0
_LOOK_EVERY_S = 0.01


class UpProcess:
    """A process that runs `orchestrator up` for one topology and run folder."""

    def __init__(self, topology: Topology, folder: Path, *options: str, listed: bool = True) -> None:
        """Start it. `options` are those of `up`. A network that is not `listed` is hidden from `orchestrator ps`."""
        self.folder = real_path(folder)
        # The scratch folder of a hidden network stays beside its run folder, where its test can look at it.
        self._temporary = Path(tempfile.mkdtemp(prefix="hedgerow-up-")) if listed else None
        self._scratch = self._temporary or self.folder.with_name(f"{self.folder.name}.runtime")
        self._scratch.mkdir(exist_ok=True)
        self._output = self._scratch / "output.log"
        file = self._scratch / "topology.yaml"
        save(topology, file)
        command = [sys.executable, "-P", "-m", "hedgerow.orchestrator", "up", str(file), "--run-dir", str(self.folder)]
        with self._output.open("wb") as output:
            self.process = subprocess.Popen(
                [*command, "--lifeline", "--plain", *options],
                stdin=subprocess.PIPE,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # Ctrl-C reaches this process alone, which then ends the network
                env=os.environ | _paths(topology) | ({} if listed else {"XDG_RUNTIME_DIR": str(self._scratch)}),
            )

    def wait(self, deadline_s: float | None) -> None:
        """Wait for its end, without a limit if `deadline_s` is None. Raises DeadlineError."""
        try:
            self.process.wait(deadline_s)
        except subprocess.TimeoutExpired:
            raise DeadlineError(f"{self.folder.name}: still runs after {deadline_s:g} s{self._last_lines()}") from None

    def run(self) -> Run:
        """Return the finished run. Raises UserError if `up` refused it, and HedgerowError if there is no verdict."""
        if not (self.folder / "verdict.json").exists():
            raise self._failure("no verdict")
        run = load_run(self.folder)
        if len(run.lost):
            raise HedgerowError(f"{run.name}: the telemetry of {len(run.lost)} steps was lost")
        return run

    def _failure(self, how: str) -> HedgerowError:
        """Return the error for a network that ended without a run; a mistake of the user has the message of `up`."""
        if self.process.poll() == Exit.USER_MISTAKE:
            refused = last_text(self._output).strip()
            return UserError(refused.removeprefix("error: "), code=Code.OPTION)
        return HedgerowError(f"{self.folder.name}: {how}{self._last_lines()}")

    def _last_lines(self) -> str:
        lines = last_text(self._output).splitlines()
        return "".join(f"\n    {line}" for line in lines[-8:])

    def entry(self) -> Entry:
        """Wait for the first step, and return how to reach the plant. Raises DeadlineError or HedgerowError."""
        until = time.monotonic() + START_DEADLINE_S
        while "first_step" not in (events := {event["event"]: event for event in load_events(self.folder)}):
            if self.process.poll() is not None:
                raise self._failure("ended before its first step")
            if time.monotonic() > until:
                raise DeadlineError(f"{self.folder.name}: no step after {START_DEADLINE_S:g} s{self._last_lines()}")
            time.sleep(_LOOK_EVERY_S)
        reach = events["start"]["endpoint"], events["start"]["namespace"]
        return Entry(self.folder.name, str(self.folder), self.process.pid, *reach, started=time.time())

    def processes(self) -> dict[str, int]:
        """Return the process ids of the plant and the agents by name; each process holds a log of its name open."""
        found = {}
        with contextlib.suppress(psutil.NoSuchProcess):
            for child in psutil.Process(self.process.pid).children(recursive=True):
                with contextlib.suppress(psutil.NoSuchProcess, psutil.AccessDenied):
                    logs = [Path(file.path) for file in child.open_files() if file.path.endswith(".log")]
                    found.update({log.stem: child.pid for log in logs if log.parent == self.folder / "logs"})
        return found

    def end(self) -> None:
        """Close the pipe, which ends the run and its processes; kill the process if that fails."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        try:
            self.process.wait(END_DEADLINE_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        if self._temporary is not None:
            shutil.rmtree(self._temporary, ignore_errors=True)


def _paths(topology: Topology) -> dict[str, str]:
    """Return the variable with which processes find a law of the user where this process found it.

    The law may be a file beside the script that runs, or in a folder of tests. It may import files of other folders.
    """
    if ":" not in topology.law:
        return {}
    installed = {sys.prefix, sys.base_prefix, sys.exec_prefix, sys.base_exec_prefix}
    own = [
        path
        for path in sys.path
        if path and os.pathsep not in path and not any(Path(path).is_relative_to(one) for one in installed)
    ]
    given = os.environ.get("PYTHONPATH")
    return {"PYTHONPATH": os.pathsep.join([*own, *([given] if given else [])])} if own else {}


def run_to_the_end(
    topology: Topology, folder: Path, *options: str, deadline_s: float | None = None, listed: bool = True
) -> Run:
    """Run `orchestrator up` to its end and return the run; arguments and errors are those of UpProcess."""
    up = UpProcess(topology, folder, *options, listed=listed)
    try:
        up.wait(deadline_s)
        return up.run()
    finally:
        up.end()


class Running(Live):
    """A network of real processes that runs while a `with` block does.

    Every wait raises DeadlineError past its deadline, with the reason.
    """

    def __init__(
        self,
        topology: Topology,
        folder: Path,
        *options: str,
        listed: bool = True,
        on_run: Callable[[Run], object] = lambda _: None,
    ) -> None:
        """Prepare `orchestrator up` with some options; the block starts it. `on_run` receives the finished run."""
        self.topology = topology
        """the resolved network as it started"""
        self._folder, self._options, self._listed, self._on_run = folder, options, listed, on_run
        self._frozen: set[int] = set()
        self._finished: Run | None = None

    def __repr__(self) -> str:
        how = "ended" if self._finished is not None else "running" if hasattr(self, "entry") else "not started"
        return f"<Running {self.topology.name}: {len(self.topology.nodes)} nodes, {how}>"

    def __enter__(self) -> Running:
        self._up = UpProcess(self.topology, self._folder, *self._options, listed=self._listed)
        try:
            super().__init__(self._up.entry())
            super().__enter__()
        except BaseException:
            self._up.end()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._thaw()
        self.close()
        judged: HedgerowError | None = None
        try:
            # Read the verdict before end() removes the output that explains a missing one.
            with contextlib.suppress(OSError):
                self._up.process.stdin.close()  # type: ignore[union-attr]
            self.wait(END_DEADLINE_S)
        except HedgerowError as failure:
            judged = failure if failure.code == Code.VERDICT else None
        finally:
            self._up.end()
        if judged is not None and error is None:
            raise judged

    @property
    def folder(self) -> Path:
        """The run folder."""
        return self._folder

    def events(self) -> list[dict[str, Any]]:
        """Return the events so far, as in events.jsonl."""
        return load_events(self._folder)

    def wait_for_event(self, event: str, deadline_s: float = WAIT_DEADLINE_S) -> dict[str, Any]:
        """Wait for the first event of a name, and return it."""
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
        """Process ids by name: `plant`, and `agent-4` or, with several nodes per process, `shard-0`."""
        return self._up.processes()

    def kill(self, name: str) -> None:
        """Send SIGKILL to a process, named as in `processes`."""
        os.kill(self._pid(name), signal.SIGKILL)

    def freeze(self, name: str) -> None:
        """Send SIGSTOP to a process: it exists and does nothing."""
        pid = self._pid(name)
        self._frozen.add(pid)
        os.kill(pid, signal.SIGSTOP)

    def thaw(self, name: str) -> None:
        """Send SIGCONT to a process that was frozen."""
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
            known = ", ".join(sorted(processes)) or "none"
            raise UserError(f"{name}: no such process; there are {known}", code=Code.OPTION)
        return processes[name]

    def stop(self, deadline_s: float = END_DEADLINE_S) -> Run:
        """End the run after the current step, and return it."""
        if self._finished is None:
            with contextlib.suppress(WireError):  # the run may have ended already
                self.ask_to_stop()
        return self.wait(deadline_s)

    def wait(self, deadline_s: float = WAIT_DEADLINE_S) -> Run:
        """Wait for the end of the run, and return it."""
        if self._finished is None:
            self._up.wait(deadline_s)
            self._finished = self._up.run()
            self._on_run(self._finished)
        return self._finished
