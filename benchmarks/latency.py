"""`python -m benchmarks.latency`: the effect of latency on the answer times and the rate of paper7.

Every agent is behind a relay that delays each packet by a given time, in both directions. There are two relays between
two agents, like two cables from a machine to the switch and on to the next.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hedgerow.wire.ports import free_port

UP = (sys.executable, "-P", "-m", "hedgerow.orchestrator")
AGENT = (sys.executable, "-P", "-c", "from hedgerow.agents.standalone import main; main()")
AGENTS = range(1, 8)


async def _hold(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, delay_s: float) -> None:
    """Forward the data in order, each piece with the delay."""
    waiting: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue()

    async def bring() -> None:
        while True:
            due, piece = await waiting.get()
            if (left := due - time.monotonic()) > 0:
                await asyncio.sleep(left)
            if not piece:
                writer.close()
                return
            writer.write(piece)

    bringing = asyncio.create_task(bring())
    with contextlib.suppress(ConnectionError):
        while piece := await reader.read(2**16):
            waiting.put_nowait((time.monotonic() + delay_s, piece))
    waiting.put_nowait((time.monotonic() + delay_s, b""))
    await bringing


@contextlib.contextmanager
def relay(to_port: int, delay_s: float) -> Iterator[int]:
    """Provide a port that forwards to another one, with a delay for every packet."""
    loop = asyncio.new_event_loop()
    port = free_port()

    async def on_connection(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(ConnectionError):
            there = await asyncio.open_connection("127.0.0.1", to_port)
            await asyncio.gather(_hold(reader, there[1], delay_s), _hold(there[0], writer, delay_s))
        writer.close()

    server = loop.run_until_complete(asyncio.start_server(on_connection, "127.0.0.1", port))
    thread = threading.Thread(target=loop.run_forever, daemon=True)
    thread.start()
    try:
        yield port
    finally:
        loop.call_soon_threadsafe(server.close)
        loop.call_soon_threadsafe(loop.stop)
        thread.join()


def run(delay_s: float | None, steps: int, rate: float) -> dict[str, Any]:
    """Return the verdict of a run with this delay to its agents; None for no relay."""
    with tempfile.TemporaryDirectory(prefix="hedgerow-") as name, contextlib.ExitStack() as stack:
        folder, port = Path(name), free_port()
        network = ("paper7", "--steps", str(steps))
        bundle = (*UP, "bundle", *network, "--router", f"tcp/127.0.0.1:{port}", "--out", str(folder / "lab"))
        subprocess.run(bundle, check=True, capture_output=True)
        options = ("--external", "all", "--listen", f"tcp/127.0.0.1:{port}", "--rate", str(rate))
        command = (*UP, "up", *network, *options, "--viewer", "none", "--no-record", "--json", "--verify")
        up = stack.enter_context(
            subprocess.Popen(
                [*command, "--run-dir", str(folder / "run")],
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
            )
        )
        door = port if delay_s is None else stack.enter_context(relay(port, delay_s))
        for agent in AGENTS:
            words = (*AGENT, "--config", str(folder / f"lab/agent-{agent}.toml"), "--router", f"tcp/127.0.0.1:{door}")
            process = stack.enter_context(subprocess.Popen(words, stderr=subprocess.DEVNULL))
            stack.callback(process.kill)
        output, _ = up.communicate()
        verdict: dict[str, Any] = json.loads(output)
        if verdict["verdict"] != "valid":
            raise SystemExit(f"{verdict['verdict']}: {verdict['reasons']}")
        return verdict


def main() -> None:
    """Print a row for each delay: the answer times of the middle of the seven agents, and the longest of all."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--steps", type=int, default=300)
    parser.add_argument("--rate", type=float, default=0.0, help="steps per second, 0 for as fast as possible")
    parser.add_argument("--delays", type=float, nargs="*", default=[0, 5, 20], metavar="MS", help="one way")
    known = parser.parse_args()
    print("one way [ms]   round trip, median/99 %/most [ms]   steps/s")
    for delay in (None, *known.delays):
        verdict = run(None if delay is None else delay / 1000, known.steps, known.rate)
        figures = list(verdict["round_trips"].values())
        middle = [statistics.median(one[key] for one in figures) for key in ("median_ms", "p99_ms")]
        text = "/".join(f"{ms:.3g}" for ms in (*middle, max(one["max_ms"] for one in figures)))
        print(f"{'no relay' if delay is None else delay!s:<14} {text:<35} {verdict['steps_per_s']:.1f}", flush=True)


if __name__ == "__main__":
    main()
