"""Keys in a folder of any name: Zenoh copies their settings into an endpoint, which ends at `#` and `?`."""

from __future__ import annotations

from pathlib import Path

import pytest

from hedgerow.orchestrator.launch.certificates import to_carry
from hedgerow.wire.credentials import Credentials
from hedgerow.wire.ports import free_port
from hedgerow.wire.session import close, open_client, open_router
from tests.tools.rights import PLACES

NAMESPACE = "hedgerow/paper7"


@pytest.mark.parametrize("name", ["a#b", "a?b=c;d", "$(a) 'b' \"c\"", "line\nfeed", "caf\udce9", "%2f*", "r" * 255])
def test_a_router_reads_its_keys_from_any_folder(here: Path, name: str) -> None:
    port = free_port()
    to_carry(Path(name), PLACES, NAMESPACE, f"tls/127.0.0.1:{port}", days=1)
    router = open_router(f"tls/127.0.0.1:{port}", NAMESPACE, Path(name, "router"))
    try:
        close(open_client(f"tls/127.0.0.1:{port}", NAMESPACE, Credentials.read(Path(name, PLACES[0].name))))
    finally:
        close(router)
