"""How the processes of a run find each other, and by what they know each other."""

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
from hedgerow.wire.access import OBSERVER, ROUTER, Place
from hedgerow.wire.keys import PLANT, chunk
from hedgerow.wire.ports import free_port
from hedgerow.wire.session import check_endpoint, check_namespace
from hedgerow.wire.sockets import check_socket, locator, socket_folder, socket_in


@dataclass(frozen=True)
class Connection:
    """The router of a run, and the folder with everybody's credentials where the run is secure."""

    endpoint: str
    namespace: str
    listens: bool
    """the plant is the router"""
    socket_folder: Path | None = None
    """The folder that is made for its Unix socket, if it listens on one."""
    credentials: Path | None = None
    """a folder of them for each process"""
    made_for: str = ""
    """the host in the router's certificate, where all of them are made for this run alone and removed with it"""

    def of(self, name: str) -> Path | None:
        """The credentials of a process; a plant that is the router has the router's."""
        name = ROUTER if name == PLANT and self.listens else name
        return self.credentials and self.credentials / name

    def with_keys_of_its_own(self, folder: RunFolder, host: str) -> Connection:
        """The same with credentials that are made for this run, whose plant is reached at `host`."""
        return replace(self, credentials=registry.secrets_of(registry.entry_path(folder.name)), made_for=host)

    @property
    def own(self) -> Path | None:
        """The credentials of `up`."""
        return self.of(OBSERVER)

    @property
    def traces(self) -> list[Path]:
        """What is there of the wiring while the run lasts, and must not be afterwards: files, and whole folders."""
        traces = [] if self.socket_folder is None else [self.socket_folder]
        if self.credentials is not None and self.made_for:
            traces.append(self.credentials)
        return traces

    @contextlib.contextmanager
    def laid(self, places: Sequence[Place]) -> Iterator[None]:
        """Credentials exist while the block lasts; after it nothing of them is left, nor of the socket."""
        with contextlib.ExitStack() as stack:
            if self.socket_folder is not None:
                self.socket_folder.mkdir(mode=0o700)  # raises if it exists: it is never shared
                stack.callback(shutil.rmtree, self.socket_folder, ignore_errors=True)
            if self.credentials is not None and self.made_for:
                stack.enter_context(certificates.for_this_run(self.credentials, places, self.namespace, self.made_for))
            yield


def wire(folder: RunFolder, secure: bool, router: str | None, keys: Path | None, places: Sequence[Place]) -> Connection:
    """The wiring of a run: over a router of its own, or over one that is there; raises UserError as `check` does."""
    namespace = namespace_of(folder.name)
    if not secure:
        if router is not None:
            return Connection(router, namespace, listens=False)
        own = socket_folder()
        return Connection(locator(socket_in(own)), namespace, listens=True, socket_folder=own)
    if keys is None:
        open_one = Connection(f"tls/{certificates.HERE[0]}:{free_port()}", namespace, listens=True)
        return open_one.with_keys_of_its_own(folder, certificates.HERE[0])
    endpoint, namespace = certificates.carried(keys, places)
    return Connection(router or endpoint, namespace, listens=False, credentials=keys.resolve())


def check(
    secure: bool,
    router: str | None,
    keys: Path | None,
    places: Sequence[Place],
    external: bool,
    listen: str | None,
    namespace: str | None,
) -> None:
    """Raise UserError for endpoints and namespaces that are none, and for a run that cannot be as secure as asked.

    Raises HedgerowError if a secure run has no port to listen on.
    """
    for option, endpoint in (("--router", router), ("--listen", listen)):
        if endpoint is not None:
            check_endpoint(endpoint, option)
    if listen is not None:
        check_socket(listen, "--listen")
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
            "--external: who is started elsewhere needs its keys there: `orchestrator bundle FILE --secure --router"
            " tls/THIS-MACHINE:7447 --out DIR` makes them, and --keys DIR uses them here"
        )
    if router is not None:
        certificates.host_of(router)
        if keys is None:
            made = command(["orchestrator", "keys", "FILE", "--router", router, "--out", "DIR"])
            raise UserError(
                f"--router {router}: it must know who may connect; `{made}`"
                " makes its configuration and everybody's keys, and --keys DIR uses them"
            )
    if keys is None:
        certificates.Authority()
        free_port()  # the plant listens on loopback
    else:
        certificates.carried(keys, places)


def meeting_place(
    keys: Path, places: Sequence[Place], router: str | None, listen: str | None, namespace: str | None
) -> tuple[str | None, str]:
    """The router (None where that is our plant) and the namespace that keys are for; UserError if asked for another."""
    endpoint, made_for = certificates.carried(keys, places)
    if namespace is not None and namespace != made_for:
        raise UserError(f"--namespace {namespace}: the keys in {keys} were made for {made_for}; leave the option out")
    return router if listen else router or endpoint, made_for


def namespace_of(run: str) -> str:
    """Where the keys of a run stand: runs under one name do not meet."""
    return f"hedgerow/{chunk(run)}-{secrets.token_hex(4)}"
