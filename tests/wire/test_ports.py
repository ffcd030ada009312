"""A chosen port stays free for its user."""

from __future__ import annotations

import errno
import socket
import struct
from pathlib import Path

import pytest

from hedgerow.topologies.errors import Code, Exit
from hedgerow.wire.ports import check_listen, free_port
from tests.tools.processes import orchestrator
from tests.tools.refusals import refusal

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


@pytest.mark.parametrize("transport", ["tcp", "tls"])
def test_a_port_in_use_is_refused_before_anything_starts(here: Path, transport: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        for host in ("127.0.0.1", "0.0.0.0", "localhost"):
            with refusal(Code.OPTION):
                check_listen(f"{transport}/{host}:{port}")
        if transport == "tcp":
            listen = ("--external", "3", "--listen", f"tcp/127.0.0.1:{port}")
            assert orchestrator("up", "paper7", "--viewer", "none", *listen).returncode == Exit.USER_MISTAKE
            assert not (here / "runs").exists()
    check_listen(f"{transport}/127.0.0.1:{port}")


@pytest.mark.parametrize("endpoint", ["tcp/192.0.2.1:7447", "tcp/no-such-host.invalid:7447"])
def test_an_address_of_another_machine_is_refused(endpoint: str) -> None:
    with refusal(Code.OPTION):
        check_listen(endpoint)


@pytest.mark.parametrize("endpoint", ["unixsock-stream//x", "tcp/h", "tcp/[::]:x", "", "tcp/127.0.0.1:99999"])
def test_other_endpoints_are_not_tried(endpoint: str) -> None:
    check_listen(endpoint)
