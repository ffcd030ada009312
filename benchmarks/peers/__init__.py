"""The same loop with other libraries: one file each, with one function `run(network, steps) -> Done`."""

from __future__ import annotations

import importlib
import importlib.util
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from benchmarks.peers.network import Done, Network


@dataclass(frozen=True)
class Peer:
    """A way to run the loop."""

    title: str
    links: str
    """the transport between neighbours"""
    module: str
    """the module in this package"""
    needs: str = "numpy"
    """the package that it imports"""
    distributions: tuple[str, ...] = ("numpy",)
    """the packages with reported versions"""
    variant: str = ""
    """passed to `run`, if a file has several variants"""

    @property
    def installed(self) -> bool:
        """Return True if it can run here."""
        return importlib.util.find_spec(self.needs) is not None

    def run(self, network: Network, steps: int) -> Done:
        """Run the loop."""
        module = importlib.import_module(f"benchmarks.peers.{self.module}")
        done: Done = module.run(network, steps, *([self.variant] if self.variant else []))
        return done


_OURS = ("eclipse-zenoh",)
_PER_NODE = "up --processes per-node"
PEERS = {
    "numpy": Peer("numpy in one process, no messages", "arrays", "floor"),
    "datagrams": Peer("unix datagrams, hand-written", "agent to agent", "datagrams"),
    "pyzmq": Peer("pyzmq push/pull, hand-written", "agent to agent", "pyzmq", "zmq", ("pyzmq",)),
    "zenoh": Peer("Zenoh, hand-written", "by its router", "zenoh_loop", "zenoh", _OURS),
    "helics": Peer("HELICS", "by its broker", "helics_loop", "helics", ("helics",)),
    "mosaik": Peer("mosaik", "by its scheduler", "mosaik_loop", "mosaik", ("mosaik", "mosaik-api-v3")),
    "dora": Peer("dora", "by its daemon", "dora_loop", "dora", ("dora-rs", "dora-rs-cli")),
    "ray": Peer("Ray compiled graph", "agent to agent", "ray_loop", "ray", ("ray",)),
    "mango": Peer("mango", "agent to agent", "mango_loop", "mango", ("mango-agents",)),
    "ours": Peer("Hedgerow, one process per node", "by its router", "ours", distributions=_OURS, variant=_PER_NODE),
    "ours-2": Peer("Hedgerow, two processes", "by its router", "ours", distributions=_OURS, variant="up --processes 2"),
    "simulate": Peer("Hedgerow, in-process engine", "arrays", "ours", variant="simulate"),
}
"""By name, in the order of the table."""
