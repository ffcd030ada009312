"""Sockets and keys of a run hold no text of the user's."""

from __future__ import annotations

import errno
import os
import socket
import tempfile
from pathlib import Path

import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st

from hedgerow.topologies.errors import Code, HedgerowError, UserError
from hedgerow.wire import sockets
from hedgerow.wire.keys import chunk
from hedgerow.wire.session import open_router
from hedgerow.wire.sockets import MAX_PATH_BYTES, check_socket, locator, socket_folder, socket_in

ANY_TEXT = st.text(alphabet=st.characters(), min_size=1, max_size=80)


@given(ANY_TEXT)
def test_any_text_is_one_chunk_of_a_key(text: str) -> None:
    key = chunk(text)
    assert str(zenoh.KeyExpr(f"a/{key}/b")) == f"a/{key}/b"
    assert not set(key) & set("/*$?#")


@given(ANY_TEXT, ANY_TEXT)
def test_two_texts_never_share_a_chunk(one: str, other: str) -> None:
    assert (chunk(one) == chunk(other)) == (one == other)


@given(st.text(alphabet=st.characters(exclude_characters="\0"), max_size=40))
def test_a_socket_never_takes_text_from_the_environment(name: str) -> None:
    for variable in ("XDG_RUNTIME_DIR", "TMPDIR"):
        with pytest.MonkeyPatch.context() as patch:
            try:
                patch.setenv(variable, f"/tmp/{name}")
            except UnicodeEncodeError:  # no environment can hold it
                return
            endpoint = locator(socket_in(socket_folder()))
            assert not set(endpoint) & set("#?")
            assert len(endpoint.removeprefix("unixsock-stream/")) <= MAX_PATH_BYTES


@given(st.text(alphabet="ab#?;& é\n", min_size=1, max_size=12))
def test_a_path_that_zenoh_would_cut_is_refused(name: str) -> None:
    if set(name) <= set("ab"):
        assert locator(Path("/tmp") / name).endswith(name)
    else:
        with pytest.raises(HedgerowError) as raised:
            locator(Path("/tmp") / name)
        assert raised.value.code == Code.WIRE


def test_a_file_of_the_users_is_no_place_to_listen(tmp_path: Path) -> None:
    file = Path(os.path.realpath("/tmp")) / f"{tmp_path.name}-{os.getpid()}"
    file.write_text("data")
    try:
        with pytest.raises(UserError) as raised:
            check_socket(f"unixsock-stream/{file}", "--listen")
        assert raised.value.code == Code.OPTION
        assert file.read_text() == "data"
    finally:
        file.unlink()


def test_the_socket_that_a_router_left_can_be_used_again() -> None:
    folder = socket_folder()
    folder.mkdir(mode=0o700)
    endpoint = locator(socket_in(folder))
    try:
        session = open_router(endpoint, "a")
        check_socket(endpoint, "--listen")
        session.close()  # type: ignore[no-untyped-call]
    finally:
        for left in folder.iterdir():
            left.unlink()
        folder.rmdir()


def test_a_file_system_without_sockets_is_passed_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As on some mounts of networks and containers, bind fails there, and no file remains."""

    class NoSockets(socket.socket):
        def bind(self, address: object) -> None:
            if str(address).startswith(str(short)):
                raise OSError(errno.EOPNOTSUPP, os.strerror(errno.EOPNOTSUPP))
            super().bind(address)  # type: ignore[arg-type]

    with tempfile.TemporaryDirectory(prefix="h", dir="/tmp") as name:
        short = Path(name)
        monkeypatch.setenv("XDG_RUNTIME_DIR", name)
        assert socket_folder().parent == short
        monkeypatch.setattr(socket, "socket", NoSockets)
        assert socket_folder().parent != short
        assert not list(short.iterdir())
        monkeypatch.setattr(sockets, "_bases", lambda: iter([short]))
        with pytest.raises(HedgerowError) as raised:
            socket_folder()
        assert raised.value.code == Code.LIMIT
