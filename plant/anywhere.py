"""`plant`, the command: the world on a machine of its own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NoReturn

from wire import anywhere  # before Zenoh and numpy are loaded

from plant.process import Plant  # isort: skip
from plant.truth import Truth
from topologies.errors import UserError
from wire import config as configs
from wire import keys
from wire.config import Config
from wire.session import open_client, open_router


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the world of a network where it is started, to its last step."""
    parser = anywhere.options("plant", main.__doc__ or "")
    parser.add_argument("--listen", metavar="ENDPOINT", help="be the router too, e.g. on tcp/0.0.0.0:7447")
    parser.add_argument(
        "--rate", type=float, default=0.0, metavar="R", help="steps per second, 0 for as fast as possible"
    )
    parser.add_argument("--deadline", type=float, default=10.0, metavar="S", help="seconds to wait for an input [10]")
    known = parser.parse_args(arguments)

    def find() -> Config:
        config = configs.find(known.config, f"{keys.PLANT}.toml")
        if config.process != keys.PLANT:
            raise UserError(f"{known.config or configs.VARIABLE}: is of {config.process}; start it with `agent`")
        return config

    def body(config: Config, endpoint: str) -> None:
        truth = anywhere.told(config, Truth.from_dict)
        if known.listen:
            session = open_router(known.listen, config.namespace)
        else:
            session = open_client(endpoint, config.namespace, timeout_s=known.wait)
        plant = Plant(truth, session, known.rate, known.deadline, known.wait, config.network)
        try:
            plant.run()
        finally:
            plant.close()

    anywhere.main(find, known.router, known.check, body)
