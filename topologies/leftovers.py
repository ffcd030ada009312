"""Names of temporary files with the process that made them, and the removal of the files of killed processes."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import re
import secrets
import shutil
from pathlib import Path

_NAME = re.compile(r"\.hedgerow-([0-9a-f]{8})-([0-9a-f]+)-([0-9a-f]+)-[0-9a-f]{8}[.-].*")
"""the machine, the id of the process and its start, and some random digits"""
_SEEN: set[Path] = set()
_AFTER_START = 21
"""the fields of /proc/PID/stat from the name to the start"""


def new_name() -> str:
    """Return a new name for a temporary file or folder of this process, without its ending."""
    pid = os.getpid()
    with contextlib.suppress(OSError, ValueError):
        if machine := _machine():
            return f".hedgerow-{machine}-{pid:x}-{_start(pid):x}-{secrets.token_hex(4)}"
    return f".hedgerow-{secrets.token_hex(8)}"  # without its process in the name, no other process removes it


def remove(folder: Path) -> None:
    """Remove temporary files and folders that dead processes of this user and machine made; once per folder."""
    if folder in _SEEN:  # a folder can have many files, and a search writes often
        return
    _SEEN.add(folder)
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        for entry in [one for one in entries if one.name.startswith(".hedgerow-")]:
            with contextlib.suppress(OSError, ValueError):
                if _is_left(entry.name) and entry.stat(follow_symlinks=False).st_uid == os.geteuid():
                    _remove(entry)


def _remove(entry: os.DirEntry[str]) -> None:
    if entry.is_dir(follow_symlinks=False):
        shutil.rmtree(entry.path, ignore_errors=True)
    else:
        os.unlink(entry.path)


def _is_left(name: str) -> bool:
    """Return True for a name of `new_name` of a dead process; its id may belong to a younger process by now."""
    made = _NAME.fullmatch(name)
    if made is None or made[1] != _machine():
        return False
    return _start(int(made[2], 16)) != int(made[3], 16)


@functools.cache
def _machine() -> str:
    """Return digits of this boot of this machine and of our process ids on it; empty if the system does not give them.

    Containers of one machine, and machines that share a disk, have processes of equal ids.
    """
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii")
        return hashlib.sha256((boot + os.readlink("/proc/self/ns/pid")).encode()).hexdigest()[:8]
    except (OSError, ValueError):
        return ""


def _start(pid: int) -> int | None:
    """Return the start of a process [clock ticks since the boot], None if there is no such process.

    Raises OSError or ValueError if the system does not give it.
    """
    try:
        stat = Path(f"/proc/{pid}/stat").read_bytes()
    except (FileNotFoundError, ProcessLookupError):
        return None
    fields = stat[stat.rindex(b")") :].split()  # the name before it may have spaces
    if len(fields) < _AFTER_START:
        raise ValueError(f"/proc/{pid}/stat: {len(fields)} fields")
    return int(fields[_AFTER_START - 1])
