"""`agent`, the command: an agent on a machine of its own, which joins a run that is prepared elsewhere."""

from __future__ import annotations

import functools
import json
import threading
import time
from collections.abc import Sequence
from typing import Any, NoReturn

from wire import anywhere  # before Zenoh and numpy are loaded

import zenoh  # isort: skip

from agents.process import LOG, Agent, Begin
from agents.view import View
from topologies.errors import DeadlineError, UserError
from wire import config as configs
from wire import keys
from wire.config import Config
from wire.handshake import introduction
from wire.session import WireError


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run one agent of a network where it is started, until the plant says END."""
    parser = anywhere.options("agent", main.__doc__ or "")
    parser.add_argument("--name", help="the node's id; its config is then agent-NAME.toml, if --config says nothing")
    known = parser.parse_args(arguments)

    def find() -> Config:
        config = configs.find(known.config, f"{_process(known.name)}.toml" if known.name else "agent.toml")
        if config.process == keys.PLANT:
            raise UserError(f"{known.config or configs.VARIABLE}: is the plant's; start it with `plant`")
        if known.name and config.process not in (known.name, _process(known.name)):
            raise UserError(f"--name {known.name}: that config is of {config.process}; choose one of the two")
        return config

    def body(config: Config, endpoint: str) -> None:
        view = anywhere.told(config, View.from_dict)
        join = functools.partial(_join, config=config, shard=view.shard, within_s=known.wait)
        LOG.info("%s of %s: looking for %s", config.process, config.namespace, endpoint)
        agent = Agent(view, config.namespace, endpoint, Begin(join, known.wait))
        LOG.info("ready: shard %d of nodes %s", view.shard, view.ids[:20].tolist())
        try:
            agent.run()
        finally:
            agent.close()
        LOG.info("end: %d steps answered, %d messages refused", agent.shard.t + 1, agent.refused)

    anywhere.main(find, known.router, known.check, body)


def _process(name: str) -> str:
    return name if name.startswith(("agent-", "shard-")) else f"agent-{name}"


def _join(session: zenoh.Session, config: Config, shard: int, within_s: float) -> int:
    """Ask the plant for our place; how often it was taken before.

    UserError if the plant refuses us, DeadlineError if there is none, or if somebody else keeps the place.
    """
    by = time.monotonic() + within_s
    request = {"process": config.process, "shard": shard, **introduction(config.network)}
    anywhere.wait_for(session, keys.PLANT, within_s)
    while True:
        answer = _ask(session, request)
        if "life" in answer:
            return int(answer["life"])
        if not answer.get("wait"):
            raise UserError(f"the plant refuses {config.process}: {answer['error']}")
        if time.monotonic() > by:
            raise DeadlineError(f"{config.process}: {answer['error']}, after {within_s:g} s; end that one first")
        LOG.warning("%s; waiting", answer["error"])
        threading.Event().wait(anywhere.PAUSE_S)


def _ask(session: zenoh.Session, request: dict[str, Any]) -> dict[str, Any]:
    for reply in session.get(keys.control("join"), payload=json.dumps(request), timeout=anywhere.ASK_S):
        if reply.ok is not None:
            answer: dict[str, Any] = json.loads(reply.ok.payload.to_string())
            return answer
    raise WireError(f"the plant did not answer within {anywhere.ASK_S:g} s")
