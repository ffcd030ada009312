"""The command `hedgerow-agent`: an agent on its own machine, which joins a run that was prepared elsewhere."""

from __future__ import annotations

import contextlib
import json
import secrets
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from hedgerow.wire import standalone  # before Zenoh and numpy are loaded

import zenoh  # isort: skip

from hedgerow.agents.plant_watch import PlantWatch
from hedgerow.agents.process import LOG, Agent, Begin, Joined
from hedgerow.agents.view import View
from hedgerow.topologies.errors import Code, DeadlineError, UserError
from hedgerow.wire import bounded_json, keys
from hedgerow.wire import config as configs
from hedgerow.wire.config import Config
from hedgerow.wire.credentials import Credentials
from hedgerow.wire.handshake import introduction
from hedgerow.wire.session import WireError

MOST_ANSWER_BYTES = 2**16
TRIES = 2
"""The number of times that a plant may be present without an answer; a plant that leaves does so once."""


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run one agent of a network here, until the plant sends END."""
    parser = standalone.options("hedgerow-agent", main.__doc__ or "")
    parser.add_argument("--name", help="the node's id; without --config, the config is agent-NAME.toml")
    known = parser.parse_args(arguments)

    def find() -> Config:
        config = configs.find(known.config, f"{_process(known.name)}.toml" if known.name else "agent.toml")
        if config.process == keys.PLANT:
            raise UserError(
                f"{known.config or configs.VARIABLE}: is the plant's; start it with `hedgerow-plant`", code=Code.OPTION
            )
        if known.name and config.process not in (known.name, _process(known.name)):
            raise UserError(f"--name {known.name}: that config is of {config.process}; choose one of the two")
        return config

    def body(config: Config, endpoint: str, credentials: Path | None) -> None:
        take_part(config, endpoint, known.wait, credentials)

    standalone.main(find, known, body)


def take_part(config: Config, endpoint: str, wait_s: float, credentials: Credentials | Path | None = None) -> None:
    """Run one agent until the plant sends END; wait up to `wait_s` for the other processes.

    Raise HedgerowError if they do not come.
    """
    view = standalone.part(config, View.from_dict)
    place = PlaceRequest(config, view.shard, wait_s)
    LOG.info("%s of %s: looking for %s", config.process, config.namespace, endpoint)
    agent = Agent(view, config.namespace, endpoint, Begin(place.take, wait_s), credentials)
    with PlantWatch(agent.session, agent.joined.plant, agent.give_up):
        agent.live()


def _process(name: str) -> str:
    return name if name.startswith(("agent-", "shard-")) else f"agent-{name}"


class PlaceRequest:
    """The repeated request of a process for its place in a run."""

    def __init__(self, config: Config, shard: int, within_s: float) -> None:
        self._config, self._shard, self._within_s = config, shard, within_s
        self._number = secrets.randbelow(2**31)
        """the number of this process, among those that may ask for the place"""

    def take(self, session: zenoh.Session) -> Joined:
        """Ask until the plant grants the place.

        Raise UserError if the plant refuses, DeadlineError if there is no plant or another process holds the place.
        """
        who, by, unanswered = self._config.process, time.monotonic() + self._within_s, 0
        while True:
            # A process that waits for its place may see one plant leave and another arrive.
            standalone.wait_for(session, keys.PLANT, max(standalone.PAUSE_S, by - time.monotonic()))
            answer = self._ask(session)
            if answer is None:
                unanswered += 1
                if unanswered == TRIES:
                    raise WireError(
                        f"the plant did not answer {who} within {standalone.ASK_S:g} s. If the network is secure, check"
                        f" that the keys are those of {who}"
                    )
            elif "life" in answer:
                return Joined(int(answer["life"]), int(answer["plant"]))
            elif not answer.get("wait"):
                raise UserError(f"the plant refuses {who}: {answer['error']}", code=Code.REFUSED)
            elif time.monotonic() > by:
                raise DeadlineError(f"{who}: {answer['error']}, after {self._within_s:g} s; end that one first")
            else:
                unanswered = 0
                LOG.warning("%s; waiting", answer["error"])
            threading.Event().wait(standalone.PAUSE_S)

    def _ask(self, session: zenoh.Session) -> dict[str, Any] | None:
        request = {"process": self._config.process, "number": self._number, **introduction(self._config.network)}
        for reply in session.get(keys.join(self._shard), payload=json.dumps(request), timeout=standalone.ASK_S):
            if reply.ok is not None:
                with contextlib.suppress(ValueError):  # a plant does not answer like this: ask again
                    answer = bounded_json.decode(reply.ok.payload.to_bytes(), MOST_ANSWER_BYTES)
                    if isinstance(answer, dict):
                        return answer
        return None
