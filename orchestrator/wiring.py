"""How the processes of a run find each other, and by what they know each other."""

from __future__ import annotations

import contextlib
import os
import secrets
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from orchestrator import authority, registry
from orchestrator.folder import RunFolder
from topologies.errors import UserError
from wire.access import OBSERVER, Place
from wire.session import free_port, remove_socket

MAX_SOCKET_PATH = 100
"""Bytes; the kernel's limit for a Unix socket is 108 with its end."""


@dataclass(frozen=True)
class Wiring:
    """The router of a run, and the folder with everybody's credentials where the run is secure."""

    endpoint: str
    namespace: str
    listens: bool
    """the plant is the router"""
    socket: Path | None = None
    """where it listens, if that is a Unix socket"""
    socket_folder: Path | None = None
    """made for it alone"""
    credentials: Path | None = None

    @property
    def own(self) -> Path | None:
        """The credentials of `up`."""
        return self.credentials and self.credentials / OBSERVER

    @property
    def left(self) -> dict[str, Path]:
        """What must be removed when nobody else does, by the plant's option for it."""
        left = {"socket": self.socket, "secrets": self.credentials if self.listens else None}
        return {option: path for option, path in left.items() if path is not None}

    @property
    def files(self) -> list[Path]:
        """What there is of the socket and of the credentials, in an order in which it can be removed."""
        files = [] if self.socket is None else [self.socket, Path(f"{self.socket}.lock")]
        if self.socket_folder is not None:
            files.append(self.socket_folder)
        if self.credentials is not None and self.listens:
            files += [*sorted(self.credentials.rglob("*"), reverse=True), self.credentials]
        return files

    @contextlib.contextmanager
    def laid(self, places: Sequence[Place]) -> Iterator[None]:
        """Credentials exist while the block lasts; after it nothing of them is left, nor of the socket."""
        with contextlib.ExitStack() as stack:
            if self.socket is not None:
                stack.callback(_remove, self.socket, self.socket_folder)
            if self.credentials is not None and self.listens:
                stack.enter_context(authority.for_this_run(self.credentials, places, self.namespace))
            yield


def wire(folder: RunFolder, secure: bool, router: str | None, keys: Path | None, places: Sequence[Place]) -> Wiring:
    """The wiring of a run: over a router of its own, or over one that is there; raises UserError as `check` does."""
    namespace = namespace_of(folder.name)
    if not secure:
        socket = None if router else socket_path(folder)
        own = socket.parent if socket is not None and socket != folder.socket else None
        return Wiring(router or f"unixsock-stream/{socket}", namespace, router is None, socket, own)
    if keys is None:
        credentials = registry.secrets_of(registry.entry_path(folder.name))
        return Wiring(f"tls/127.0.0.1:{free_port()}", namespace, listens=True, credentials=credentials)
    endpoint, namespace = authority.carried(keys, places)
    return Wiring(router or endpoint, namespace, listens=False, credentials=keys.resolve())


def check(secure: bool, router: str | None, keys: Path | None, places: Sequence[Place]) -> None:
    """Raise UserError for a run that could not be secure as it is asked to be."""
    if keys is not None and not secure:
        raise UserError(f"--keys {keys}: is for a secure run; give --secure too")
    if not secure:
        return
    if router is not None:
        authority.host_of(router)
        if keys is None:
            raise UserError(
                f"--router {router}: it must know who may connect; `orchestrator keys FILE --router {router} --out DIR`"
                " makes its configuration and everybody's keys, and --keys DIR uses them"
            )
    if keys is None:
        authority.Authority()
    else:
        authority.carried(keys, places)


def namespace_of(run: str) -> str:
    """Where the keys of a run stand: runs under one name do not meet."""
    return f"hedgerow/{run}-{secrets.token_hex(4)}"


def socket_path(folder: RunFolder) -> Path:
    """Where the router listens: in the run's folder, or in a private one when that path is too long for a socket."""
    if len(os.fsencode(folder.socket)) <= MAX_SOCKET_PATH:
        return folder.socket
    return Path(tempfile.mkdtemp(prefix="hedgerow-")) / "router.sock"


def _remove(socket: Path, folder: Path | None) -> None:
    remove_socket(socket)
    if folder is not None:
        folder.rmdir()
