"""The place of a run's Unix socket: a short folder, private to the run, without any text of the user in its path."""

from __future__ import annotations

import os
import re
import secrets
import socket
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path

from hedgerow.topologies.errors import Code, HedgerowError, UserError

MAX_PATH_BYTES = 100
"""The kernel's limit for a Unix socket is 108 bytes; Zenoh's lock file beside it needs 5 more."""
_PLAIN = re.compile(r"[A-Za-z0-9/._+,=-]+")
"""Paths that mean the same to Zenoh's locators as to the kernel: a locator ends at `#` and `?`."""
_SCHEME = "unixsock-stream/"
_SOCKET = "router.sock"
_RANDOM_BYTES = 8


def socket_folder() -> Path:
    """Return the path of a new folder for one socket. The caller makes it with mode 0700, and removes it.

    It lies in the first of these that is writable, short and plain and can hold a socket: XDG_RUNTIME_DIR, the folder
    for temporary files, /tmp, /var/tmp, /dev/shm. Raises HedgerowError (Code.LIMIT) if there is none.
    """
    for base in _bases():
        folder = base / f"hedgerow-{secrets.token_hex(_RANDOM_BYTES)}"
        plain = _PLAIN.fullmatch(str(folder)) is not None and len(str(folder / _SOCKET)) <= MAX_PATH_BYTES
        if plain and base.is_dir() and _takes_sockets(folder):
            return folder
    raise HedgerowError(
        "no folder for a Unix socket: every candidate is read-only, or its file system has no sockets. Set"
        " XDG_RUNTIME_DIR to another folder.",
        code=Code.LIMIT,
    )


def _takes_sockets(folder: Path) -> bool:
    """Return True if `folder` can be made and hold a socket; some file systems of networks and containers have none."""
    try:
        folder.mkdir(mode=0o700)
    except OSError:
        return False
    try:
        with socket.socket(socket.AF_UNIX) as probe:
            probe.bind(str(folder / _SOCKET))
    except OSError:
        return False
    else:
        return True
    finally:
        socket_in(folder).unlink(missing_ok=True)
        folder.rmdir()


def socket_in(folder: Path) -> Path:
    """Return the path of the socket in a folder that `socket_folder` chose."""
    return folder / _SOCKET


def locator(path: Path) -> str:
    """Return the Zenoh endpoint of a socket. Raises HedgerowError for a path that Zenoh would cut or misread."""
    if _PLAIN.fullmatch(str(path)) is None:
        raise HedgerowError(f"{path}: a Zenoh endpoint cannot hold this path. Choose a plain one.", code=Code.WIRE)
    return f"{_SCHEME}{path}"


def check_socket(endpoint: str, option: str) -> None:
    """Raise UserError for a Unix endpoint if Zenoh would cut its path, or would remove the file there because it is not
    a socket.
    """
    if not endpoint.startswith(_SCHEME):
        return
    path = endpoint.removeprefix(_SCHEME)
    if _PLAIN.fullmatch(path) is None or len(path) > MAX_PATH_BYTES:
        raise UserError(
            f"{option} {endpoint}: a socket's path has at most {MAX_PATH_BYTES} bytes, of letters, digits and /._+,=-."
            " Choose another path.",
            code=Code.OPTION,
        )
    for one in (path, f"{path}.lock"):
        # Zenoh removes any file at this path before it listens.
        if os.path.lexists(one) and not _is_left_by_a_router(one, path):
            raise UserError(
                f"{option} {endpoint}: {one} exists and is no socket. Choose another path.", code=Code.OPTION
            )


def _is_left_by_a_router(one: str, endpoint: str) -> bool:
    status = os.lstat(one)
    return stat.S_ISSOCK(status.st_mode) or (one != endpoint and stat.S_ISREG(status.st_mode) and status.st_size == 0)


def _bases() -> Iterator[Path]:
    own = os.environ.get("XDG_RUNTIME_DIR", "")
    if os.path.isabs(own):
        yield Path(own)
    yield from map(Path, (tempfile.gettempdir(), "/tmp", "/var/tmp", "/dev/shm"))
