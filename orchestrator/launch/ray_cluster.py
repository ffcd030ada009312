"""The connection to a Ray cluster: for the tasks of a sweep, and for the agents of a network."""

from __future__ import annotations

import contextlib
import logging
import os
import socket
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from hedgerow.topologies.errors import Code, UserError

CLIENT_PORT = 10001
LISTEN_DEADLINE_S = 5.0
INSTALL = "install it with: pip install 'hedgerow[ray]'"


@dataclass(frozen=True)
class RayCluster:
    """A Ray cluster that this process is part of, or a client of."""

    ray: Any
    """the module"""
    address: str
    """the address in the user's words"""
    here: str
    """our IP address, as seen by its machines"""

    @property
    def machines(self) -> set[str]:
        """Return the IP addresses of its machines."""
        return {node["NodeManagerAddress"] for node in self.ray.nodes() if node["Alive"]}

    @property
    def free_cpus(self) -> float:
        """Return the number of free CPUs."""
        return float(self.ray.available_resources().get("CPU", 0.0))


def check(address: str) -> None:
    """Raise UserError for a text that is not the address of a cluster."""
    if address == "ray":
        return
    if not address.startswith("ray://"):
        raise UserError(f"--on {address}: is no cluster; write ray, or ray://HOST:PORT", code=Code.OPTION)
    host, port = _host_and_port(address)
    if not host or not port.isdecimal():
        raise UserError(f"--on {address}: names no port; write ray://HOST:{CLIENT_PORT}", code=Code.OPTION)


def _host_and_port(address: str) -> tuple[str, str]:
    host, _, port = address.removeprefix("ray://").rpartition(":")
    return host.strip("[]"), port


@contextlib.contextmanager
def joined(address: str) -> Iterator[RayCluster]:
    """Provide a cluster while the block lasts: `address` is ray://HOST:PORT, its client port; or `ray`.

    `ray` means the cluster of this machine, or otherwise a temporary one on its cores. Raise UserError if there is no
    cluster.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        import ray  # noqa: PLC0415
    except ModuleNotFoundError:
        raise UserError(f"--on ray: Ray is not installed; {INSTALL}", code=Code.DEPENDENCY) from None
    here = None if address == "ray" else _way_to(address)
    try:
        ray.init(
            address=None if address == "ray" else address,
            logging_level=logging.ERROR,
            log_to_driver=False,
            include_dashboard=False,
        )
    except (ConnectionError, OSError, RuntimeError, ValueError, ImportError) as error:
        reason = " ".join((str(error).strip() or type(error).__name__).split())[:300]
        cure = INSTALL if isinstance(error, ImportError) else "is `ray start --head` running there?"
        raise UserError(f"--on {address}: no cluster: {reason}; {cure}") from None
    try:
        yield RayCluster(ray, address, here or ray.util.get_node_ip_address())
    finally:
        ray.shutdown()


def _way_to(address: str) -> str:
    """Return our own address on the way to a cluster; raise UserError if it does not answer.

    Ray itself would try for half a minute, without a clear error.
    """
    host, port = _host_and_port(address)
    try:
        with socket.create_connection((host, int(port)), LISTEN_DEADLINE_S) as way:
            return str(way.getsockname()[0])
    except OSError as error:
        raise UserError(
            f"--on {address}: no cluster: {error.strerror or error}; is `ray start --head` running there? clients use"
            f" port {CLIENT_PORT}, unless it has another --ray-client-server-port"
        ) from None
