"""A chosen port stays free for its user."""

from __future__ import annotations

import errno
import socket
import struct

import pytest

from hedgerow.wire.ports import free_port

IP_LOCAL_PORT_RANGE = 51
"""Linux 6.3: from which ports the kernel chooses one for this socket."""


def choosing_from(port: int) -> socket.socket:
    """Provide a socket for which the kernel can choose only this port."""
    one = socket.socket()
    try:
        one.setsockopt(socket.IPPROTO_IP, IP_LOCAL_PORT_RANGE, struct.pack("I", port << 16 | port))
    except OSError:
        one.close()
        pytest.skip("the kernel's choice of a port cannot be narrowed here")
    return one


@pytest.mark.parametrize("host", ["127.0.0.1", "127.0.0.2"])
@pytest.mark.parametrize("asking", ["there", "everywhere"])
def test_a_free_port_is_only_given_on_request(host: str, asking: str) -> None:
    """This happened to a plant at another address than 127.0.0.1: another program of its machine had received the
    port.
    """
    port = free_port(host)
    with choosing_from(port) as other, pytest.raises(OSError, match=r".") as caught:
        other.bind((host if asking == "there" else "0.0.0.0", 0))
    assert caught.value.errno == errno.EADDRINUSE
    with socket.create_server((host, 0)) as far, choosing_from(port) as other, pytest.raises(OSError, match=r"."):
        other.connect(far.getsockname())
    socket.create_server((host, port)).close()
