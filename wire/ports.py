"""Free TCP ports."""

from __future__ import annotations

import socket

from hedgerow.topologies.errors import Code, HedgerowError
from hedgerow.wire.limits import limit_reached

LOOPBACK = "127.0.0.1"


def free_port(host: str = LOOPBACK) -> int:
    """Return a free TCP port at `host`, an address of this machine; no other program receives it for a minute.

    Raises HedgerowError if that interface is down, as the loopback of a new network namespace is.

    A closed connection on the port removes it from the kernel's choice at that address (TIME_WAIT). A program that asks
    for the port by its number still receives it.
    """
    try:
        with socket.create_server((host, 0)) as listener:
            with socket.create_connection(listener.getsockname()):
                listener.accept()[0].close()
            return int(listener.getsockname()[1])
    except OSError as error:
        if (reached := limit_reached(error)) is not None:
            raise reached from None
        raise HedgerowError(
            f"no TCP port at {host}: {error.strerror or error}. Bring that network interface up"
            f"{': `ip link set lo up`' if host == LOOPBACK else ''}.",
            code=Code.WIRE,
        ) from None
