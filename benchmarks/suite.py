"""`python -m benchmarks.suite`: our loop and the same loop with other libraries.

Every peer (benchmarks/peers/) runs the same network in the same steps. It has a process for every node and one for the
plant; x_i goes down, u_i up, and (x, u) to the neighbours, in lockstep and with the same law. Its trajectory is
compared with that of the in-process reference. Rounds are interleaved: a ratio is to the pyzmq loop of the same round,
and the table has medians.

The name of a missing peer is printed: `pip install -e '.[peers]'` installs all. After a run, and after Ctrl-C, no
process of a peer remains.
"""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import json
import os
import platform
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import date
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from benchmarks.loop import ring
from benchmarks.peers import PEERS
from benchmarks.peers.network import BEGAN, Array, Network
from hedgerow.orchestrator.ground.assignment import truth_of, views_of
from hedgerow.orchestrator.runs import reference as in_process
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from hedgerow.wire.message import Telemetry
from hedgerow.wire.runtime import runtime_environment

HERE = Path(__file__).parent
BESIDE = "pyzmq"
"""the peer that ratios refer to"""
NODES = (7, 20, 60)
STEPS = {7: 2000, 20: 800, 60: 300}
"""the number of steps by the number of nodes; a larger network has the smallest one"""
OURS = ("ours", "ours-2", "simulate")
QUICK_STEPS = 20
FASTER = {"numpy": 10, "datagrams": 2, "simulate": 2}
"""peers with this multiple of the steps, to last as long as the others"""
DEADLINE_S = 300.0


@dataclass(frozen=True)
class Round:
    """One run of one peer."""

    peer: str
    nodes: int
    round: int
    steps: int
    steps_per_s: float | None = None
    """None if it failed"""
    first_step_s: float | None = None
    pss_mb: float | None = None
    equal: bool | None = None
    """True if its trajectory equals that of the reference, bit for bit"""
    off_by: float | None = None
    """the largest difference of a state or an input, if not"""
    failure: str = ""


def network_of(nodes: int, folder: Path) -> Network:
    """Return paper7 for seven nodes, otherwise a ring."""
    file = "paper7" if nodes == 7 else ring(nodes, folder)
    topology = resolve(load(file))
    own = topology.nodes.values()
    whole = topology.network
    assert isinstance(whole.b, float)
    return Network(
        file=file,
        b=whole.b,
        a=whole.a.tolist(),
        x0=whole.x0.tolist(),
        candidates=[column[~np.isnan(column)].tolist() for column in whole.candidates.T],
        edges=whole.graph.edges.tolist(),
        disturbance=[_components(node.disturbance) for node in own],
        seed=topology.seed,
    )


def _components(disturbance: Any) -> list[dict[str, Any]]:
    return [part.model_dump() for part in (disturbance if isinstance(disturbance, tuple) else (disturbance,))]


def reference(network: Network, steps: int) -> tuple[Array, Array]:
    """Return x(0) to x(T - 1) and u(0) to u(T - 1) of the in-process reference, (T, n) both."""
    topology = resolve(load(network.file).model_copy(update={"steps": steps}))
    everybody = [range(len(network))]
    rows = in_process.run(truth_of(topology, everybody), views_of(topology, everybody))
    pairs = [(row.x, row.u) for row in rows if isinstance(row, Telemetry)]
    return np.array([x for x, _ in pairs]), np.array([u for _, u in pairs])


def adopt_orphans() -> None:
    """Adopt processes after the end of their parents (Linux), so that `end_all` finds them."""
    pr_set_child_subreaper = 36
    ctypes.CDLL(None).prctl(pr_set_child_subreaper, 1)


def end_all() -> None:
    """Kill all processes that this one, or a descendant, has started."""
    while children := psutil.Process().children(recursive=True):
        for child in children:
            with contextlib.suppress(psutil.NoSuchProcess):
                child.kill()
        psutil.wait_procs(children, timeout=5)


def run_once(peer: str, network: Network, steps: int, number: int) -> Round:
    """Return one run in separate processes; none of them remains."""
    with tempfile.TemporaryDirectory(prefix="hedgerow-") as scratch:
        folder = Path(scratch)
        network.write(folder / "network.json")
        command = [sys.executable, "-m", "benchmarks.peers", peer, str(folder / "network.json"), str(steps), scratch]
        environment = os.environ | runtime_environment() | {BEGAN: str(time.monotonic())}
        outcome = Round(peer, len(network), number, steps)
        try:
            with (folder / "log").open("w+", encoding="utf-8") as log:
                subprocess.run(command, env=environment, stdout=log, stderr=log, timeout=DEADLINE_S, check=True)
            done = json.loads((folder / "done.json").read_text(encoding="utf-8"))
            with np.load(folder / "trajectory.npz") as trajectory:
                pairs = [
                    (trajectory[name][:steps], is_) for name, is_ in zip("xu", reference(network, steps), strict=True)
                ]
        except (subprocess.SubprocessError, OSError) as error:
            tail = (folder / "log").read_text(encoding="utf-8", errors="replace").strip()[-2000:]
            print(f"{peer}: {error}\n{tail}", file=sys.stderr)
            return Round(**asdict(outcome) | {"failure": type(error).__name__})
        finally:
            end_all()
    equal = all(one.tobytes() == other.tobytes() for one, other in pairs)
    off_by = None if equal else max(float(np.max(np.abs(one - other))) for one, other in pairs)
    return Round(**asdict(outcome) | done | {"equal": equal, "off_by": off_by})


def steps_of(peer: str, nodes: int, quick: bool) -> int:
    """Return the number of steps of a peer with this number of nodes."""
    if quick:
        return QUICK_STEPS
    return STEPS.get(nodes, min(STEPS.values())) * FASTER.get(peer, 1)


def measure(peers: Sequence[str], sizes: Sequence[int], rounds: int, quick: bool) -> list[Round]:
    """Return all runs: for every size, in every round, each peer in turn."""
    done = []
    with tempfile.TemporaryDirectory(prefix="hedgerow-") as scratch:
        for nodes in sizes:
            network = network_of(nodes, Path(scratch))
            for number in range(rounds):
                for peer in peers:
                    one = run_once(peer, network, steps_of(peer, nodes, quick), number)
                    rate = one.failure or f"{one.steps_per_s:.0f} steps/s"
                    print(f"{nodes} nodes, round {number + 1} of {rounds}, {peer}: {rate}", file=sys.stderr)
                    done.append(one)
    return done


@dataclass(frozen=True)
class Row:
    """Medians of one peer at one size."""

    peer: str
    nodes: int
    steps_per_s: float
    ratio: float | None
    """the ratio to BESIDE in the same round; None if that did not run"""
    first_step_s: float
    pss_mb: float
    equal: bool


def medians(rounds: Sequence[Round]) -> list[Row]:
    """Return one row for each peer and size, from the rounds that did not fail."""
    ran = [one for one in rounds if not one.failure]
    beside = {(one.nodes, one.round): one.steps_per_s for one in ran if one.peer == BESIDE}
    rows = []
    for peer, nodes in dict.fromkeys((one.peer, one.nodes) for one in ran):
        own = [one for one in ran if (one.peer, one.nodes) == (peer, nodes)]
        ratios = [
            one.steps_per_s / other for one in own if one.steps_per_s and (other := beside.get((nodes, one.round)))
        ]
        rates, starts, sizes = (
            [getattr(one, name) for one in own] for name in ("steps_per_s", "first_step_s", "pss_mb")
        )
        rows.append(
            Row(
                peer,
                nodes,
                statistics.median(rates),
                statistics.median(ratios) if ratios else None,
                statistics.median(starts),
                statistics.median(sizes),
                all(one.equal for one in own),
            )
        )
    return rows


def table(rows: Sequence[Row], failed: Sequence[Round], skipped: Sequence[str]) -> str:
    """Return the rows as a table in Markdown, and the names of missing peers."""
    sizes = sorted({row.nodes for row in rows})
    most = max(sizes, default=0)
    head = ["loop"] + [f"N = {n} [steps/s]" for n in sizes] + [f"ratio at {n}" for n in sizes]
    head += [f"memory at {most} [MB]", f"first step at {most} [s]", "links", "equal"]
    lines = [head, ["---"] * len(head)]
    for peer, kind in PEERS.items():
        own = {row.nodes: row for row in rows if row.peer == peer}
        if not own:
            continue
        rates = [f"{own[n].steps_per_s:.0f}" if n in own else "failed" for n in sizes]
        ratios = [f"{own[n].ratio:.2f}" if n in own and own[n].ratio is not None else "" for n in sizes]
        last = own.get(most)
        size, start = (f"{last.pss_mb:.0f}", f"{last.first_step_s:.1f}") if last else ("", "")
        equal = "yes" if all(row.equal for row in own.values()) else "NO"
        lines.append([kind.title, *rates, *ratios, size, start, kind.links, equal])
    text = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    for one in failed:
        text += f"\n{one.peer}: failed with {one.nodes} nodes, round {one.round + 1}: {one.failure}"
    for peer in skipped:
        text += f"\n{peer}: not installed, passed over"
    return text


def machine() -> dict[str, Any]:
    """Return the facts of this machine."""
    return {
        "machine": platform.machine(),
        "cores": os.cpu_count(),
        "memory_gb": round(psutil.virtual_memory().total / 2**30),
        "kernel": platform.release(),
        "python": platform.python_version(),
    }


def commit() -> str:
    """Return the commit that ran, with `+` if the files differ from it; empty outside a repository."""
    command = ["git", "-C", str(HERE), "describe", "--always", "--dirty=+", "--exclude=*"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.stdout.strip()


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description="Measure our loop beside the same loop by other means.", epilog=f"peers: {', '.join(PEERS)}"
    )
    parser.add_argument("--only", metavar="NAMES", help="peers, by commas [all]")
    parser.add_argument("--nodes", default=",".join(map(str, NODES)), help="sizes, by commas [%(default)s]")
    parser.add_argument("--rounds", type=int, default=3, help="[%(default)s]")
    quick = f"one round of {QUICK_STEPS} steps: does it all still work? Writes no file that is not asked for"
    parser.add_argument("--quick", action="store_true", help=quick)
    parser.add_argument(
        "--results", type=Path, metavar="FOLDER", help="where DATE.json, or DATE-SIZES.json, goes [benchmarks/results]"
    )
    parser.add_argument("--plot", type=Path, metavar="FILE", help="an .svg or .png file [docs/images/peers.svg of all]")
    parser.add_argument("--from", dest="result", type=Path, metavar="JSON", help="run nothing: show that result")
    known = parser.parse_args()
    if not known.quick and known.result is None:
        known.results = known.results or HERE / "results"
        if _of_all(known):
            known.plot = known.plot or HERE.parent / "docs/images/peers.svg"
    return known


def _of_all(known: argparse.Namespace) -> bool:
    """Return True if all peers are measured at the sizes of the table in docs/performance.md."""
    return known.only is None and known.nodes == ",".join(map(str, NODES))


def _names(only: str | None) -> list[str]:
    if only is None:
        return list(PEERS)
    asked = only.split(",")
    if unknown := set(asked) - set(PEERS):
        raise SystemExit(f"--only {','.join(sorted(unknown))}: there is no such peer; there are {', '.join(PEERS)}")
    return asked


def _run(known: argparse.Namespace) -> dict[str, Any]:
    names = _names(known.only)
    skipped = [name for name in names if not PEERS[name].installed]
    peers = [name for name in names if name not in skipped]
    sizes = [int(n) for n in known.nodes.split(",")]
    adopt_orphans()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        rounds = measure(peers, sizes, 1 if known.quick else known.rounds, known.quick)
    except KeyboardInterrupt:
        raise SystemExit("interrupted: nothing is written") from None
    finally:
        end_all()
    packages = {package for peer in peers for package in PEERS[peer].distributions}
    return {
        "date": date.today().isoformat(),
        "commit": commit(),
        **machine(),
        "versions": {package: version(package) for package in sorted(packages)},
        "skipped": skipped,
        "rounds": [asdict(one) for one in rounds],
    }


def main() -> None:
    """Measure, print the table, and write the measurements; exit code 1 if a peer failed or is not equal."""
    known = _arguments()
    result = json.loads(known.result.read_text(encoding="utf-8")) if known.result else _run(known)
    if known.results and not known.result:
        known.results.mkdir(parents=True, exist_ok=True)
        more = "" if _of_all(known) else f"-{known.nodes.replace(',', '-')}"
        file = known.results / f"{result['date']}{more}.json"
        file.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
        print(file, file=sys.stderr)
    rounds = [Round(**one) for one in result["rounds"]]
    rows = medians(rounds)
    print(table(rows, [one for one in rounds if one.failure], result["skipped"]))
    if known.plot:
        _draw(rows, known.plot)
    if any(one.failure or not one.equal for one in rounds):
        raise SystemExit(1)


def _draw(rows: Sequence[Row], file: Path) -> None:
    from benchmarks.peers.plot import draw  # noqa: PLC0415  (matplotlib is needed for the picture alone)

    ratios = {
        kind.title: {row.nodes: row.ratio for row in rows if row.peer == peer and row.ratio is not None}
        for peer, kind in PEERS.items()
    }
    ours = [PEERS[peer].title for peer in OURS]
    draw({title: own for title, own in ratios.items() if own}, ours, BESIDE, file)


if __name__ == "__main__":
    main()
