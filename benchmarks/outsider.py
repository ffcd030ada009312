"""The cost of the replay of a run, and the effect of floods by a process that is connected to an open run.

python -m benchmarks.outsider --rounds 5 --steps 5000
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import zenoh

from hedgerow.wire import keys
from hedgerow.wire.session import close, open_client

UP = ("up", "paper7", "--viewer", "none", "--no-record")
TIMED = """
import os, time
from pathlib import Path
from hedgerow.orchestrator.metrics.replay import Replay
take, spent = Replay.take, 0.0
def timed(self, rows):
    global spent
    began = time.thread_time()
    take(self, rows)
    spent += time.thread_time() - began
    Path(os.environ["REPLAY_CPU"]).write_text(str(spent))
Replay.take = timed
from hedgerow.orchestrator.__main__ import main
main()
"""
SHORT = 500
"""the steps of a run that only starts and ends"""
FLOOD_S = 5.0
RATE = 50


def verdict(folder: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((folder / "verdict.json").read_text(encoding="utf-8"))
    return content


def cpu(steps: int) -> tuple[float, float]:
    """Return the processor time of the replay and of all processes, in one run of paper7 [s]."""
    with tempfile.TemporaryDirectory() as folder:
        spent = Path(folder) / "spent"
        command = [sys.executable, "-P", "-c", TIMED, *UP, "--steps", str(steps), "--run-dir", f"{folder}/run"]
        before = os.times()
        subprocess.run(command, check=True, capture_output=True, env={**os.environ, "REPLAY_CPU": str(spent)})
        after = os.times()
        whole = after.children_user + after.children_system - before.children_user - before.children_system
        return float(spent.read_text(encoding="utf-8")), whole


def replay(rounds: int, steps: int) -> dict[str, float]:
    """Return the processor time per step of the replay and of all processes, and their ratio, by the median of rounds.

    The start and the end of a run are left out: each round compares a long run to a short one.
    """
    found = []
    for _ in range(rounds):
        (some, least), (own, whole) = cpu(SHORT), cpu(steps)
        found.append(((own - some) / (steps - SHORT), (whole - least) / (steps - SHORT)))
    shares = [own / whole for own, whole in found]
    return {
        "replay [us per step]": round(1e6 * statistics.median(own for own, _ in found), 1),
        "all [us per step]": round(1e6 * statistics.median(whole for _, whole in found), 1),
        "share": round(statistics.median(shares), 4),
        "least": round(min(shares), 4),
        "most": round(max(shares), 4),
    }


def commands(session: zenoh.Session, until: float, count: dict[str, int]) -> None:
    """Ask for the status as fast as answers come, 200 at a time."""
    _ask(session, keys.control("status"), {}, until, count)


def joins(session: zenoh.Session, until: float, count: dict[str, int]) -> None:
    """Ask for the place of agent 1 as fast as answers come, 200 at a time."""
    asked = {"process": "agent-1", "number": 1, "codec": 1, "hedgerow": "0", "network": "0"}
    _ask(session, keys.join(0), asked, until, count)


def tokens(session: zenoh.Session, until: float, count: dict[str, int]) -> None:
    """Show and withdraw tokens of further lives of agent 1, as fast as the session accepts them."""
    shown: list[Any] = []
    while time.monotonic() < until:
        shown.append(session.liveliness().declare_token(keys.alive(keys.shard_name(0), 1000 + count["shown"])))
        count["shown"] += 1
        if len(shown) > 200:
            shown.pop(0).undeclare()


def strange_tokens(session: zenoh.Session, until: float, count: dict[str, int]) -> None:
    """Show tokens that no process of the run has, and leave all of them."""
    shown: list[Any] = []
    while time.monotonic() < until:
        shown.append(session.liveliness().declare_token(f"alive/stranger-{count['shown']}/0"))
        count["shown"] += 1


def _ask(session: zenoh.Session, key: str, asked: dict[str, Any], until: float, count: dict[str, int]) -> None:
    while time.monotonic() < until:
        for waiting in [session.get(key, payload=json.dumps(asked), timeout=2.0) for _ in range(200)]:
            for reply in waiting:
                answer = json.loads(reply.ok.payload.to_bytes()) if reply.ok is not None else {}
                count["refused" if "too often" in str(answer.get("error")) else "answered"] += 1


def memory(root: int) -> int:
    """Return the resident memory of a process and all of its descendants [bytes]."""
    parents, resident = {}, {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            fields = stat.read_text(encoding="utf-8").rpartition(")")[2].split()
            parents[int(stat.parent.name)] = int(fields[1])
            resident[int(stat.parent.name)] = int(fields[21]) * os.sysconf("SC_PAGE_SIZE")
    family = {root}
    while more := {one for one, parent in parents.items() if parent in family} - family:
        family |= more
    return sum(resident.get(one, 0) for one in family)


def flood(attack: Callable[[zenoh.Session, float, dict[str, int]], None] | None) -> dict[str, Any]:
    """Attack a run of paper7 at 50 steps/s for five seconds; return the rates of the attack and of the run."""
    with tempfile.TemporaryDirectory() as folder:
        run, steps = Path(folder) / "run", int(RATE * (FLOOD_S + 2))
        options = ("--steps", str(steps), "--rate", str(RATE), "--run-dir", str(run))
        with subprocess.Popen(
            [sys.executable, "-P", "-m", "hedgerow.orchestrator", *UP, *options], stdout=subprocess.DEVNULL
        ) as up:
            events: list[dict[str, Any]] = []
            while not any(event["event"] == "first_step" for event in events):
                time.sleep(0.05)
                log_file = run / "events.jsonl"
                events = [json.loads(line) for line in log_file.read_text().splitlines()] if log_file.exists() else []
            start = next(event for event in events if event["event"] == "start")
            session = open_client(start["endpoint"], start["namespace"], None, 5.0)
            count = Counter[str]()
            before = memory(up.pid)
            if attack is None:
                time.sleep(FLOOD_S)
            else:
                attack(session, time.monotonic() + FLOOD_S, count)
            grown = memory(up.pid) - before
            up.wait()
            close(session)
        found = verdict(run)
    return {
        "sent per s": sum(count.values()) / FLOOD_S,
        "growth of all processes [MB]": round(grown / 2**20, 1),
        "refused per s": count["refused"] / FLOOD_S,
        "steps per s": found["steps_per_s"],
        "missing inputs": found["missing_inputs"],
        "verdict": found["verdict"],
    }


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--steps", type=int, default=5000)
    parser.add_argument("--only", choices=("replay", "floods"))
    known = parser.parse_args()
    if known.only != "floods":
        print(json.dumps({"replay": replay(known.rounds, known.steps)}), flush=True)
    for attack in (None, commands, joins, tokens, strange_tokens) if known.only != "replay" else ():
        print(json.dumps({getattr(attack, "__name__", "nothing"): flood(attack)}), flush=True)


if __name__ == "__main__":
    main()
