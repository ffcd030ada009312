"""The memory of a process and all of its descendants."""

from __future__ import annotations

import contextlib
import re
from pathlib import Path

import psutil


def pss_of(root: int) -> float:
    """Return the proportional set size [MB] of a process and its descendants: shared pages are counted once."""
    tree = psutil.Process(root)
    total = 0
    for process in (tree, *tree.children(recursive=True)):
        with contextlib.suppress(OSError):
            text = Path(f"/proc/{process.pid}/smaps_rollup").read_text(encoding="ascii")
            total += sum(int(kb) for kb in re.findall(r"^Pss: +(\d+) kB", text, re.MULTILINE))
    return total / 1024
