"""The limits of the machine: find the one that was reached, and name the fix."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import resource
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from hedgerow.topologies.errors import Code, HedgerowError


@dataclass(frozen=True)
class _Limit:
    what: str
    option: str
    """the option of the shell's `ulimit`"""
    number: int
    """the number of the limit for getrlimit"""
    unit: int = 1
    cure: str = ""

    def __str__(self) -> str:
        soft = resource.getrlimit(self.number)[0]
        now = "" if soft == resource.RLIM_INFINITY else f" (the limit is {soft // self.unit}: `ulimit {self.option}`)"
        return f"the machine allows no more {self.what}{now}. {self.cure}"


ULIMIT = "the limit of `ulimit -u`"
_MANY_THREADS = 10_000
"""a limit so far above what a run needs is not looked at"""
_CAP_SYS_ADMIN, _CAP_SYS_RESOURCE = 21, 24
_FILES = _Limit("open files", "-n", resource.RLIMIT_NOFILE, cure="Raise it with `ulimit -n`, or use fewer --processes.")
_PROCESSES = _Limit(
    "processes and threads",
    "-u",
    getattr(resource, "RLIMIT_NPROC", resource.RLIMIT_NOFILE),
    cure="Raise it with `ulimit -u`, or use fewer --processes.",
)
_MEMORY = _Limit(
    "memory",
    "-v",
    getattr(resource, "RLIMIT_AS", resource.RLIMIT_DATA),
    1024,
    cure="Raise it with `ulimit -v`, or run a smaller network.",
)
_BY_NUMBER = {
    errno.EMFILE: _FILES,
    errno.ENFILE: _FILES,
    errno.EAGAIN: _PROCESSES,
    errno.ENOMEM: _MEMORY,
}
_BY_WORDS = (
    (re.compile(r"os error (24|23)\b|too many open files", re.I), _FILES),
    (re.compile(r"can't start new thread|failed to spawn|thread.*(os error 11\b|temporarily unavailable)", re.I | re.S),
     _PROCESSES),
    (re.compile(r"os error 12\b|cannot allocate memory|failed to map segment|out of memory|unable to allocate", re.I),
     _MEMORY),
)  # fmt: skip


def limits_now() -> str:
    """Return the limits of memory and processes that the user has, with the cure; the machine's memory if none."""
    limited = [
        limit for limit in (_MEMORY, _PROCESSES) if resource.getrlimit(limit.number)[0] != resource.RLIM_INFINITY
    ]
    return " ".join(f"Is it that {limit}" for limit in limited) or "Look at the memory and processes of the machine."


def limit_in(words: str) -> str | None:
    """Return the limit of the machine that a library's message is about, with the fix; None if it names none."""
    return next((str(limit) for pattern, limit in _BY_WORDS if pattern.search(words)), None)


def limit_reached(error: BaseException) -> HedgerowError | None:
    """Return the limit of the machine that an exception, or a cause of it, is about; None if there is none."""
    for one in causes(error):
        if isinstance(one, HedgerowError):
            continue
        found: str | None = None
        if isinstance(one, MemoryError):
            found = str(_MEMORY)
        elif isinstance(one, OSError) and one.errno is not None:
            found = str(_BY_NUMBER[one.errno]) if one.errno in _BY_NUMBER else None
        elif isinstance(one, ImportError | RuntimeError) or not isinstance(one, Exception):
            found = limit_in(str(one))  # a panic of a Rust library is not an Exception
        if found is not None:
            return HedgerowError(found, code=Code.LIMIT)
    return None


def causes(error: BaseException) -> Iterator[BaseException]:
    """Return an exception, and those that it came of."""
    seen: set[int] = set()
    one: BaseException | None = error
    while one is not None and id(one) not in seen:
        seen.add(id(one))
        yield one
        one = one.__cause__ or one.__context__


def need_threads(who: str, count: int, root: Path = Path("/")) -> None:
    """Raise HedgerowError if `who` starts `count` more processes and threads than the user or the container may have.

    A library of Rust that can start no thread may abort the process, so this is asked before. Without /proc nothing is
    known, and nothing is raised. Control groups are those below `root`.
    """
    for limit, most, used in _thread_limits(count, root):
        if used + count > most:
            raise HedgerowError(
                f"{who} needs about {count} more {_PROCESSES.what}; {limit} allows {most}, and {used} exist. "
                f"{_PROCESSES.cure if limit == ULIMIT else 'Raise it, or use fewer --processes.'}",
                code=Code.LIMIT,
            )


def _thread_limits(count: int, root: Path) -> Iterator[tuple[str, int, int]]:
    """Return each limit of processes and threads that holds for us: its name, its value, and the number in use."""
    for most, current in _control_groups(root):
        with contextlib.suppress(OSError, ValueError):  # "max" is no number
            yield str(most), int(most.read_text()), int(current.read_text())
    soft = resource.getrlimit(_PROCESSES.number)[0]
    with contextlib.suppress(OSError):
        # To count takes 60 us for each process of the machine.
        if soft != resource.RLIM_INFINITY and soft < _MANY_THREADS + count and not _above_limits():
            yield ULIMIT, soft, sum(_threads_of(os.getuid()))


def _above_limits() -> bool:
    """Return whether the kernel ignores the user's limit of processes for us: for root, and with two capabilities."""
    held = int(_status("self")["CapEff"], 16)
    return os.getuid() == 0 or bool(held & (1 << _CAP_SYS_ADMIN | 1 << _CAP_SYS_RESOURCE))


def _threads_of(user: int) -> Iterator[int]:
    """Return the number of threads of each process of a user."""
    for one in os.listdir("/proc"):
        if one.isdecimal():
            with contextlib.suppress(OSError, KeyError):  # it has ended
                status = _status(one)
                if int(status["Uid"].split()[0]) == user:
                    yield int(status["Threads"])


def _status(process: str) -> dict[str, str]:
    lines = Path("/proc", process, "status").read_text(errors="replace").splitlines()
    return dict(line.split(":\t", 1) for line in lines if ":\t" in line)


def _control_groups(root: Path) -> Iterator[tuple[Path, Path]]:
    """Return the files with the limit and the number of threads of our control group and of those above it."""
    try:
        lines = (root / "proc/self/cgroup").read_text().splitlines()
    except OSError:
        return
    mount = root / "sys/fs/cgroup"
    for _, controllers, path in (line.split(":", 2) for line in lines):
        if controllers in ("", "pids"):
            group = mount / controllers / path.lstrip("/")
            for one in (group, *group.parents):
                yield one / "pids.max", one / "pids.current"
                if one in (mount, mount / controllers):
                    break


def need(who: str, *, open_files: int = 0, memory: int = 0) -> None:
    """Raise HedgerowError if `who` needs more open files, or bytes of address space, than a process may have."""
    for limit, count in ((_FILES, open_files), (_MEMORY, memory)):
        soft = resource.getrlimit(limit.number)[0]
        if soft != resource.RLIM_INFINITY and count > soft:
            unit = "MB of address space" if limit is _MEMORY else limit.what
            per = 10**6 if limit is _MEMORY else 1
            raise HedgerowError(
                f"{who} needs about {count // per} {unit}, and a process may have {soft // per}. {limit.cure}",
                code=Code.LIMIT,
            )
