"""The CPU time and the context switches of a process and its descendants, by thread."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import psutil


class Used(NamedTuple):
    """The CPU time [s] that a thread used, and how often it waited."""

    cpu_s: float
    waits: int


Usage = Mapping[tuple[int, int, str], Used]
"""by process, thread and the name of the thread"""


def used_by(root: int) -> Usage:
    """Return what every thread of a process and of its descendants used so far."""
    tree = psutil.Process(root)
    used = {}
    for process in (tree, *tree.children(recursive=True)):
        for thread in Path(f"/proc/{process.pid}/task").glob("*"):
            with contextlib.suppress(OSError):
                cpu_ns = int((thread / "schedstat").read_text(encoding="ascii").split()[0])
                name = (thread / "comm").read_text(encoding="utf-8").strip()
                waits = re.search(r"^voluntary_ctxt_switches:\s+(\d+)", (thread / "status").read_text(), re.MULTILINE)
                used[process.pid, int(thread.name), name] = Used(1e-9 * cpu_ns, int(waits[1]) if waits else 0)
    return used


def between(before: Usage, after: Usage) -> Usage:
    """Return what every thread used between two looks."""
    nothing = Used(0.0, 0)
    differences = {}
    for key, used in after.items():
        then = before.get(key, nothing)
        differences[key] = Used(used.cpu_s - then.cpu_s, used.waits - then.waits)
    return differences
