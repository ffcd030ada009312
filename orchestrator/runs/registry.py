"""The registry of running networks, for `ps`, `status` and `stop`, from any working directory.

Each run has one small file, locked while its process lives. The kernel releases the lock at any end of the process, so
a file that can be locked belongs to a dead run.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import hashlib
import json
import os
import stat
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from hedgerow.topologies import json_file
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.escape import command, escape
from hedgerow.topologies.regular_file import open_regular
from hedgerow.wire.access import OPERATOR
from hedgerow.wire.session import remove_trace


@dataclass(frozen=True)
class Entry:
    """A running network: its run's name and folder, the process to signal, and how to reach its plant."""

    run: str
    folder: str
    pid: int
    endpoint: str
    namespace: str
    started: float
    credentials: str | None = None
    """the operator's folder of credentials, if the run is secure"""
    traces: Sequence[str] = ()
    """files and folders that must not outlive the run"""
    directory: str = ""
    """the working directory of the run's command"""

    @property
    def is_over(self) -> bool:
        """Return True if the run has its verdict: its processes have ended, and its command keeps a page open."""
        return os.path.isfile(os.path.join(self.folder, "verdict.json"))

    @property
    def verdict(self) -> str:
        """Return the verdict of a run that is over; empty if verdict.json cannot be read."""
        path = Path(self.folder) / "verdict.json"
        with contextlib.suppress(OSError, UserError), open_regular(path, path.parent) as file:
            found = json_file.loads(path, file.read(_MOST_VERDICT_BYTES))
            if isinstance(found, dict) and isinstance(verdict := found.get("verdict"), str):
                return escape(verdict)
        return ""

    def ending(self) -> str:
        """Return the end of a run in words: its verdict, and that its page is still open."""
        return f"is over{f' ({verdict})' if (verdict := self.verdict) else ''}; only its page is open"

    def over(self) -> UserError:
        """Return the error of a request to a run that is over."""
        again, end = command(["orchestrator", "open", self.folder]), command(["orchestrator", "stop", self.run])
        return UserError(
            f"{self.run}: {self.ending()}. `{end}` closes the page, `{again}` shows the run.",
            code=Code.NETWORK_MISSING,
        )


def _directory() -> Path:
    base = os.environ.get("XDG_RUNTIME_DIR", "")
    try:
        # It may belong to a login session that is over, or to another user.
        if not (os.path.isabs(base) and os.path.isdir(base) and os.access(base, os.W_OK | os.X_OK)):
            base = tempfile.gettempdir()
        directory = Path(base) / f"hedgerow-{os.getuid()}"
        with contextlib.suppress(FileExistsError):
            directory.mkdir(mode=0o700)
        found = directory.lstat()
    except OSError as error:
        raise UserError(
            f"{base or 'TMPDIR'}: no place to list running networks: {error.strerror};"
            " set XDG_RUNTIME_DIR to a folder of your own",
            code=Code.OUTPUT,
        ) from None
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o077:
        raise UserError(
            f"{directory}: must be a folder that only you can read: use chmod 700, or remove it", code=Code.OUTPUT
        )
    return directory


def entry_path(run: str) -> Path:
    """Return the path of the entry for a run of that name by this process."""
    digest = hashlib.sha256(os.fsencode(run)).hexdigest()[:16]  # the name may be as long as a file's may be
    return _directory() / f"{digest}-{os.getpid()}.json"


def secrets_of(listed: Path) -> Path:
    """Return the folder of a run's credentials, beside its entry; only its user can read it."""
    return listed.with_suffix(".keys")


@contextlib.contextmanager
def announced(
    run: str,
    folder: Path,
    endpoint: str,
    namespace: str,
    credentials: Path | None = None,
    traces: Sequence[Path] = (),
) -> Iterator[Path]:
    """List this process's run while the block lasts; yield the file of the entry.

    `credentials` are those of the run's processes, if it is secure. The next command that finds this process dead
    removes `traces`.
    """
    path = entry_path(run)
    own = None if credentials is None else str(credentials / OPERATOR)
    entry = Entry(
        run, str(folder), os.getpid(), endpoint, namespace, time.time(), own, [*map(str, traces)], _working_directory()
    )
    with path.open("wb", buffering=0) as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX)
            content = json.dumps(asdict(entry)).encode()
            if file.write(content) < len(content):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError as error:
            path.unlink(missing_ok=True)
            raise UserError(
                f"{path.parent}: the run cannot be listed: {error.strerror}. Free space, or set XDG_RUNTIME_DIR.",
                code=Code.OUTPUT,
            ) from None
        try:
            yield path
        finally:
            path.unlink(missing_ok=True)


def running() -> list[Entry]:
    """Return the running networks, the oldest first; remove the files of dead ones."""
    entries = []
    for path in _directory().glob("*.json"):
        with contextlib.suppress(OSError, UserError), open_regular(path, path.parent) as file:
            content = file.read(_MOST_BYTES)
            if _is_locked(file.fileno()):
                entries.append(_entry(path, content))
            elif content:  # otherwise it is being written right now
                remove_trace(secrets_of(path))
                path.unlink(missing_ok=True)
                for trace in _entry(path, content).traces:
                    remove_trace(trace)
    return sorted(entries, key=lambda entry: entry.started)


_MOST_BYTES = 2**20
_MOST_VERDICT_BYTES = 2**26
"""The verdict of a large network lists every storage p_i."""


def _entry(path: Path, content: bytes) -> Entry:
    """Return the entry in a file; raise UserError if it is invalid."""
    found = json_file.loads(path, content)
    try:
        entry = Entry(**found)
    except TypeError:
        entry = None
    if (
        entry is None
        or not all(isinstance(text, str) for text in (entry.run, entry.folder, entry.endpoint, entry.namespace))
        or not isinstance(entry.directory, str)
        or not isinstance(entry.credentials, str | None)
        or not (isinstance(entry.pid, int) and isinstance(entry.started, int | float))
        or not (isinstance(entry.traces, list) and all(isinstance(trace, str) for trace in entry.traces))
    ):
        raise UserError(f"{path}: lists no run. Remove it.", code=Code.FILE_FORMAT)
    return entry


def _is_locked(descriptor: int) -> bool:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    fcntl.flock(descriptor, fcntl.LOCK_UN)
    return False


def _working_directory() -> str:
    try:
        return os.path.realpath(os.getcwd())
    except OSError:  # it was removed
        return ""


def find(run: str | None) -> Entry:
    """Return the one running network that `run` names: its name, its folder, or the beginning of its name.

    None names all running networks. Among several, the one started in this working directory is chosen. Raise UserError
    with NETWORK_MISSING if there is none, and with NETWORK_AMBIGUOUS and the list if several remain.
    """
    entries = running()
    named = [entry for entry in entries if not entry.is_over] or entries if run is None else _named(run, entries)
    if not named:
        if not entries or run is None:
            raise UserError("no network is running; start one with `orchestrator up FILE`", code=Code.NETWORK_MISSING)
        raise UserError(
            f"{run}: is not running; name one of those that run:\n{_listed(entries)}", code=Code.NETWORK_MISSING
        )
    here = _working_directory()
    own = [entry for entry in named if here and entry.directory == here]
    for found in (named, own):
        if len(found) == 1:
            return found[0]
    which = own or named
    what = f"{len(which)} networks run" + (" from this folder" if own else "") + (f" as {run}" if run else "")
    how = "Name one of them, as `orchestrator status NAME` or `orchestrator fault … --run NAME`"
    raise UserError(f"{what}. {how}:\n{_listed(which)}", code=Code.NETWORK_AMBIGUOUS)


def _named(run: str, entries: Sequence[Entry]) -> list[Entry]:
    """Return the networks with a name or folder; if there are none, those with a name that begins with it."""
    # A relative path is a folder of this working directory; a bare word is a name first.
    path = os.path.realpath(os.path.expanduser(run)) if run and "\0" not in run else ""
    for fits in (
        lambda entry: entry.run == run,
        lambda entry: run in (entry.folder, Path(entry.folder).name) or path == os.path.realpath(entry.folder),
        lambda entry: bool(run) and entry.run.startswith(run),
    ):
        if found := [entry for entry in entries if fits(entry)]:
            return found
    return []


_SHOWN = 20


def _listed(entries: Sequence[Entry]) -> str:
    """Return a line for each network: its name for commands, and its working directory."""
    counts = Counter(entry.run for entry in entries)
    lines = [
        f"  {entry.run if counts[entry.run] == 1 else entry.folder}"
        + (f"  started in {entry.directory}" if entry.directory else f"  {entry.folder}")
        for entry in entries[:_SHOWN]
    ]
    return "\n".join(lines + [f"  and {len(entries) - _SHOWN} more"] * (len(entries) > _SHOWN))
