"""The endpoints and the namespace of a run, and its credentials."""

from __future__ import annotations

import contextlib
import secrets
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from hedgerow.orchestrator.launch import certificates
from hedgerow.orchestrator.runs import registry
from hedgerow.orchestrator.runs.folder import RunFolder
from hedgerow.topologies.errors import UserError
from hedgerow.topologies.escape import command
from hedgerow.topologies.paths import real_path
from hedgerow.wire.access import OBSERVER, ROUTER, Place
from hedgerow.wire.keys import PLANT, chunk
from hedgerow.wire.ports import check_listen, free_port
from hedgerow.wire.session import check_endpoint, check_namespace
from hedgerow.wire.sockets import check_socket, locator, socket_folder, socket_in


@dataclass(frozen=True)
class Connection:
    """The router of a run, and in a secure run the folder with the credentials of all processes."""

    endpoint: str
    namespace: str
    listens: bool
    """the plant is the router"""
    socket_folder: Path | None = None
    """The folder for its Unix socket, if it listens on one."""
    credentials: Path | None = None
    """a folder with credentials for each process"""
    made_for: str = ""
    """the host in the router's certificate, if the credentials are made for this run and removed with it"""

    def of(self, name: str) -> Path | None:
        """Return the credentials of a process; a plant that is the router has those of the router."""
        name = ROUTER if name == PLANT and self.listens else name
        return self.credentials and self.credentials / name

    def with_keys_of_its_own(self, folder: RunFolder, host: str) -> Connection:
        """Return a copy with credentials that are made for this run; its plant has the address `host`."""
        return replace(self, credentials=registry.secrets_of(registry.entry_path(folder.name)), made_for=host)

    @property
    def own(self) -> Path | None:
        """Return the credentials of `up`."""
        return self.of(OBSERVER)

    @property
    def traces(self) -> list[Path]:
        """Return the files and folders that exist only during the run and must be removed after it."""
        traces = [] if self.socket_folder is None else [self.socket_folder]
        if self.credentials is not None and self.made_for:
            traces.append(self.credentials)
        return traces

    @contextlib.contextmanager
    def laid(self, places: Sequence[Place]) -> Iterator[None]:
        """Provide the socket folder and the credentials while the block lasts; remove them after it."""
        with contextlib.ExitStack() as stack:
            if self.socket_folder is not None:
                self.socket_folder.mkdir(mode=0o700)  # raises an error if it exists: it is never shared
                stack.callback(shutil.rmtree, self.socket_folder, ignore_errors=True)
            if self.credentials is not None and self.made_for:
                stack.enter_context(certificates.for_this_run(self.credentials, places, self.namespace, self.made_for))
            yield


def wire(folder: RunFolder, secure: bool, router: str | None, keys: Path | None, places: Sequence[Place]) -> Connection:
    """Return the connection of a run, over its own router or an existing one; raise UserError as `check` does."""
    namespace = namespace_of_run(folder.name)
    if not secure:
        if router is not None:
            return Connection(router, namespace, listens=False)
        own = socket_folder()
        return Connection(locator(socket_in(own)), namespace, listens=True, socket_folder=own)
    if keys is None:
        open_one = Connection(f"tls/{certificates.HERE[0]}:{free_port()}", namespace, listens=True)
        return open_one.with_keys_of_its_own(folder, certificates.HERE[0])
    endpoint, namespace = certificates.carried(keys, places)
    return Connection(router or endpoint, namespace, listens=False, credentials=real_path(keys))


def check(
    secure: bool,
    router: str | None,
    keys: Path | None,
    places: Sequence[Place],
    external: bool,
    listen: str | None,
    namespace: str | None,
) -> None:
    """Raise UserError for invalid endpoints and namespaces, and for a run that cannot be as secure as asked.

    Raise HedgerowError if a secure run has no port to listen on.
    """
    for option, endpoint in (("--router", router), ("--listen", listen)):
        if endpoint is not None:
            check_endpoint(endpoint, option)
    if listen is not None:
        check_socket(listen, "--listen")
        check_listen(listen)
    if namespace is not None:
        check_namespace(namespace)
    if keys is not None and not secure:
        raise UserError(f"--keys {keys}: is for a secure run; give --secure too")
    if not secure:
        return
    if listen is not None:
        certificates.host_of(listen, "--listen")
    if external and keys is None:
        raise UserError(
            "--external: a separate process needs its keys: `orchestrator bundle FILE --secure --router"
            " tls/THIS-MACHINE:7447 --out DIR` makes them, and --keys DIR uses them here"
        )
    if router is not None:
        certificates.host_of(router)
        if keys is None:
            made = command(["orchestrator", "keys", "FILE", "--router", router, "--out", "DIR"])
            raise UserError(
                f"--router {router}: it must know the permitted clients; `{made}`"
                " makes its configuration and the keys of all processes, and --keys DIR uses them"
            )
    if keys is None:
        certificates.Authority()
        free_port()  # the plant listens on loopback
    else:
        certificates.carried(keys, places)


def meeting_place(
    keys: Path, places: Sequence[Place], router: str | None, listen: str | None, namespace: str | None
) -> tuple[str | None, str]:
    """Return the router (None if it is our plant) and the namespace of the keys; raise UserError if the options
    differ.
    """
    endpoint, made_for = certificates.carried(keys, places)
    if namespace is not None and namespace != made_for:
        raise UserError(f"--namespace {namespace}: the keys in {keys} were made for {made_for}; leave the option out")
    return router if listen else router or endpoint, made_for


def namespace_of(network: str) -> str:
    """Return the namespace of a network with separately started processes, which know no run."""
    return f"hedgerow/{chunk(network)}"


def namespace_of_run(run: str) -> str:
    """Return a new namespace for one run; another run of the same name gets another one."""
    return f"{namespace_of(run)}-{secrets.token_hex(4)}"
