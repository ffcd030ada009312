"""A sweep over the cores of this machine: one process per core, each with its own pipe.

The separate pipes simplify the errors. A killed worker closes only its own pipe, even in the middle of a message, and
another worker repeats its chunk. If this process is killed, all pipes close, and the workers end.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from types import ModuleType

from hedgerow.orchestrator.experiments.sweep.plan import Chunk, Plan
from hedgerow.orchestrator.experiments.sweep.runs import Answer, Failure, answer
from hedgerow.wire.runtime import let_numbers_overflow

LOOK_EVERY_S = 0.2
TRIES = 3
"""A chunk is given up after this number of deaths of its workers."""
END_DEADLINE_S = 30.0
"""The time that a network of real processes needs to end [s]."""
Answering = Callable[[Plan, Chunk], Answer]
"""makes the runs of a chunk"""
_SPAWN = multiprocessing.get_context("spawn")  # a fork would share our pipes, and threads that hold locks


class _Worker:
    def __init__(self, plan: Plan, answer: Answering) -> None:
        self.connection, theirs = _SPAWN.Pipe()
        self.process = _SPAWN.Process(target=_serve, args=(theirs, plan, answer), daemon=True)
        # A Ctrl-C in the terminal is for this process: block it in the worker from its first instruction on. Start the
        # tracker before, because its start would unblock SIGINT.
        resource_tracker.ensure_running()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            with _without_script():
                self.process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        theirs.close()
        self.chunk: Chunk | None = None
        self.tries = 0

    def begin(self, chunk: Chunk, tries: int) -> None:
        self.chunk, self.tries = chunk, tries
        with contextlib.suppress(OSError):  # it died; the end of the pipe will show this
            self.connection.send(chunk)

    def close(self) -> None:
        self.connection.close()
        self.process.join()


def over_processes(
    plan: Plan, chunks: Iterable[Chunk], jobs: int, answer: Answering = answer
) -> Generator[Answer | None, None, None]:
    """Return a generator of the answers to the chunks, in any order; it gives None if there is none for a while.

    No process outlives the generator. A law of the script or notebook that runs needs this process: no other has it.
    """
    if plan.law_in_script:
        return (answer(plan, chunk) for chunk in chunks)
    return _over_processes(plan, chunks, jobs, answer)


def _over_processes(
    plan: Plan, chunks: Iterable[Chunk], jobs: int, answer: Answering
) -> Generator[Answer | None, None, None]:
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
                received: Answer | None
                try:
                    received = connection.recv()
                except (EOFError, OSError):
                    del workers[connection]
                    worker.close()
                    received = _died(plan, worker, again)
                else:
                    if todo := task():
                        worker.begin(*todo)
                    else:
                        del workers[connection]
                        worker.close()
                yield received
    finally:
        for worker in workers.values():
            worker.process.terminate()
        for worker in workers.values():
            worker.process.join(END_DEADLINE_S)
            worker.process.kill()
            worker.close()


@contextlib.contextmanager
def _without_script() -> Iterator[None]:
    """Hide the script of the user while a worker starts.

    A worker would execute the script otherwise, and without `if __name__ == "__main__":` begin the same sweep again.
    """
    script, sys.modules["__main__"] = sys.modules["__main__"], ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = script


def _died(plan: Plan, worker: _Worker, again: deque[tuple[Chunk, int]]) -> Answer | None:
    """Repeat the chunk of a dead worker, unless the chunk is the cause."""
    chunk = worker.chunk
    assert chunk is not None
    if worker.tries < TRIES:
        again.append((chunk, worker.tries + 1))
        return None
    seeds = f"seed {chunk.seeds[0]}" + (f" to {chunk.seeds[-1]}" if len(chunk.seeds) > 1 else "")
    code = worker.process.exitcode
    how = f"signal {-code}" if code is not None and code < 0 else f"exit code {code}"
    return Failure(
        f"{seeds}, {plan.label(chunk.setting)}: the process died {TRIES} times, the last by {how}; "
        "check the free memory, and give fewer --jobs",
        users=False,
    )


def _serve(connection: Connection, plan: Plan, answer: Answering) -> None:
    """Run the loop of a worker."""
    let_numbers_overflow()
    signal.signal(signal.SIGTERM, _leave)
    signal.signal(signal.SIGINT, _stay)  # a handler, unlike a mask, is not inherited by a network's processes
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    threading.Thread(target=_end_with_parent, name="lifeline", daemon=True).start()
    try:
        while True:
            connection.send(answer(plan, connection.recv()))
    except (EOFError, OSError):
        return


def _end_with_parent() -> None:
    """End this process with its parent, even after SIGKILL, and so the network that it started."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os.kill(os.getpid(), signal.SIGTERM)


class _LeaveError(SystemExit):
    """The end of a worker by a signal; as a subclass, it is not taken for the exit of a law that runs."""


def _leave(*_: object) -> None:
    raise _LeaveError(0)


def _stay(*_: object) -> None:
    pass
