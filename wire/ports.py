"""Free TCP ports."""

from __future__ import annotations

import errno
import socket

from hedgerow.topologies.errors import Code, HedgerowError, UserError
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


_TAKEN = {
    errno.EADDRINUSE: "the port is in use. End the program that has it, or choose another port.",
    errno.EADDRNOTAVAIL: "the address is not one of this machine. Write 0.0.0.0 for all of its addresses.",
    errno.EACCES: "the port needs more rights. Choose one from 1024.",
}


def check_listen(endpoint: str, option: str = "--listen") -> None:
    """Raise UserError for a TCP or TLS endpoint on which no program of this user can listen now.

    Zenoh would report it after the processes of a run have started.
    """
    transport, _, address = endpoint.partition("#")[0].partition("?")[0].partition("/")
    host, _, port = address.rpartition(":")
    if transport not in ("tcp", "tls") or not (port.isascii() and port.isdecimal()):
        return
    host = host.removeprefix("[").removesuffix("]")
    try:
        family, _, _, _, where = socket.getaddrinfo(host or None, int(port), type=socket.SOCK_STREAM)[0]
        with socket.create_server(where[:2], family=family):
            pass
    except socket.gaierror as error:
        what = f"the host has no address: {error.strerror}. Write the address of an interface, or 0.0.0.0."
        raise UserError(f"{option} {endpoint}: {what}", code=Code.OPTION) from None
    except OSError as error:
        if error.errno in _TAKEN:
            raise UserError(f"{option} {endpoint}: {_TAKEN[error.errno]}", code=Code.OPTION) from None
    except (OverflowError, ValueError):  # the check of endpoints names it
        return
