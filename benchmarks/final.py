"""`python -m benchmarks.final`: all figures of docs/performance.md about the loop, in one run of at most 12 minutes.

Run it on a machine without other load. A round runs every variant once, and the order alternates from round to round,
so a slow minute slows all of them. The table has the median of the ratios within a
round and their spread. The result goes to benchmarks/results/DATE-final.json; `--from` prints it again.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

from benchmarks import agents, cost
from benchmarks.loop import DROPS, ours, ring
from benchmarks.peers.network import Network
from benchmarks.suite import HERE, adopt_orphans, commit, end_all, machine, network_of, run_once

BUDGET_S = 660.0
STEPS = {7: 4000, 20: 1500, 60: 500}
"""by number of nodes: two to three seconds of our loop on two free cores"""
CPU_ROUNDS = 3
BEGIN, END = "<!-- figures of benchmarks.final -->", "<!-- end of the figures -->"
"""the lines of a page before and after the tables"""
MANY = 100
"""processes of the network in which the first step of many processes is timed"""
VARIANTS = {
    "run.rrd": (("--record",), "none"),
    "run.rrd and page": (("--record",), "web"),
    "30 % drops": (("--no-record", "--set", f"faults={json.dumps(DROPS)}"), "none"),
    "secure": (("--no-record", "--secure"), "none"),
}
"""options and viewer of runs that are compared with a plain one"""


@dataclass(frozen=True)
class Aim:
    """A ratio of two speeds, and its aim."""

    title: str
    above: str
    below: str
    least: float


AIMS = [
    *(Aim(f"ours / Zenoh by hand, {n} nodes", f"ours {n}", f"zenoh {n}", 0.9) for n in STEPS),
    *(Aim(f"ours / pyzmq by hand, {n} nodes", f"ours {n}", f"pyzmq {n}", 0.8) for n in STEPS),
    *(Aim(f"{name} / plain, 7 nodes", name, "ours 7", 0.8 if name == "30 % drops" else 0.9) for name in VARIANTS),
]

Run = Callable[[], Mapping[str, float]]
"""makes one run and returns numbers by name"""


def runs(folder: Path, quick: bool) -> dict[str, Run]:
    """Return every run of a round, by name."""
    made: dict[str, Run] = {}
    for nodes, many in STEPS.items():
        steps, network = 50 if quick else many, network_of(nodes, folder)
        made |= {f"{peer} {nodes}": partial(_by_hand, peer, network, steps) for peer in ("zenoh", "pyzmq")}
        made[f"ours {nodes}"] = partial(_ours, network.file, steps, "--no-record")
        if nodes == 7:
            for name, (options, viewer) in VARIANTS.items():
                made[name] = partial(_ours, network.file, steps, *options, viewer=viewer)
    made[f"ours {MANY}"] = partial(_ours, ring(MANY, folder), 20, "--no-record")
    return made


def _ours(file: str, steps: int, *options: str, viewer: str = "none") -> Mapping[str, float]:
    verdict = ours(file, "--steps", str(steps), "--processes", "per-node", *options, viewer=viewer)
    return {name: verdict[name] for name in ("steps_per_s", "first_step_s") if verdict[name]}


def _by_hand(peer: str, network: Network, steps: int) -> Mapping[str, float]:
    one = run_once(peer, network, steps, 0)
    if one.steps_per_s is None or one.first_step_s is None or not one.equal:
        raise SystemExit(one.failure or "the trajectory differs")
    return {"steps_per_s": one.steps_per_s, "first_step_s": one.first_step_s}


def measure(budget_s: float, quick: bool, began: float) -> list[dict[str, Mapping[str, float]]]:
    """Run rounds until the next would pass the budget; a run that fails is left out of its round, by name."""
    rounds: list[dict[str, Mapping[str, float]]] = []
    longest = 0.0
    with tempfile.TemporaryDirectory(prefix="hedgerow-") as scratch:
        made = list(runs(Path(scratch), quick).items())
        while not rounds or (not quick and time.monotonic() - began + longest < budget_s):
            started, done = time.monotonic(), dict[str, Mapping[str, float]]()
            for name, run in made if len(rounds) % 2 == 0 else reversed(made):
                try:
                    done[name] = run()
                except SystemExit as error:
                    print(f"{name}: {error}", file=sys.stderr)
                print(f"round {len(rounds) + 1}: {name}: {done.get(name)}", file=sys.stderr)
            rounds.append(done)
            longest = max(longest, time.monotonic() - started)
    return rounds


def cpu_of_a_step(rounds: int, steps: int) -> list[dict[str, float]]:
    """Return the CPU time of a step [us] of paper7 by process, and of the Zenoh loop as a whole, in every round."""
    measured = []
    with tempfile.TemporaryDirectory(prefix="hedgerow-") as scratch:
        network = network_of(7, Path(scratch))
        for _ in range(rounds):
            used, made = cost.ours(network, steps)
            # The processes in the order of their start: `up`, the server that forks the others, the plant, the agents.
            table: dict[str, float] = {}
            for thread, (cpu_us, _) in cost.by_role(used, made).items():
                rank, name = thread.split(":")
                who = {"0": "`up`", "1": "`up`", "2": f"the plant, thread {name}"}.get(rank, "seven agents")
                table[who] = table.get(who, 0.0) + cpu_us
            table["all"] = sum(table.values())
            table["Zenoh by hand, all"] = cost.total(*cost.by_hand("zenoh", network, steps)).cpu_s
            measured.append(table)
    return measured


def put_into(page: Path, text: str) -> None:
    """Replace the text between the two marks of a page; SystemExit if it has none."""
    whole = page.read_text(encoding="utf-8")
    before, begin, rest = whole.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not end:
        raise SystemExit(f"{page}: has no lines {BEGIN} and {END}. Add them.")
    page.write_text(f"{before}{begin}\n\n{text}\n\n{end}{after}", encoding="utf-8")


def spread(values: Sequence[float], digits: int = 2) -> tuple[str, str]:
    """Return the median, and the least and the greatest value, as text."""
    if not values:
        return "none", ""
    return f"{statistics.median(values):.{digits}f}", f"{min(values):.{digits}f} to {max(values):.{digits}f}"


def load_of(result: Mapping[str, Any]) -> str:
    """Return the load of the machine before the first round, as text; older results do not have it."""
    return f"load {result['load']:.1f} before the first round" if "load" in result else "load not recorded"


def table(result: Mapping[str, Any]) -> str:
    """Return the result as tables in Markdown, with its machine, date and command."""
    rounds = result["rounds"]
    lines = [
        f"`python -m benchmarks.final`, {result['date']}, commit {result['commit']}: {result['machine']},"
        f" {result['cores']} cores, Linux {result['kernel']}, Python {result['python']}, {result['versions']};"
        f" {load_of(result)}",
        "",
        "| ratio of speeds | median | spread | aim | by the median | rounds at the aim |",
        "|---|---|---|---|---|---|",
    ]
    for aim in AIMS:
        ratios = [
            one[aim.above]["steps_per_s"] / one[aim.below]["steps_per_s"]
            for one in rounds
            if aim.above in one and aim.below in one
        ]
        median, around = spread(ratios)
        reached = "" if not ratios else "reaches it" if statistics.median(ratios) >= aim.least else "misses it"
        at_the_aim = sum(ratio >= aim.least for ratio in ratios)
        lines.append(f"| {aim.title} | {median} | {around} | {aim.least} | {reached} | {at_the_aim} of {len(ratios)} |")
    lines += ["", "| speed | median [steps/s] | spread | first step, median [s] | spread |", "|---|---|---|---|---|"]
    for name in dict.fromkeys(name for one in rounds for name in one):
        own = [one[name] for one in rounds if name in one]
        rate, rates = spread([one["steps_per_s"] for one in own if "steps_per_s" in one], 0)
        first, firsts = spread([one["first_step_s"] for one in own if "first_step_s" in one])
        lines.append(f"| {name} | {rate} | {rates} | {first} | {firsts} |")
    lines += ["", "| CPU time of a step, paper7 | median [us] | spread |", "|---|---|---|"]
    for name in result["cpu_us"][0]:
        us, around = spread([one[name] for one in result["cpu_us"] if name in one], 0)
        if float(us) > 0:
            lines.append(f"| {name} | {us} | {around} |")
    lines += [
        "",
        f"Aims of the first step: 0.5 s with 7 processes, 1 s with {MANY}."
        f" Memory of an agent of paper7: PSS {result['pss_mb']:.1f} MB (aim 9), RSS {result['rss_mb']:.1f} MB.",
    ]
    return "\n".join(lines)


def main() -> None:
    """Measure, write the result and print the tables."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--seconds", type=float, default=BUDGET_S, help="time for all rounds [%(default)s]")
    parser.add_argument("--quick", action="store_true", help="one round of short runs; writes no result")
    parser.add_argument("--from", dest="result", type=Path, metavar="JSON", help="print that result, and run nothing")
    parser.add_argument("--page", type=Path, help="put the tables into this page, between its marks")
    known = parser.parse_args()
    result = json.loads(known.result.read_text(encoding="utf-8")) if known.result else _run(known)
    print(table(result))
    if known.page:
        put_into(known.page, table(result))


def _run(known: argparse.Namespace) -> dict[str, Any]:
    adopt_orphans()
    began, load = time.monotonic(), os.getloadavg()[0]
    try:
        memory = agents.measure()
        cpu_us = cpu_of_a_step(1 if known.quick else CPU_ROUNDS, 200 if known.quick else STEPS[7])
        rounds = measure(known.seconds, known.quick, began)
    finally:
        end_all()
    result = {
        "date": date.today().isoformat(),
        "commit": commit(),
        **machine(),
        "load": load,
        "versions": ", ".join(f"{name} {version(name)}" for name in ("eclipse-zenoh", "pyzmq", "numpy")),
        "pss_mb": memory.pss_mb,
        "rss_mb": memory.rss_mb,
        "cpu_us": cpu_us,
        "rounds": rounds,
    }
    if not known.quick:
        file = HERE / "results" / f"{result['date']}-final.json"
        file.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
        print(file, file=sys.stderr)
    return result


if __name__ == "__main__":
    main()
