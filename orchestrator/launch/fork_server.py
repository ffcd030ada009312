"""The source of agents and plants: a process that has loaded their modules, and forks one on demand.

A fork costs a few milliseconds and shares memory; a new interpreter with numpy and Zenoh costs a quarter of a second.
The fork server opens no session, knows no topology, and has one thread.

Its standard input has one JSON object per line: `{"name", "module", "arguments", "log"}`, or `{"leave"}` with files and
folders to remove. When that input ends, for any reason, it kills its remaining children, removes these files and
folders, and ends. Its standard output has `{"name", "pid"}` for a started process, and `{"name", "code"}` for an ended
one. Its first argument is the descriptor of the lifeline that its children hold (wire.child).
"""

from __future__ import annotations

import gc

if __name__ == "__main__":
    gc.disable()  # it would traverse the loaded objects again and again; `main` enables it

import argparse
import contextlib
import functools
import json
import logging
import os
import select
import signal
import socket
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import numpy as np

import hedgerow.agents.laws.minimax  # most agents need it, and a fork shares it
import hedgerow.agents.process
import hedgerow.plant.process
from hedgerow.agents.law_source import need_source
from hedgerow.agents.shard import Shard
from hedgerow.agents.view import Peer, View
from hedgerow.topologies.errors import Exit
from hedgerow.topologies.graph import Index
from hedgerow.wire import crash, start
from hedgerow.wire.child import ERROR_PREFIX, open_log
from hedgerow.wire.codec import decode_state, encode_state, pack_link
from hedgerow.wire.limits import limit_reached
from hedgerow.wire.message import ALL_UP, Flag, Span
from hedgerow.wire.runtime import let_numbers_overflow, share_the_cores
from hedgerow.wire.session import remove_trace


class Program(NamedTuple):
    """A program of a run."""

    options: argparse.ArgumentParser
    run: Callable[[argparse.Namespace], NoReturn]


PROGRAMS = {
    "agents": Program(hedgerow.agents.process.options(), hedgerow.agents.process.run),
    "plant": Program(hedgerow.plant.process.options(), hedgerow.plant.process.run),
}


WARM_ROUNDS, WARM_STEPS, WARM_GAPS = 8, 8, 4
"""Starts of an agent before the first fork, and its steps: the general path makes the first ones, floats the last ones.

In the last `WARM_GAPS` steps, link messages are lost or arrive late.

Python rewrites a function that has been called a few times. In a child, that would copy its memory.
"""
IGNORE_SIGINT = "--ignore-sigint"
"""An argument: the processes of the run ignore SIGINT, as the command did at its start."""


def main() -> None:
    """Fork on demand until standard input ends."""
    # Release the standard error of our parent: the loaded modules have no more messages.
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    let_numbers_overflow()
    open_log()
    for _ in range(WARM_ROUNDS):
        _warm_up()
    gc.freeze()  # freeze the loaded objects: the collector would touch, and so copy, shared pages
    gc.enable()
    lifeline = int(sys.argv[1])
    names: dict[int, str] = {}
    # The end of a child wakes the select below through this pair.
    wakes, woken = socket.socketpair()
    woken.setblocking(False)
    signal.set_wakeup_fd(woken.fileno())
    signal.signal(signal.SIGCHLD, lambda *_: None)
    unread, leave = b"", list[str]()
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
            *lines, unread = (unread + more).split(b"\n")
            # All work before the first fork: every page that is written between two forks gets a copy in each child.
            requests = [json.loads(line) for line in lines]
            leave = next((one["leave"] for one in reversed(requests) if "leave" in one), leave)
            orders = [one for one in requests if "leave" not in one]
            programs, forked = [_program(order) for order in orders], list[tuple[str, int]]()
            for order, program in zip(orders, programs, strict=True):
                try:
                    pid = os.fork()
                except OSError as error:
                    _fail(order, error)
                    continue
                if pid == 0:
                    _become(order, lifeline, program)
                names[pid] = order["name"]
                forked.append((order["name"], pid))
            for name, pid in forked:
                _say(name=name, pid=pid)


def _program(order: dict[str, Any]) -> Callable[[], NoReturn]:
    """Return a function that runs the program of an order.

    This parses the arguments here, because that takes a megabyte of memory in each child.
    """
    program = PROGRAMS[order["module"]]
    return functools.partial(program.run, program.options.parse_args(order["arguments"]))


def _warm_up() -> None:
    """Start an agent and make some steps: what numpy and Python set up on first use is then shared by all forks."""
    one: Index = np.zeros(1, dtype=np.int64)
    view = View(
        shard=0,
        b=0.1,
        law="minimax",
        ids=one,
        candidates=np.array([[0.4], [0.6]]),
        row=one,
        column=one + 1,
        peers=[Peer(1, one, 1)],
        outside=one + 1,
        history=100,
    )
    view = View.from_dict(json.loads(view.to_json()))
    need_source(view.law, view.law_source)
    shard = Shard(view)
    logging.getLogger("agent").info("ready: shard %d of nodes %s", view.shard, view.ids.tolist())
    for t in range(WARM_STEPS):
        if t:
            shard.receive_message(0, pack_link(t - 1, t - 1, 1, [1.0], [1.0]))
        message = encode_state(t, np.ones(1), b"")
        if shard.answer_quietly(message) is None:
            state = decode_state(message, 1, 1)
            shard.step(state)
            shard.messages(state)
    for t in range(WARM_STEPS, WARM_STEPS + WARM_GAPS):  # a link message is lost, and the next one brings its row too
        back = t % 2
        if back:
            shard.receive_message(0, pack_link(t - 1, t - 2, 1, [1.0, 1.0], [1.0, 1.0]))
        flags, spans = (ALL_UP, [Span(0, 0, 1, 0, 1)]) if back else (ALL_UP - Flag.RECEIVE, [])
        shard.answer_with_gaps(encode_state(t, np.ones(1), bytes([flags]), spans))


def _fail(request: dict[str, Any], error: OSError) -> None:
    """Report a process that could not be forked as one that ended at once, with the cause in its log."""
    with contextlib.suppress(OSError), open(request["log"], "a", encoding="utf-8") as log:
        log.write(f"{ERROR_PREFIX}{limit_reached(error) or error}\n")
    _say(name=request["name"], code=int(Exit.UNKNOWN))


def _end(pids: Iterable[int], leave: Sequence[str]) -> None:
    """Kill all children first, and then remove the files: a plant may just be creating its socket."""
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
    with contextlib.suppress(BrokenPipeError):  # our parent is gone, so standard input ends too
        os.write(1, json.dumps(what).encode() + b"\n")


def _become(request: dict[str, Any], lifeline: int, run: Callable[[], NoReturn]) -> NoReturn:
    """Set up the child: a new session, a log, the lifeline as standard input; then run the program and exit."""
    signal.set_wakeup_fd(-1)
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)  # the fork server handles it
    if IGNORE_SIGINT not in sys.argv:  # the fork server ignores it in any case
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    share_the_cores()
    os.setsid()  # the parent handles a Ctrl-C in the terminal
    log = os.open(request["log"], os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    for descriptor, source in ((0, lifeline), (1, log), (2, log)):
        os.dup2(source, descriptor)
    os.closerange(3, 256)
    with contextlib.suppress(OSError):  # with /proc, `ps` and `top` show this name
        Path("/proc/self/comm").write_text(request["name"], encoding="utf-8")
    run()


def whole() -> NoReturn:
    """Run `main`, and report the error that ended it to our parent."""
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
