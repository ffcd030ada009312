"""A Ray cluster, joined: for a sweep, whose runs are its tasks, and for a network, whose agents it places."""

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
    """A cluster, and we a part or a client of it."""

    ray: Any
    """the module"""
    address: str
    """as the user named it"""
    here: str
    """our own IP address, as its machines see it"""

    @property
    def machines(self) -> set[str]:
        """The IP addresses of its machines."""
        return {node["NodeManagerAddress"] for node in self.ray.nodes() if node["Alive"]}

    @property
    def free_cpus(self) -> float:
        """How many CPUs nobody has taken."""
        return float(self.ray.available_resources().get("CPU", 0.0))


def check(address: str) -> None:
    """Raise UserError for what names no cluster."""
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
    """A cluster while the block lasts: `address` is ray://HOST:PORT, its client port; or `ray`.

    That is the one that this machine is part of, else one of its own cores, which is gone after the block. Raises
    UserError where there is none.
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
    """Our own address on the way to a cluster. Ray would try for half a minute, and not say what is wrong."""
    host, port = _host_and_port(address)
    try:
        with socket.create_connection((host, int(port)), LISTEN_DEADLINE_S) as way:
            return str(way.getsockname()[0])
    except OSError as error:
        raise UserError(
            f"--on {address}: no cluster: {error.strerror or error}; is `ray start --head` running there? clients come"
            f" in at port {CLIENT_PORT}, if its --ray-client-server-port says nothing else"
        ) from None
