"""TCP ports that nobody uses."""

from __future__ import annotations

import socket

LOOPBACK = "127.0.0.1"


def free_port(host: str = LOOPBACK) -> int:
    """A TCP port that nobody uses at `host`, an address of this machine, and that nobody is given there for a minute.

    A connection that was closed on it keeps it out of the kernel's choice at that address (TIME_WAIT); who asks for it
    by its number gets it.
    """
    with socket.create_server((host, 0)) as listener:
        with socket.create_connection(listener.getsockname()):
            listener.accept()[0].close()
        return int(listener.getsockname()[1])
