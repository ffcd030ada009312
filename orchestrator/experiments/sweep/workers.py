"""A sweep over the cores of this machine: a process a core, each with a pipe of its own.

A pipe of its own is what makes the rest simple. A worker that is killed, in the middle of a word or not, is the end of
its pipe and nobody else's: another begins its chunk again. We who are killed are the end of all pipes, and workers end.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait

from hedgerow.orchestrator.experiments.sweep.plan import Chunk, Plan
from hedgerow.orchestrator.experiments.sweep.runs import Answer, Failure, answer
from hedgerow.wire.runtime import let_numbers_overflow

LOOK_EVERY_S = 0.2
TRIES = 3
"""A chunk during which so many workers died is not begun again."""
END_DEADLINE_S = 30.0
"""A network of real processes takes a while to end."""
Answering = Callable[[Plan, Chunk], Answer]
"""makes the runs of a chunk"""
_SPAWN = multiprocessing.get_context("spawn")  # a fork would share our pipes, and threads that hold locks


class _Worker:
    def __init__(self, plan: Plan, answer: Answering) -> None:
        self.connection, theirs = _SPAWN.Pipe()
        self.process = _SPAWN.Process(target=_serve, args=(theirs, plan, answer), daemon=True)
        # A Ctrl-C in the terminal is for us: it finds the worker deaf from its first instruction on. The tracker, which
        # the first start would start, leaves SIGINT unblocked.
        resource_tracker.ensure_running()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            self.process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        theirs.close()
        self.chunk: Chunk | None = None
        self.tries = 0

    def begin(self, chunk: Chunk, tries: int) -> None:
        self.chunk, self.tries = chunk, tries
        with contextlib.suppress(OSError):  # it died; the end of the pipe will tell
            self.connection.send(chunk)

    def close(self) -> None:
        self.connection.close()
        self.process.join()


def over_processes(
    plan: Plan, chunks: Iterable[Chunk], jobs: int, answer: Answering = answer
) -> Generator[Answer | None, None, None]:
    """The answer to each chunk, in no order; None when for a while there is none. No process outlives this."""
    waiting, again = iter(chunks), deque[tuple[Chunk, int]]()
    workers: dict[Connection, _Worker] = {}

    def task() -> tuple[Chunk, int] | None:
        if again:
            return again.popleft()
        chunk = next(waiting, None)
        return None if chunk is None else (chunk, 1)

    try:
        while True:
            while len(workers) < jobs and (todo := task()):
                worker = _Worker(plan, answer)
                workers[worker.connection] = worker
                worker.begin(*todo)
            if not workers:
                return
            ready = wait(list(workers), LOOK_EVERY_S)
            if not ready:
                yield None
            for connection in ready:
                assert isinstance(connection, Connection)
                worker = workers[connection]
                assert worker.chunk is not None, "a worker without a chunk is let go"
                said: Answer | None
                try:
                    said = connection.recv()
                except (EOFError, OSError):
                    del workers[connection]
                    worker.close()
                    said = _died(plan, worker, again)
                else:
                    if todo := task():
                        worker.begin(*todo)
                    else:
                        del workers[connection]
                        worker.close()
                yield said
    finally:
        for worker in workers.values():
            worker.process.terminate()
        for worker in workers.values():
            worker.process.join(END_DEADLINE_S)
            worker.process.kill()
            worker.close()


def _died(plan: Plan, worker: _Worker, again: deque[tuple[Chunk, int]]) -> Answer | None:
    """Have its chunk begun again, unless it is to blame."""
    chunk = worker.chunk
    assert chunk is not None
    if worker.tries < TRIES:
        again.append((chunk, worker.tries + 1))
        return None
    seeds = f"seed {chunk.seeds[0]}" + (f" to {chunk.seeds[-1]}" if len(chunk.seeds) > 1 else "")
    code = worker.process.exitcode
    how = f"signal {-code}" if code is not None and code < 0 else f"exit code {code}"
    return Failure(
        f"{seeds}, {plan.says(chunk.setting)}: the process died {TRIES} times, the last by {how}; "
        "look whether memory is short, and give fewer --jobs",
        users=False,
    )


def _serve(connection: Connection, plan: Plan, answer: Answering) -> None:
    """Be a worker."""
    let_numbers_overflow()
    signal.signal(signal.SIGTERM, _leave)
    signal.signal(signal.SIGINT, _stay)  # a handler, unlike a mask, is not handed down to a network's processes
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    threading.Thread(target=_end_with_parent, name="lifeline", daemon=True).start()
    try:
        while True:
            connection.send(answer(plan, connection.recv()))
    except (EOFError, OSError):
        return


def _end_with_parent() -> None:
    """Even SIGKILL of it ends us, and the network that we may have started."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os.kill(os.getpid(), signal.SIGTERM)


def _leave(*_: object) -> None:
    raise SystemExit(0)


def _stay(*_: object) -> None:
    pass
