"""Our end of the fork server: told to start processes, it says who runs and who has ended.

It is started before anything else of a command, so that it loads while we do: nothing heavy is imported here.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Sequence
from pathlib import Path

from topologies.errors import DeadlineError
from wire.runtime import runtime_environment

FORK_DEADLINE_S = 30.0
END_DEADLINE_S = 5.0


class Nursery:
    """Our end of `orchestrator.fork_server`: who it forked, and who of them has ended."""

    def __init__(self) -> None:
        held, self._lifeline = os.pipe()
        # -P: a folder called `agents` in the user's working directory is not ours.
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "orchestrator.fork_server", str(held)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            pass_fds=(held,),
            env=os.environ | runtime_environment() | {"PYTHONUNBUFFERED": "1"},
            start_new_session=True,
        )
        os.close(held)
        self.pids: dict[str, int] = {}
        self.codes: dict[str, int] = {}
        self._closing = False
        self._changed = threading.Condition()
        self._listener = threading.Thread(target=self._listen, name="nursery", daemon=True)
        self._listener.start()

    def _listen(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            said = json.loads(line)
            with self._changed:
                (self.pids if "pid" in said else self.codes)[said["name"]] = said.get("pid", said.get("code"))
                self._changed.notify_all()
        with self._changed:
            if not self._closing:
                self.codes["nursery"] = self._process.wait() or 1
            self._changed.notify_all()

    def fork(self, name: str, module: str, arguments: Sequence[str], log: Path) -> None:
        """Have `python -m MODULE ARGUMENTS` run in a process of its own, which logs to `log`."""
        told = {"name": name, "module": module, "arguments": list(arguments), "log": str(log)}
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(told).encode() + b"\n")
        self._process.stdin.flush()

    def wait_until_forked(self, names: Sequence[str]) -> None:
        """Return once all of them run; raise DeadlineError past the deadline."""
        with self._changed:
            ok = self._changed.wait_for(lambda: set(names) <= self.pids.keys() or self.codes, FORK_DEADLINE_S)
        if not ok:
            raise DeadlineError(f"no process of its own for {names[0]} after {FORK_DEADLINE_S:g} s")

    def wait(self, timeout_s: float) -> None:
        """Wait until all who were forked have ended, at most so long."""
        with self._changed:
            self._changed.wait_for(lambda: self.pids.keys() <= self.codes.keys() | {"nursery"}, timeout_s)

    def close(self) -> None:
        """End whoever is still there, at once, and the nursery; return when all are gone."""
        with self._changed:
            self._closing = True
            left = [self.pids[name] for name in self.pids.keys() - self.codes.keys()]
        for pid in left:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        if left:
            self.wait(END_DEADLINE_S)
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):
            self._process.stdin.close()
        try:
            self._process.wait(END_DEADLINE_S)
        except subprocess.TimeoutExpired:  # it was frozen
            self._process.kill()
            self._process.wait()
        self._listener.join()
        with contextlib.suppress(OSError):
            os.close(self._lifeline)
