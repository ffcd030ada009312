"""Where agents and plants come from: a process that has loaded what they need, and forks one when it is told to.

A fork costs a few milliseconds and shares memory; an interpreter of one's own, with numpy and Zenoh, costs a
quarter of a second. The fork server itself opens no session, knows no topology, and has one thread.

On its standard input it is told, a line of JSON each, `{"name", "module", "arguments", "log"}`, and `{"leave"}`: files
and folders. When that input ends, whatever ended its parent, it ends its remaining children, frozen or not,
removes these, and ends. On its standard output it says `{"name", "pid"}` when a process runs, and `{"name", "code"}`
when it has ended. Its first argument is the descriptor of the lifeline that its children hold (wire.child).
"""

from __future__ import annotations

import contextlib
import gc
import json
import os
import select
import signal
import socket
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NoReturn

import hedgerow.agents.process
import hedgerow.plant.process
from hedgerow.topologies.errors import Exit
from hedgerow.wire import crash, start
from hedgerow.wire.child import ERROR_PREFIX
from hedgerow.wire.limits import limit_reached
from hedgerow.wire.runtime import share_the_cores
from hedgerow.wire.session import remove_trace

PROGRAMS: dict[str, Callable[[Sequence[str]], NoReturn]] = {
    "agents": hedgerow.agents.process.main,
    "plant": hedgerow.plant.process.main,
}


IGNORE_SIGINT = "--ignore-sigint"
"""An argument: the processes of the run ignore SIGINT, as the command did when it was started."""


def main() -> None:
    """Fork on demand until standard input ends."""
    # What was loaded without an error has no more to say: let go of whatever our parent's standard error is.
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    gc.freeze()  # what is loaded stays as it is: the collector need not touch, and so copy, shared pages
    lifeline = int(sys.argv[1])
    names: dict[int, str] = {}
    # A child's end wakes the select below through this pair.
    wakes, woken = socket.socketpair()
    woken.setblocking(False)
    signal.set_wakeup_fd(woken.fileno())
    signal.signal(signal.SIGCHLD, lambda *_: None)
    heard, leave = b"", list[str]()
    while True:
        ready, _, _ = select.select([0, wakes.fileno()], [], [])
        if wakes.fileno() in ready:
            wakes.recv(4096)
            _reap(names)
        if 0 in ready:
            more = os.read(0, 65536)
            if not more:
                _end(names, leave)
                return
            *lines, heard = (heard + more).split(b"\n")
            for line in lines:
                told = json.loads(line)
                if "leave" in told:
                    leave = told["leave"]
                    continue
                try:
                    pid = os.fork()
                except OSError as error:
                    _fail(told, error)
                    continue
                if pid == 0:
                    _become(told, lifeline)
                names[pid] = told["name"]
                _say(name=told["name"], pid=pid)


def _fail(told: dict[str, Any], error: OSError) -> None:
    """Report a process that could not be forked as one that ended at once, with the cause in its log."""
    with contextlib.suppress(OSError), open(told["log"], "a", encoding="utf-8") as log:
        log.write(f"{ERROR_PREFIX}{limit_reached(error) or error}\n")
    _say(name=told["name"], code=int(Exit.UNKNOWN))


def _end(pids: Iterable[int], leave: Sequence[str]) -> None:
    """Nobody of ours lives on; and only then, for a plant may just be making its socket, is it removed."""
    for pid in pids:
        os.kill(pid, signal.SIGKILL)
    for pid in pids:
        os.waitpid(pid, 0)
    for path in leave:
        remove_trace(path)


def _reap(names: dict[int, str]) -> None:
    while names:
        pid, status = os.waitpid(-1, os.WNOHANG)
        if pid == 0:
            return
        _say(name=names.pop(pid), code=os.waitstatus_to_exitcode(status))


def _say(**what: Any) -> None:
    with contextlib.suppress(BrokenPipeError):  # our parent is gone: standard input ends, too
        os.write(1, json.dumps(what).encode() + b"\n")


def _become(told: dict[str, Any], lifeline: int) -> NoReturn:
    """In the child: a session and a log of its own, the lifeline as standard input; then the program, for good."""
    signal.set_wakeup_fd(-1)
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)  # the fork server handles it
    if IGNORE_SIGINT not in sys.argv:  # the fork server ignores it in any case
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    share_the_cores()
    os.setsid()  # a Ctrl-C in the terminal is the parent's to handle
    log = os.open(told["log"], os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    for descriptor, source in ((0, lifeline), (1, log), (2, log)):
        os.dup2(source, descriptor)
    os.closerange(3, 256)
    with contextlib.suppress(OSError):  # where there is a /proc, `ps` and `top` call it by its name
        Path("/proc/self/comm").write_text(told["name"], encoding="utf-8")
    PROGRAMS[told["module"]](told["arguments"])


def whole() -> NoReturn:
    """Run `main`, and tell our parent what ended it."""
    code = Exit.VALID
    try:
        start.begin()
        main()
    except BaseException as error:
        reached = limit_reached(error)
        _say(error=str(reached or crash.report(error)))
        code = Exit.CRASH if reached is None else Exit.UNKNOWN
    os._exit(code)


if __name__ == "__main__":
    whole()
