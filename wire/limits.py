"""The limits of the machine: find the one that was reached, and name the fix."""

from __future__ import annotations

import errno
import re
import resource
from collections.abc import Iterator
from dataclasses import dataclass

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
