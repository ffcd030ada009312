"""`python -m benchmarks.gate REV_A REV_B`: the speed of one revision as a ratio to another, on this machine, now.

Both revisions are unpacked beside each other and run with this Python and its packages. A round runs every case once
with each revision, and the order alternates from round to round. Rounds continue until the time is over. A case
compares the two runs of one round, so load that lasts longer than a round cancels. The table has the geometric mean of
the ratios B / A and its 95 % interval (Student's t on the logarithms).

The exit code is 1 if the whole interval of a case is below `--least`: revision B lost speed. The result of a case is
unclear if only a part of its interval is below.

CPU time is that of a command with all its processes, with their start. On a busy machine, its ratio varies less.
"""

from __future__ import annotations

import argparse
import io
import json
import math
import os
import platform
import resource
import statistics
import subprocess
import sys
import tarfile
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from scipy import stats

HERE = Path(__file__).parent
ROOT = HERE.parent
BUDGET_S = 285.0
"""the time for all rounds [s]; with unpacking, the total stays below five minutes"""
FEWEST = 3
"""the minimum number of rounds for a useful interval"""
LEAST = 0.9
DEADLINE_S = 120.0
CONFIDENCE = 0.95
COMMAND = (sys.executable, "-m", "hedgerow.orchestrator")
QUIET = ("--viewer", "none", "--no-record", "--json")


@dataclass(frozen=True)
class Case:
    """A command of both revisions, and the function that reads its speed."""

    name: str
    arguments: Sequence[str]
    read: Callable[[str, float], Mapping[str, float]]
    """returns speeds by name from the standard output and the time [s]"""


def verdict_speeds(output: str, _: float) -> Mapping[str, float]:
    """Return the speeds that a run reports: steps per second, and first steps per second."""
    first_s = json.loads(output)["first_step_s"]
    return dict(steps_per_s(output, _)) | ({"first step": 1 / first_s} if first_s else {})


def steps_per_s(output: str, _: float) -> Mapping[str, float]:
    """Return the steps per second that a run reports."""
    rate = json.loads(output)["steps_per_s"]  # null for a run that is too short for a rate
    return {"steps/s": rate} if rate else {}


def per_second(_: str, elapsed_s: float) -> Mapping[str, float]:
    """Return the number of runs of the command per second."""
    return {"commands/s": 1 / elapsed_s}


def cases(scratch: Path, quick: bool) -> list[Case]:
    """Return every case; `quick` ones are too short to measure anything."""
    ring = "{name: ring, b: 0.1, steps: 100, seed: 1, graph: {kind: ring, nodes: %d}, defaults: {x0: 10, candidates: "
    ring += "{random: 3}, disturbance: {kind: sinusoid, amplitude: 1, omega: 1}}}\n"
    for nodes in (20, 10_000):
        (scratch / f"ring{nodes}.yaml").write_text(ring % nodes)

    def steps(many: int) -> tuple[str, str]:
        return "--steps", str(10 if quick else many)

    few, many = str(scratch / "ring20.yaml"), str(scratch / "ring10000.yaml")
    return [
        Case("up paper7, 7 processes", ["up", "paper7", *steps(800), *QUIET], verdict_speeds),
        Case("up ring, 20 processes", ["up", few, *steps(200), *QUIET], verdict_speeds),
        Case("up ring of 10^4, 2 processes", ["up", many, "--processes", "2", *steps(40), *QUIET], steps_per_s),
        Case("simulate paper7", ["simulate", "paper7", *steps(2000), *QUIET], steps_per_s),
        Case("simulate ring of 10^4", ["simulate", many, *steps(80), *QUIET], steps_per_s),
        Case("sweep paper7", ["sweep", "paper7", "--seeds", f"0:{2 if quick else 50}", "--jobs", "1"], per_second),
    ]


def unpack(revision: str, folder: Path) -> str:
    """Unpack a revision into a new folder and return its commit; SystemExit if there is no such revision."""
    git = ["git", "-C", str(ROOT)]
    named = subprocess.run(
        [*git, "rev-parse", "--verify", "--quiet", "--end-of-options", f"{revision}^{{commit}}"],
        capture_output=True,
        text=True,
        check=False,
    )
    if named.returncode:
        raise SystemExit(f"{revision}: is no revision of this repository. Give a commit, a branch or a tag.")
    commit = named.stdout.strip()
    packed = subprocess.run([*git, "archive", "--format=tar", commit], capture_output=True, check=True).stdout
    folder.mkdir()
    with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
        archive.extractall(folder, filter="data")
    return commit[:12]


def run_once(case: Case, checkout: Path) -> Mapping[str, float]:
    """Run a case with the code of a checkout and return its speeds; SystemExit if it fails."""
    with tempfile.TemporaryDirectory(prefix="hedgerow-") as folder:
        option = "--out" if case.arguments[0] == "sweep" else "--run-dir"
        command = [*COMMAND, *case.arguments, option, f"{folder}/run"]
        # The checkout comes before the installed package, in the command's own processes too.
        environment = os.environ | {"PYTHONPATH": str(checkout)}
        began, spent_s = time.monotonic(), cpu_s()
        done = subprocess.run(
            command, cwd=checkout, env=environment, capture_output=True, text=True, timeout=DEADLINE_S, check=False
        )
        if done.returncode not in (0, 1, 3):  # a complete run that is invalid or unknown has a speed too
            raise SystemExit(f"{case.name}: {checkout.name} ended with {done.returncode}\n{done.stderr[-2000:]}")
        elapsed_s = time.monotonic() - began
        return {**case.read(done.stdout, elapsed_s), "commands/s of CPU": 1 / (cpu_s() - spent_s)}


def cpu_s() -> float:
    """Return the CPU time of all processes that this one started and that have ended, and of theirs [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


class Ratio(NamedTuple):
    """The geometric mean of ratios, and its interval."""

    mean: float
    low: float
    high: float
    rounds: int


def ratio(pairs: Sequence[tuple[float, float]]) -> Ratio:
    """Return the ratio of the second to the first of each pair; the interval of one pair alone is unbounded."""
    logs = [math.log(b / a) for a, b in pairs]
    middle, half = statistics.fmean(logs), math.inf
    if len(logs) > 1:
        half = stats.t.ppf(0.5 + CONFIDENCE / 2, len(logs) - 1) * statistics.stdev(logs) / math.sqrt(len(logs))
    return Ratio(math.exp(middle), math.exp(middle - half), math.exp(min(middle + half, 700.0)), len(logs))


Pairs = dict[tuple[str, str], list[tuple[float, float]]]


def measure(chosen: Sequence[Case], checkouts: Sequence[Path], budget_s: float, most: int) -> Pairs:
    """Run rounds until the next would pass the budget, at least one; return the pairs of speeds by case and name."""
    pairs: Pairs = {}
    began, longest = time.monotonic(), 0.0
    for number in range(most):
        started = time.monotonic()
        if number and started - began + longest > budget_s:
            break
        for case in chosen:
            order = checkouts if number % 2 == 0 else checkouts[::-1]
            done = {checkout: run_once(case, checkout) for checkout in order}
            a, b = (done[checkout] for checkout in checkouts)
            for name in [name for name in a if name in b]:
                pairs.setdefault((case.name, name), []).append((a[name], b[name]))
            print(f"round {number + 1}: {case.name}", file=sys.stderr)
        longest = max(longest, time.monotonic() - started)
    return pairs


def table(ratios: Mapping[tuple[str, str], Ratio], least: float) -> str:
    """Return the ratios as a table in Markdown."""
    lines = ["| case | speed | B / A | 95 % interval | rounds | result |", "|---|---|---|---|---|---|"]
    for (case, name), one in ratios.items():
        verdict = (
            "LOSS" if lost(one, least) else "unclear" if unclear(one, least) else "gain" if one.low > 1 else "no loss"
        )
        interval = f"{one.low:.3f} to {one.high:.3f}" if math.isfinite(one.high) and one.rounds > 1 else "unknown"
        lines.append(f"| {case} | {name} | {one.mean:.3f} | {interval} | {one.rounds} | {verdict} |")
    return "\n".join(lines)


def lost(one: Ratio, least: float) -> bool:
    """Return True if the rounds show that the ratio is below `least`."""
    return one.rounds >= FEWEST and one.high < least


def unclear(one: Ratio, least: float) -> bool:
    """Return True if the rounds show neither that the ratio is below `least` nor that it is not."""
    return not lost(one, least) and (one.rounds < FEWEST or one.low < least)


def conclusion(ratios: Mapping[tuple[str, str], Ratio], least: float) -> str:
    """Return the result of all cases in words."""
    losses = sum(lost(one, least) for one in ratios.values())
    doubts = sum(unclear(one, least) for one in ratios.values())
    found = f"{losses or 'none'} of {len(ratios)} speeds fell below {least:g} of A"
    if not doubts:
        return f"{found}."
    return f"{found}; {doubts} unclear. For a clear result, use a quiet machine, or --only for more rounds of one case."


def _arguments(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.gate", description="Compare the speed of two revisions."
    )
    parser.add_argument("a", metavar="REV_A", help="the revision to compare with, for example main")
    parser.add_argument("b", metavar="REV_B", nargs="?", default="HEAD", help="the revision to judge [HEAD]")
    parser.add_argument("--least", type=float, default=LEAST, help="ratio below which speed is lost [%(default)s]")
    parser.add_argument("--seconds", type=float, default=BUDGET_S, help="time for all rounds [%(default)s]")
    parser.add_argument("--rounds", type=int, default=1000, help="rounds at most")
    parser.add_argument("--only", metavar="WORD", default="", help="only the cases with this text in their names")
    parser.add_argument("--quick", action="store_true", help="one round of short runs: does it all still work?")
    parser.add_argument("--json", action="store_true", help="print JSON instead of the table")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the ratios; exit with 1 if revision B lost speed."""
    known = _arguments(arguments)
    with tempfile.TemporaryDirectory(prefix="hedgerow-gate-") as folder:
        scratch = Path(folder)
        checkouts = [scratch / "a", scratch / "b"]
        commits = [unpack(known.a, checkouts[0]), unpack(known.b, checkouts[1])]
        chosen = [case for case in cases(scratch, known.quick) if known.only in case.name]
        if not chosen:
            raise SystemExit(f"--only {known.only}: no case has that in its name")
        # Compile the modules before a run is timed. Quick runs measure nothing, and compile only what they load.
        for checkout in [] if known.quick else checkouts:
            subprocess.run([sys.executable, "-m", "compileall", "-qq", str(checkout)], check=False)
        pairs = measure(chosen, checkouts, known.seconds, 1 if known.quick else known.rounds)
    ratios = {key: ratio(own) for key, own in pairs.items()}
    if known.json:
        cells = [{"case": case, "speed": name, **one._asdict()} for (case, name), one in ratios.items()]
        print(json.dumps({"a": commits[0], "b": commits[1], "ratios": cells}, indent=2))
    else:
        print(f"A {commits[0]}, B {commits[1]}; {platform.machine()}, {os.cpu_count()} cores\n")
        print(table(ratios, known.least))
        print(f"\n{conclusion(ratios, known.least)}")
    if any(lost(one, known.least) for one in ratios.values()):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
