"""The command `hedgerow-plant`: the plant on its own machine."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from hedgerow.wire import standalone  # before Zenoh and numpy are loaded

from hedgerow.plant.process import LOG, Plant  # isort: skip
from hedgerow.plant.truth import Truth
from hedgerow.topologies.errors import Code, UserError, check_options
from hedgerow.wire import config as configs
from hedgerow.wire import keys
from hedgerow.wire.child import stopped_by
from hedgerow.wire.config import Config
from hedgerow.wire.handshake import room
from hedgerow.wire.ports import check_listen
from hedgerow.wire.session import close, open_client, open_router


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the plant of a network here, to its last step, a SIGTERM or a Ctrl-C."""
    parser = standalone.options("hedgerow-plant", main.__doc__ or "")
    parser.add_argument("--listen", metavar="ENDPOINT", help="be the router too, e.g. on tcp/0.0.0.0:7447")
    parser.add_argument(
        "--rate", type=float, default=0.0, metavar="R", help="steps per second, 0 for as fast as possible"
    )
    parser.add_argument("--deadline", type=float, default=10.0, metavar="S", help="seconds to wait for an input [10]")
    known = parser.parse_args(arguments)

    def find() -> Config:
        check_options(rate=known.rate, deadline=known.deadline)
        config = configs.find(known.config, f"{keys.PLANT}.toml")
        if config.process != keys.PLANT:
            raise UserError(
                f"{known.config or configs.VARIABLE}: is of {config.process}; start it with `hedgerow-agent`",
                code=Code.OPTION,
            )
        return config

    def body(config: Config, endpoint: str, credentials: Path | None) -> None:
        truth = standalone.part(config, Truth.from_dict)
        with contextlib.ExitStack() as stack:
            if known.listen:
                check_listen(known.listen)
                session = open_router(known.listen, config.namespace, credentials)
                stack.callback(close, session)
            else:
                LOG.info("%s of %s: looking for %s", config.process, config.namespace, endpoint)
                session = open_client(endpoint, config.namespace, credentials, known.wait)
                stack.callback(close, session)
                stack.enter_context(room(session, config.namespace, LOG.warning))
            plant = Plant(truth, session, known.rate, known.deadline, known.wait, config.network)
            stack.enter_context(stopped_by(plant.stop))  # the agents receive END, even on other machines
            plant.run()

    standalone.main(find, known, body)
