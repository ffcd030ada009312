"""The start of a process without a parent: on its own machine, in a container, or by hand."""

from __future__ import annotations

import argparse
import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from hedgerow.wire.runtime import runtime_environment, share_the_cores

# Set these before Zenoh and numpy load, below.
for _name, _value in runtime_environment().items():
    os.environ.setdefault(_name, _value)

import zenoh  # noqa: E402

from hedgerow.topologies.errors import Code, DeadlineError, UserError, check_options  # noqa: E402
from hedgerow.topologies.escape import echo, escape  # noqa: E402
from hedgerow.topologies.paths import user_path  # noqa: E402
from hedgerow.wire import keys  # noqa: E402
from hedgerow.wire.child import run_alone  # noqa: E402
from hedgerow.wire.config import Config  # noqa: E402
from hedgerow.wire.session import close, direct, open_client  # noqa: E402

if TYPE_CHECKING:
    from _typeshed import SupportsWrite

WAIT_S = 600.0
"""The time that a process waits for the other processes, which people may start by hand [s]."""
ASK_S, PAUSE_S = 2.0, 0.5
CHECK_S = 5.0


class _Parser(argparse.ArgumentParser):
    """A parser that shows a wrong option in escaped text."""

    def _print_message(self, message: str, file: SupportsWrite[str] | None = None) -> None:
        super()._print_message(escape(message) if message else message, file)


def options(program: str, what: str) -> argparse.ArgumentParser:
    """Return a parser with the options that agents and plants share."""
    parser = _Parser(prog=program, description=what)
    parser.add_argument(
        "--config", type=user_path, help="the config that `orchestrator bundle` wrote [$HEDGEROW_CONFIG]"
    )
    parser.add_argument("--router", metavar="ENDPOINT", help="in place of the config's router, e.g. tcp/bench:7447")
    parser.add_argument(
        "--credentials", type=user_path, metavar="DIR", help="its keys in a secure network, in place of the config's"
    )
    parser.add_argument("--wait", type=float, default=WAIT_S, metavar="S", help="seconds to wait for all others [600]")
    parser.add_argument("--check", action="store_true", help="probe whether the process takes part; see the exit code")
    return parser


def main(
    find: Callable[[], Config], known: argparse.Namespace, body: Callable[[Config, str, Path | None], None]
) -> NoReturn:
    """Run `body(config, endpoint, credentials)` as the whole of this process, or probe whether another process runs it.

    `known` are the parsed `options`; the credentials are None in an open network.
    """

    def whole() -> None:
        check_options(wait=known.wait)
        config = find()
        endpoint = known.router or config.router
        credentials = known.credentials or (Path(config.credentials) if config.credentials else None)
        if credentials is None and endpoint.startswith("tls/"):
            raise UserError(
                f"--router {endpoint}: the network is secure. Give the folder of its keys with --credentials"
            )
        if known.check:
            _check(config, endpoint, credentials)
        else:
            share_the_cores()
            body(config, endpoint, credentials)

    run_alone(whole)


def part(config: Config, read: Callable[[dict[str, Any]], Any]) -> Any:
    """Return the process's part of the network, as `read` builds it from the config; raise UserError if it cannot."""
    try:
        return read(config.part)
    except (LookupError, TypeError, ValueError, ArithmeticError, AttributeError) as error:
        problem = f"{type(error).__name__}: {error}"
        raise UserError(
            f"config of {config.process}: {problem}; use the complete file that `orchestrator bundle` wrote",
            code=Code.FILE_FORMAT,
        ) from None


def token(process: str, part: dict[str, Any]) -> str:
    """Return the name of a process in liveliness tokens."""
    return keys.PLANT if process == keys.PLANT else keys.shard_name(int(part["shard"]))


def wait_for(session: zenoh.Session, name: str, within_s: float) -> None:
    """Wait until the token of a process appears; raise DeadlineError after `within_s`."""
    there = threading.Event()

    def on_token(_: zenoh.Sample) -> None:
        there.set()

    listener = direct(on_token)
    with session.liveliness().declare_subscriber(keys.alive(name, "*"), listener, history=True):
        if not there.wait(within_s):
            raise DeadlineError(
                f"{name}: not there after {round(within_s, 1):g} s; is it started, with the same router and namespace?"
            )


def _check(config: Config, endpoint: str, credentials: Path | None) -> None:
    name = part(config, lambda known: token(config.process, known))
    session = open_client(endpoint, config.namespace, credentials, CHECK_S)
    try:
        wait_for(session, name, CHECK_S)
    finally:
        close(session)
    echo(f"{config.process} takes part")
