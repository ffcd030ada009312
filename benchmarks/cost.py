"""`python -m benchmarks.cost`: CPU time and context switches of a step, by thread, of our loop and of others.

CPU time changes less than wall time on a machine that others use too, so a change that saves some is seen here first.
Rounds are interleaved. The table has medians over the rounds, and the ratio of speeds to another loop of the same
round. `drops` is our loop with 30 % of the link messages lost, in paper7.

`--laws` compares the laws of the project instead: two networks of paper7 run at the same time, one of them under
the law of the paper. Its table has the CPU time per step of the paper's law as a share of the other law's, over short
windows.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import re
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from benchmarks.loop import DROPS
from benchmarks.peers.cpu import Usage, Used, between, used_by
from benchmarks.peers.network import BEGAN, COUNT_CPU, Network
from benchmarks.suite import STEPS, adopt_orphans, end_all, network_of
from hedgerow.agents.laws import LAWS
from hedgerow.orchestrator.launch.live import Live
from hedgerow.orchestrator.runs import registry
from hedgerow.wire.runtime import runtime_environment

DROPPING = "drops"
ENDLESS = "100000000"
SETTLE_S = 1.0
WINDOW_S = 2.0


@contextlib.contextmanager
def endless(network: Network, *options: str) -> Iterator[tuple[int, Live]]:
    """Provide the process id and the control of an `orchestrator up` with these options that does not end."""
    with tempfile.TemporaryDirectory(prefix="hedgerow-") as folder:
        command = [sys.executable, "-m", "hedgerow.orchestrator", "up", network.file, "--viewer", "none"]
        command += ["--no-record", "--run-dir", f"{folder}/run", "--steps", ENDLESS, *options]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as up:
            assert up.stdout is not None
            next(line for line in up.stdout if line.startswith("step "))
            time.sleep(SETTLE_S)
            try:
                with Live(_run_of(up.pid)) as live:
                    yield up.pid, live
            finally:
                up.terminate()
                up.stdout.read()


def ours(network: Network, steps: int, *options: str) -> tuple[Usage, int]:
    """Return what `orchestrator up` with these options used in a number of steps, at least `steps`."""
    with endless(network, *options) as (pid, live):
        first, before = live.status()["step"], used_by(pid)
        while (step := live.status()["step"]) < first + steps:
            time.sleep(0.1)
        return between(before, used_by(pid)), step - first


def beside_the_paper(network: Network, law: str, windows: int) -> list[float]:
    """Return by window the CPU time per step under the paper's law as a share of that under another law.

    Both networks run at the same time, so they have the same load of the machine.
    """
    ratios = []
    with endless(network) as one, endless(network, "--law", law) as other:
        for _ in range(windows):
            before = [(used_by(pid), live.status()["step"]) for pid, live in (one, other)]
            time.sleep(WINDOW_S)
            after = [(used_by(pid), live.status()["step"]) for pid, live in (one, other)]
            costs = [total(between(u, v), last - t) for (u, t), (v, last) in zip(before, after, strict=True)]
            ratios.append(costs[0].cpu_s / costs[1].cpu_s)
    return ratios


def _run_of(pid: int) -> registry.Entry:
    return next(entry for entry in registry.running() if entry.pid == pid)


def by_hand(peer: str, network: Network, steps: int) -> tuple[Usage, int]:
    """Return what a peer used in four fifths of its steps, and their number."""
    with tempfile.TemporaryDirectory(prefix="hedgerow-") as scratch:
        folder = Path(scratch)
        network.write(folder / "network.json")
        command = [sys.executable, "-m", "benchmarks.peers", peer, str(folder / "network.json"), str(steps), scratch]
        environment = os.environ | runtime_environment() | {BEGAN: str(time.monotonic()), COUNT_CPU: "1"}
        try:
            subprocess.run(command, env=environment, check=True, timeout=300)
        finally:
            end_all()
        used = json.loads((folder / "used.json").read_text(encoding="utf-8"))
    return {(pid, tid, name): Used(cpu, waits) for pid, tid, name, cpu, waits in used}, steps - steps // 5


def by_role(used: Usage, steps: int) -> dict[str, tuple[float, float]]:
    """Return the CPU time [us] and the waits per step, by thread name and rank of the process."""
    busy = sorted({pid for pid, _, _ in used})
    table: dict[str, tuple[float, float]] = {}
    for (pid, _, name), one in sorted(used.items()):
        key = f"{busy.index(pid)}:{re.sub(r'[0-9]+$', '', name)}"
        cpu, waits = table.get(key, (0.0, 0.0))
        table[key] = cpu + 1e6 * one.cpu_s / steps, waits + one.waits / steps
    return table


def total(used: Usage, steps: int) -> Used:
    """Return the CPU time [us] and the waits of a step."""
    return Used(1e6 * sum(one.cpu_s for one in used.values()) / steps, sum(one.waits for one in used.values()) // steps)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--only", default="pyzmq,zenoh,ours")
    parser.add_argument("--beside", default="zenoh", help="the loop to compare with [%(default)s]")
    parser.add_argument("--nodes", default="7")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--steps", type=int, help="steps of a run; without it, as many as take some seconds")
    parser.add_argument("--threads", action="store_true", help="print every thread of the last round")
    parser.add_argument("--laws", nargs="?", const=",".join(LAWS), help="the laws to compare with the paper's")
    parser.add_argument("--windows", type=int, default=5, help="windows of 2 s for each law")
    known = parser.parse_args()
    adopt_orphans()
    with tempfile.TemporaryDirectory(prefix="hedgerow-") as scratch:
        for law in known.laws.split(",") if known.laws else ():
            ratios = beside_the_paper(network_of(7, Path(scratch)), law, known.windows)
            print(f"{law:14}  {statistics.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})", flush=True)
        for nodes in map(int, known.nodes.split(",")) if not known.laws else ():
            network, steps = network_of(nodes, Path(scratch)), known.steps or STEPS.get(nodes, 300)
            _report(network, steps, known.only.split(","), known)


def _cost(peer: str, network: Network, steps: int) -> tuple[Usage, int]:
    if peer == DROPPING:
        return ours(network, steps, "--set", f"faults={json.dumps(DROPS)}")
    return ours(network, steps) if peer == "ours" else by_hand(peer, network, steps)


def _report(network: Network, steps: int, peers: Sequence[str], known: argparse.Namespace) -> None:
    done: dict[str, list[Used]] = {peer: [] for peer in peers}
    for _ in range(known.rounds):
        for peer in peers:
            used, made = _cost(peer, network, steps)
            done[peer].append(total(used, made))
            if known.threads:
                _print_threads(peer, by_role(used, made))
    for peer, rows in done.items():
        cpu, waits = (statistics.median(row[column] for row in rows) for column in (0, 1))
        ratios = [other.cpu_s / row.cpu_s for row, other in zip(rows, done.get(known.beside, rows), strict=True)]
        spread = f"{min(ratios):.2f} to {max(ratios):.2f}"
        print(
            f"{len(network)} nodes {peer:10} {cpu:8.0f} us {waits:6.0f} waits"
            f"  {statistics.median(ratios):.2f} ({spread})"
        )


def _print_threads(peer: str, table: Mapping[str, tuple[float, float]]) -> None:
    for key, (cpu, waits) in table.items():
        if cpu > 1:
            print(f"    {peer} {key:30} {cpu:8.1f} us {waits:6.2f} waits")


if __name__ == "__main__":
    main()
