"""How a process begins that nobody forks: on its own machine, in a container, by hand."""

from __future__ import annotations

import argparse
import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

from wire.runtime import runtime_environment, share_the_cores

# Before Zenoh and numpy are loaded, below.
for _name, _value in runtime_environment().items():
    os.environ.setdefault(_name, _value)

import zenoh  # noqa: E402

from topologies.errors import DeadlineError, UserError  # noqa: E402
from wire import keys  # noqa: E402
from wire.child import run_alone  # noqa: E402
from wire.config import Config  # noqa: E402
from wire.session import close, open_client  # noqa: E402

WAIT_S = 600.0
"""How long a process waits for the others, who may be started by hand."""
ASK_S, PAUSE_S = 2.0, 0.5
CHECK_S = 5.0


def options(program: str, what: str) -> argparse.ArgumentParser:
    """The options that agents and plants have in common."""
    parser = argparse.ArgumentParser(prog=program, description=what)
    parser.add_argument("--config", type=Path, help="what `orchestrator bundle` wrote for it [$HEDGEROW_CONFIG]")
    parser.add_argument("--router", metavar="ENDPOINT", help="in place of the config's router, e.g. tcp/bench:7447")
    parser.add_argument("--wait", type=float, default=WAIT_S, metavar="S", help="seconds to wait for all others [600]")
    parser.add_argument("--check", action="store_true", help="say whether it takes part, by the exit code, and leave")
    return parser


def main(find: Callable[[], Config], router: str | None, check: bool, body: Callable[[Config, str], None]) -> NoReturn:
    """Run `body(config, endpoint)` as the whole of this process, or look whether another process does."""

    def whole() -> None:
        config = find()
        endpoint = router or config.router
        if check:
            _check(config, endpoint)
        else:
            share_the_cores()
            body(config, endpoint)

    run_alone(whole)


def told(config: Config, read: Callable[[dict[str, Any]], Any]) -> Any:
    """What the config tells, as `read` understands it; UserError where it does not."""
    try:
        return read(config.told)
    except (KeyError, TypeError, ValueError) as error:
        problem = f"{type(error).__name__}: {error}"
        raise UserError(
            f"config of {config.process}: {problem}; take the file that `orchestrator bundle` wrote for it, whole"
        ) from None


def token(process: str, told: dict[str, Any]) -> str:
    """The name of a process in liveliness tokens."""
    return keys.PLANT if process == keys.PLANT else keys.shard_name(int(told["shard"]))


def wait_for(session: zenoh.Session, name: str, within_s: float) -> None:
    """Return once a process is alive, by its token; DeadlineError if it does not come."""
    there = threading.Event()

    def on_token(_: zenoh.Sample) -> None:
        there.set()

    listener = zenoh.handlers.Callback(on_token, indirect=False)
    with session.liveliness().declare_subscriber(keys.alive(name, "*"), listener, history=True):
        if not there.wait(within_s):
            raise DeadlineError(
                f"{name}: not there after {within_s:g} s; is it started, with the same router and namespace?"
            )


def _check(config: Config, endpoint: str) -> None:
    session = open_client(endpoint, config.namespace, timeout_s=CHECK_S)
    try:
        wait_for(session, token(config.process, config.told), CHECK_S)
    finally:
        close(session)
    print(f"{config.process} takes part")
