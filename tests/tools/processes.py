"""Running the `orchestrator` command in tests: to its end, or alive and watched."""

from __future__ import annotations

import contextlib
import functools
import io
import itertools
import json
import os
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import psutil

from hedgerow.orchestrator.cli.exit_code import run_to_exit_code
from hedgerow.orchestrator.cli.main import app
from hedgerow.orchestrator.launch.live import Live
from tests.tools import preloaded

COMMAND = (sys.executable, "-P", "-m", "hedgerow.orchestrator")
DEADLINE_S = 60.0
QUIET = ("--viewer", "none", "--no-record")
LONG = ("up", "paper7", "--steps", "1000000", "--rate", "200", *QUIET)


def orchestrator(*arguments: str, largest: int = resource.RLIM_INFINITY) -> subprocess.CompletedProcess[str]:
    """Run the command to its end; no file of it, or of its processes, grows past `largest` bytes: the disk is full."""
    if preloaded.suits():
        return preloaded.SESSION.run(arguments, DEADLINE_S * 3, largest=largest)
    return subprocess.run(
        [*COMMAND, *arguments],
        capture_output=True,
        text=True,
        timeout=DEADLINE_S * 3,
        check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest)),
    )


def run_here(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a command in this process: one that is refused starts no other process."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = run_to_exit_code(lambda: app([*arguments], standalone_mode=False) or 0)
    return subprocess.CompletedProcess([*arguments], code, out.getvalue(), err.getvalue())


def parquet_bytes(folder: Path) -> tuple[bytes, ...]:
    """The tables of a run, byte for byte."""
    return tuple((folder / f"{name}.parquet").read_bytes() for name in ("telemetry", "edges", "summary"))


def gone(processes: Mapping[str, int], within_s: float = DEADLINE_S) -> bool:
    """Return True if all these processes end within the time; a zombie has ended."""
    deadline = time.monotonic() + within_s
    pause = threading.Event()
    while left := [pid for pid in processes.values() if _runs(pid)]:
        if time.monotonic() > deadline:
            return False
        pause.wait(0.01)
    return not left


def _runs(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


class Orchestrator:
    """A running command; the end of the block kills it if it still runs."""

    def __init__(self, *arguments: str, inside: Sequence[str] = ()) -> None:
        """`inside` is a command that runs other commands elsewhere."""
        self._process: subprocess.Popen[str] | preloaded.Process
        if inside or not preloaded.suits():
            self._process = subprocess.Popen(
                [*inside, *COMMAND, *arguments],
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                start_new_session=True,
            )
        else:
            reads, writes = os.pipe()
            stdout = open(reads, encoding="utf-8")  # noqa: SIM115 (the end of the block closes it)
            self._process = preloaded.SESSION.start(arguments, (0, writes, writes), new_session=True, stdout=stdout)
            os.close(writes)
        self._output = ""
        self._changed = threading.Condition()
        self._ended = False
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()

    def _listen(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            with self._changed:
                self._output += line
                self._changed.notify_all()
        with self._changed:
            self._ended = True
            self._changed.notify_all()

    @property
    def output(self) -> str:
        """Return the output so far, of both streams."""
        return self._output

    def wait_for(self, text: str) -> None:
        """Wait until `text` appears."""
        with self._changed:
            assert self._changed.wait_for(lambda: text in self._output or self._ended, DEADLINE_S), self._output
            assert text in self._output, self._output

    def wait_until(self, is_true: Callable[[], bool]) -> None:
        """Wait until a condition outside the program is true."""
        deadline, pause = time.monotonic() + DEADLINE_S, threading.Event()
        while not is_true():
            assert time.monotonic() < deadline, self.output
            pause.wait(0.005)

    def wait_for_event(self, kind: str, times: int = 1) -> dict[str, Any]:
        """Wait until the latest run's events.jsonl has `times` events of a kind; return the last of them."""
        deadline = time.monotonic() + DEADLINE_S
        pause = threading.Event()
        while len(found := _events(kind)) < times:
            assert self._process.poll() is None or self.output, self.output
            assert time.monotonic() < deadline, f"{len(found)} of {times} events {kind!r} in {_events()}"
            pause.wait(0.01)
        return found[-1]

    def wait_for_step(self, step: int) -> None:
        """Wait until the latest run has reached this step."""
        deadline, pause = time.monotonic() + DEADLINE_S, threading.Event()
        with Live() as live:
            while live.status()["step"] < step:
                assert time.monotonic() < deadline, self.output
                pause.wait(0.01)

    def wait_for_log(self, name: str, text: str, times: int = 1) -> None:
        """Wait until a process of the latest run has logged `text` so often."""
        log = Path(os.getcwd()) / f"runs/latest/logs/{name}.log"
        deadline = time.monotonic() + DEADLINE_S
        pause = threading.Event()
        while log.read_text(encoding="utf-8").count(text) < times:
            assert time.monotonic() < deadline, log.read_text(encoding="utf-8")
            pause.wait(0.01)

    @property
    def children(self) -> dict[str, int]:
        """Return the ids of the latest processes of plant and agents by name."""
        pids: dict[str, int] = dict(_events()[0]["pids"])
        again = {event["process"]: event["pid"] for event in _events() if event["event"] == "restarted"}
        return pids | again

    @property
    def pid(self) -> int:
        """Return the process id of the command itself."""
        return self._process.pid

    def send(self, number: int) -> None:
        """Send the command's own process a signal."""
        self._process.send_signal(number)

    def kill_until_it_stays_down(self, name: str) -> None:
        """Kill an agent's process repeatedly, each life after it has reached the router, until no other one follows.

        A plant that is too slow to see a life before its death grants another restart.
        """
        for life in itertools.count(1):
            self.wait_for_log(name, "ready: ", life)
            os.kill(self.children[name], signal.SIGKILL)
            self.wait_for_event("died", life)
            self.wait_until(functools.partial(self._is_decided, life))
            if self._stays_down():
                return

    def _is_decided(self, life: int) -> bool:
        """Return True once another life has followed this one, or none will."""
        return self._stays_down() or len(_events("restarted")) == life

    def _stays_down(self) -> bool:
        return bool(_events("down")) or self._process.poll() is not None

    def kill_all_who_could_clean_up(self) -> dict[str, int]:
        """Kill the command, its fork server and the plant at once, and return all processes of the run."""
        children = self.children
        last = (psutil.Process(children["plant"]).ppid(), children["plant"])
        for pid in last:
            os.kill(pid, signal.SIGSTOP)
        self.send(signal.SIGKILL)
        for pid in last:
            os.kill(pid, signal.SIGKILL)
        return children

    def wait(self, timeout_s: float = DEADLINE_S) -> int:
        """The exit code, once it has ended and all its output is here."""
        code = self._process.wait(timeout_s)
        with self._changed:
            assert self._changed.wait_for(lambda: self._ended, timeout_s)
        return code

    def __enter__(self) -> Orchestrator:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()
        self._listener.join(DEADLINE_S)
        assert not self._listener.is_alive(), "another process still holds the output of an ended command"
        assert self._process.stdout is not None
        self._process.stdout.close()


def _events(kind: str = "") -> list[dict[str, Any]]:
    """The events of the latest run, all or those of one kind."""
    log_file = Path(os.getcwd()) / "runs/latest/events.jsonl"
    lines = log_file.read_text(encoding="utf-8").splitlines() if log_file.exists() else []
    events = [json.loads(line) for line in lines if line.endswith("}")]
    return [event for event in events if kind in ("", event["event"])]
