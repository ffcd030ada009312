"""A Rerun page and its data on one port, so that a container can publish it and any browser can open it.

Rerun serves its page on one port and streams the data to it on another. Each connection here carries one request, and
goes to the server that can answer it. A request for a page
without a data source is redirected to the data of this run, by the host name that the browser used. A separate process
serves it, so that a slow browser never slows a run.
"""

from __future__ import annotations

import asyncio
import contextlib
import sys
from urllib.parse import quote, urlsplit

HOST = "127.0.0.1"
HEAD_BYTES = 2**16
CHUNK_BYTES = 2**16
HEAD_S = 10.0
"""The time limit for the head of a request [s]: a slow browser would hold a connection forever."""


def rewritten(head: bytes) -> bytes:
    """Return the head of a request, changed to close the connection after the answer: the next request may go to the
    other port.
    """
    first, *lines = head.removesuffix(b"\r\n\r\n").split(b"\r\n")
    others = [line for line in lines if line.partition(b":")[0].strip().lower() not in (b"connection", b"keep-alive")]
    return b"\r\n".join([first, *others, b"Connection: close"]) + b"\r\n\r\n"


def target(head: bytes) -> str:
    """Return the target of a request: path and query."""
    words = head.split(b"\r\n", 1)[0].split()
    return words[1].decode("latin-1") if len(words) > 1 else "/"


def redirect(head: bytes, asked: str) -> bytes | None:
    """Return the answer to a request for the bare page: a redirect to our data; None for any other request."""
    address = urlsplit(asked)
    if address.path != "/" or "url=" in address.query:
        return None
    names = [line.partition(b":")[2] for line in head.split(b"\r\n") if line.lower().startswith(b"host:")]
    host = names[0].strip().decode("latin-1") if names else ""
    where = f"/?url={quote(f'rerun+http://{host}/proxy', safe='')}&theme=dark"
    return f"HTTP/1.1 302 Found\r\nLocation: {where}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n".encode(
        "latin-1"
    )


async def _pump(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with contextlib.suppress(OSError):
        while some := await reader.read(CHUNK_BYTES):
            writer.write(some)
            await writer.drain()
        writer.write_eof()


async def _answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, data: int, page: int) -> None:
    # TimeoutError is an OSError.
    with contextlib.suppress(OSError, asyncio.IncompleteReadError, asyncio.LimitOverrunError):
        head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), HEAD_S)
        asked = target(head)
        elsewhere = redirect(head, asked)
        if elsewhere is not None:
            writer.write(elsewhere)
            await writer.drain()
        else:
            port = data if asked.startswith("/rerun.") else page
            from_there, to_there = await asyncio.open_connection(HOST, port)
            to_there.write(rewritten(head))
            up = asyncio.create_task(_pump(reader, to_there))
            await _pump(from_there, writer)
            up.cancel()
            to_there.close()
    writer.close()


async def _serve(host: str, port: int, data: int, page: int) -> None:
    async def on_connection(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await _answer(reader, writer, data, page)

    server = await asyncio.start_server(on_connection, host, port, limit=HEAD_BYTES)
    async with server:
        await server.serve_forever()


def main() -> None:
    """Run `python -m hedgerow.orchestrator.views.rerun.one_port HOST PORT DATA PAGE`: serve until killed."""
    host, *ports = sys.argv[1:]
    asyncio.run(_serve(host, *map(int, ports)))


if __name__ == "__main__":
    main()
