"""The logs of a finished run: text of libraries in them is escaped, so that `cat` shows it harmlessly.

An agent's standard error is its log, without a process between them. A library in C writes to it as it likes.
"""

from __future__ import annotations

import codecs
import contextlib
import os
from pathlib import Path

from hedgerow.topologies.errors import UserError
from hedgerow.topologies.escape import escape
from hedgerow.topologies.regular_file import open_regular

PART_BYTES = 2**20


def escape_logs(folder: Path) -> None:
    """Escape the control characters in every log of a folder; a log that cannot be written stays as it is."""
    for log in sorted(folder.glob("*.log")):
        with contextlib.suppress(OSError, UserError):  # it is no regular file
            _escape(log)


def _escape(log: Path) -> None:
    part = log.with_name(f".{log.name}-{os.getpid()}")
    decode = codecs.getincrementaldecoder("utf-8")("backslashreplace").decode
    changed = False
    try:
        with open_regular(log, log.parent) as source, part.open("x", encoding="utf-8", newline="\n") as target:
            while data := source.read(PART_BYTES):
                text = decode(data)
                changed |= target.write(escape(text)) != len(data)
            changed |= target.write(escape(decode(b"", True))) > 0
        if changed:
            part.replace(log)
    finally:
        part.unlink(missing_ok=True)
