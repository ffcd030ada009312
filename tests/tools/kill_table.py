"""Send every signal to every process of a run at every time, and record the saved steps and the remains.

Run it with `python -m tests.tools.kill_table`.

    who    agent, plant (the router too), fork server (it forks both), up (the observer), viewer (a page's
           server), router (an external one)
    what   SIGTERM, SIGKILL, SIGINT, and SIGSTOP for STOPPED_S
    when   at the start: it exists, and no step is made; in the middle: MIDDLE steps are recorded; at the end: the run
           was asked to end, and the process held still from just before, or `up` from just after, so that the signal
           meets it alive

Each cell is a run of paper7 over real Zenoh; every other one is secure, with keys and certificates to remove. `--write`
puts the table into docs/reliability.md.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
import uuid
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import psutil
from rerun.chunk import RrdReader

from hedgerow.orchestrator.launch.live import Live
from hedgerow.orchestrator.runs.reader import load_run
from hedgerow.orchestrator.runs.registry import Entry
from hedgerow.orchestrator.views.rerun.rrd_file import parts
from hedgerow.orchestrator.views.rerun.watch import ArrowTail
from hedgerow.topologies.errors import HedgerowError
from hedgerow.wire.ports import LOOPBACK, free_port
from hedgerow.wire.session import WireError
from tests.tools.ctrl_c import mind_ctrl_c
from tests.tools.processes import COMMAND

DOCUMENT = Path(__file__).parents[2] / "docs/reliability.md"
BEGIN, END = "<!-- kill table: python -m tests.tools.kill_table --write -->\n", "<!-- end of kill table -->\n"

WHO = ("agent", "plant", "fork server", "up", "viewer", "router")
WHAT = (signal.SIGTERM, signal.SIGKILL, signal.SIGINT, signal.SIGSTOP)
WHEN = ("start", "middle", "end")
RATE, STEPS, MIDDLE = 20, 1500, 20
STOPPED_S = 5.0
RRD_S = 1.0
"""run.rrd may lack this time before the signal, because it is written in pieces [s]."""
DEADLINE_S = 90.0
ENDED_S = 30.0
"""so long after the signal the command must have ended"""
GONE_S = 5.0
"""the time after the end of the command until which all remains must be gone [s]"""
MARK = "HEDGEROW_KILL_TABLE"

ROUTER = """
import signal, sys
from hedgerow.wire.session import open_router
with open_router(sys.argv[1]):
    print("open", flush=True)
    signal.pause()
"""


@dataclass(frozen=True)
class Cell:
    """Which process is sent which signal when."""

    who: str
    what: signal.Signals
    when: str

    @property
    def wire(self) -> str:
        """The connection of its processes: of any two neighbouring cells in the table, one is secure."""
        if self.who == "router":
            return "TCP"
        return ("socket", "TLS")[(WHAT.index(self.what) + WHEN.index(self.when)) % 2]

    @property
    def columns(self) -> tuple[str, ...]:
        """Return the description of the cell in the table."""
        sent = f"{self.what.name}" + (f" {STOPPED_S:g} s" if self.what == signal.SIGSTOP else "")
        return self.who, sent, self.when, self.wire

    def __str__(self) -> str:
        return f"{self.who}-{self.what.name}-{self.when}"


CELLS = [Cell(*cell) for cell in itertools.product(WHO, WHAT, WHEN)]


@dataclass(frozen=True)
class Outcome:
    """The result of a run."""

    code: int
    verdict: str
    seen: int
    """steps in the tables when the signal was sent"""
    kept: int
    """steps that can be read from them afterwards"""
    kept_rrd: int
    """steps that can be read from run.rrd"""
    ended_s: float
    """from the signal to the command's end"""
    gone_s: float
    """the time from there until nothing remained"""
    left: tuple[str, ...]
    """the processes that remained after GONE_S"""
    output: str


def run_cell(cell: Cell, directory: Path) -> Outcome:
    """Run a network in an empty directory, send the signal, wait for the end, and inspect the remains."""
    with contextlib.ExitStack() as stack:
        return _Run(cell, directory, stack).outcome()


class _Run:
    def __init__(self, cell: Cell, directory: Path, stack: contextlib.ExitStack) -> None:
        self._cell, self._folder = cell, directory / "run"
        self._mark = uuid.uuid4().hex
        self._runtime, self._temporary = directory / "runtime", directory / "tmp"
        for path in (self._runtime, self._temporary):
            path.mkdir()
        hidden = ("DISPLAY", "WAYLAND_DISPLAY")
        environment = {name: value for name, value in os.environ.items() if name not in hidden}
        self._environment = environment | {
            "XDG_RUNTIME_DIR": str(self._runtime),
            "TMPDIR": str(self._temporary),
            MARK: self._mark,
        }
        self._shared: set[Path] = set()
        self._router: subprocess.Popen[str] | None = None
        options = ["--viewer", "web" if cell.who == "viewer" else "none", "--processes", "3"]
        options += ["--rate", str(RATE), "--run-dir", str(self._folder)]
        if cell.wire == "TLS":
            options.append("--secure")
        if cell.who == "router":
            options += ["--router", self._start_router(stack)]
        self._output = directory / "output.txt"
        with self._output.open("w") as output:
            self._up = subprocess.Popen(
                [*COMMAND, "up", "paper7", "--lifeline", "--steps", str(STEPS), *options],
                stdin=subprocess.PIPE,
                stdout=output,
                stderr=output,
                env=self._environment,
                cwd=directory,
                start_new_session=True,
            )
        stack.callback(self._clear)

    def _start_router(self, stack: contextlib.ExitStack) -> str:
        endpoint = f"tcp/{LOOPBACK}:{free_port()}"
        self._router = subprocess.Popen(
            [sys.executable, "-c", ROUTER, endpoint],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            start_new_session=True,
        )
        assert self._router.stdout is not None
        assert self._router.stdout.readline() == "open\n"
        stack.callback(self._end_router)
        return endpoint

    def _end_router(self) -> None:
        assert self._router is not None
        self._router.kill()
        self._router.wait()
        assert self._router.stdout is not None
        self._router.stdout.close()

    def _clear(self) -> None:
        """End every process of a cell, whatever its result."""
        for process in self._ours():
            with contextlib.suppress(psutil.NoSuchProcess):
                process.kill()
        self._up.wait()
        assert self._up.stdin is not None
        self._up.stdin.close()

    def _ours(self) -> list[psutil.Process]:
        """All processes of this run: they have inherited its mark."""
        found = []
        for process in psutil.process_iter():
            with contextlib.suppress(psutil.Error, OSError):
                if process.environ().get(MARK) == self._mark and process.status() != psutil.STATUS_ZOMBIE:
                    found.append(process)
        return found

    # ---- when

    def outcome(self) -> Outcome:
        cell = self._cell
        target = {"start": self._at_start, "middle": self._in_the_middle, "end": self._at_the_end}[cell.when]()
        seen = self._recorded()
        sent = time.monotonic()
        if not target.is_running() or target.status() == psutil.STATUS_ZOMBIE:
            raise TimeoutError(f"{cell}: the {cell.who} ended by itself before the signal: {self._output.read_text()}")
        target.send_signal(cell.what)
        if cell.what == signal.SIGSTOP:
            threading.Event().wait(STOPPED_S)
        with contextlib.suppress(psutil.NoSuchProcess):
            target.send_signal(signal.SIGCONT)
        if allowed(cell) == (0,):
            self._hurry()
        code = self._up.wait(DEADLINE_S)
        ended = time.monotonic()
        while (left := self._left()) and time.monotonic() - ended < GONE_S:
            threading.Event().wait(0.02)
        gone_s = time.monotonic() - ended
        kept, kept_rrd = self._kept()
        with contextlib.suppress(OSError, ValueError):
            verdict = json.loads((self._folder / "verdict.json").read_text(encoding="utf-8"))["verdict"]
            return Outcome(code, verdict, seen, kept, kept_rrd, ended - sent, gone_s, left, self._output.read_text())
        return Outcome(code, "none", seen, kept, kept_rrd, ended - sent, gone_s, left, self._output.read_text())

    def _hurry(self) -> None:
        """Speed up the rest of the run."""
        events = self._folder / "events.jsonl"
        self._wait_for(lambda: events.exists() and '"first_step"' in events.read_text(encoding="utf-8"), "a step")
        with contextlib.suppress(WireError, OSError):  # it may have ended
            for listed in self._runtime.glob("*/*.json"):
                with Live(Entry(**json.loads(listed.read_text(encoding="utf-8")))) as live:
                    live.rate(0)

    def _at_start(self) -> psutil.Process:
        """The process, as soon as it is there; `up`, as soon as there is an agent."""
        if self._cell.who == "router":
            self._target("agent")
        if self._cell.who == "up":
            self._target("agent")
        return self._target(self._cell.who)

    def _in_the_middle(self) -> psutil.Process:
        target = self._target(self._cell.who)
        self._wait_for(lambda: self._recorded() >= MIDDLE, f"{MIDDLE} steps", 0.02)
        self._wait_for(lambda: self._shown() > 0, "a recording", 0.2)
        self._shared = self._sharing()
        return target

    def _at_the_end(self) -> psutil.Process:
        target = self._in_the_middle()
        # `up` itself must receive Ctrl-C first, and ends only after the plant.
        awaited = self._target("plant") if self._cell.who == "up" else target
        awaited.send_signal(signal.SIGSTOP)
        self._up.send_signal(signal.SIGINT)
        events = self._folder / "events.jsonl"
        self._wait_for(lambda: '"stopping"' in events.read_text(encoding="utf-8"), "the end")
        if awaited is not target:
            target.send_signal(signal.SIGSTOP)
            awaited.send_signal(signal.SIGCONT)
        return target

    def _target(self, who: str) -> psutil.Process:
        if who == "up":
            return psutil.Process(self._up.pid)
        if who == "router":
            assert self._router is not None
            return psutil.Process(self._router.pid)
        found: list[psutil.Process] = []
        is_it: dict[str, Callable[[psutil.Process], bool]] = {
            "agent": lambda one: one.name().startswith("shard-1"),
            "plant": lambda one: one.name() == "plant",
            "fork server": lambda one: (
                "hedgerow.orchestrator.launch.fork_server" in one.cmdline() and one.name().startswith("python")
            ),
            "viewer": lambda one: "--serve-web" in one.cmdline(),
        }

        def look() -> bool:
            with contextlib.suppress(psutil.Error):
                for child in psutil.Process(self._up.pid).children(recursive=True):
                    with contextlib.suppress(psutil.Error):
                        if is_it[who](child):
                            found.append(child)
                            return True
            return False

        self._wait_for(look, f"the {who}")
        return found[0]

    def _wait_for(self, condition: Callable[[], bool], what: str, look_s: float = 0.001) -> None:
        until = time.monotonic() + DEADLINE_S
        pause = threading.Event()
        while not condition():
            if time.monotonic() > until or self._up.poll() is not None:
                raise TimeoutError(f"{self._cell}: never came to {what}: {self._output.read_text()}")
            pause.wait(look_s)

    # ---- the remains

    def _recorded(self) -> int:
        """Steps in the streams of both tables, with the state after them."""
        steps = []
        for name in ("telemetry", "edges"):
            try:
                tail = ArrowTail(self._folder / f"{name}.arrows")
            except OSError:
                return 0
            step = 0
            while (batch := tail.next()) is not None:
                step = int(batch["step"][-1].as_py())
            steps.append(step)
        return min(steps)

    def _kept(self) -> tuple[int, int]:
        try:
            kept = load_run(self._folder).T
        except HedgerowError:
            kept = 0
        return kept, self._shown()

    def _shown(self) -> int:
        """Rows of x in run.rrd."""
        shown = 0
        for file in parts(self._folder / "run.rrd"):
            with contextlib.suppress(RuntimeError, ValueError), warnings.catch_warnings(action="ignore"):
                for chunk in RrdReader(file).stream().filter(content="/x", is_static=False, has_timeline="step"):
                    shown += chunk.to_record_batch().num_rows
        return shown

    def _sharing(self) -> set[Path]:
        """The shared memory of our processes, by its files."""
        shared = set()
        for process in self._ours():
            with contextlib.suppress(psutil.Error, OSError):
                paths = [Path(one.path) for one in process.memory_maps()]
                shared |= {path for path in paths if path.is_relative_to("/dev/shm")}
        return shared

    def _left(self) -> tuple[str, ...]:
        """Return the remains of this run on the machine, besides its recorded files."""
        left = [f"process {one.pid}" for one in self._ours()]
        left += [f"socket {path.name}" for path in self._folder.glob("*.sock*")]
        left += [f"part {path.name}" for path in self._folder.rglob("*.part")]
        left += [f"temporary {path.name}" for path in self._temporary.iterdir()]
        left += [f"listed {path.name}" for path in self._runtime.glob("*/**/*")]  # certificates too
        left += [f"shared memory {path.name}" for path in self._shared if path.exists()]
        return tuple(left)


# ---- the expected results


def wrong(cell: Cell, outcome: Outcome) -> list[str]:
    """Return the broken promises, in words."""
    found = [f"left behind: {', '.join(outcome.left)}"] if outcome.left else []
    if "Traceback" in outcome.output:
        found.append("a traceback")
    if outcome.kept < outcome.seen:
        found.append(f"{outcome.kept} of {outcome.seen} recorded steps are kept")
    # Rerun writes aside, and behind where the processor is wanted by others: of a killed `up`, some of it is there.
    killed = cell.who == "up" and cell.what == signal.SIGKILL
    if outcome.kept_rrd < (cell.when != "start" if killed else outcome.seen - RRD_S * RATE):
        found.append(f"{outcome.kept_rrd} of {outcome.seen} steps are in run.rrd")
    codes = allowed(cell)
    if outcome.code not in codes:
        found.append(f"exit code {outcome.code}, not {' or '.join(map(str, codes))}")
    if outcome.ended_s > ENDED_S:
        found.append(f"ended after {outcome.ended_s:.0f} s")
    if outcome.code == 0 and (outcome.verdict != "valid" or outcome.kept != STEPS):
        found.append(f"exit code 0, but {outcome.verdict} with {outcome.kept} steps")
    if outcome.code == 3 and outcome.verdict != "unknown":
        found.append(f"exit code 3, but the verdict is {outcome.verdict}")
    return found


def allowed(cell: Cell) -> tuple[int, ...]:
    """Return the right exit codes: 0 if the run can continue, 3 if it was ended or cannot continue."""
    match cell:
        case Cell("up", signal.SIGKILL, _):
            return (-signal.SIGKILL,)
        case Cell(_, _, "end"):  # the user has ended it
            return (3,)
        case Cell("agent" | "viewer", _, _) | Cell(_, signal.SIGSTOP, _):
            return (0,)
        case Cell("fork server", signal.SIGINT, _):  # Ctrl-C is for `up`
            return (0,)
        case _:
            return (3,)


def table(outcomes: dict[Cell, Outcome]) -> Iterator[str]:
    """The lines of a table, in Markdown."""
    names = ("process", "signal", "when", "wire", "exit code", "verdict", "steps kept (there)", "in `run.rrd`")
    yield f"| {' | '.join((*names, 'ended after', 'clean after', 'left'))} |"
    yield f"|{'---|' * (len(names) + 3)}"
    for cell, one in outcomes.items():
        code = signal.Signals(-one.code).name if one.code < 0 else one.code
        kept = f"{one.kept} ({one.seen})"
        yield (
            f"| {' | '.join(cell.columns)} | {code} | {one.verdict} | {kept} | {one.kept_rrd}"
            f" | {one.ended_s:.1f} s | {one.gone_s:.1f} s | {', '.join(one.left) or 'nothing'} |"
        )


def _try(cell: Cell) -> Outcome:
    with tempfile.TemporaryDirectory(prefix="kill-") as directory:
        return run_cell(cell, Path(directory))


def main() -> None:
    """Run every cell, print the table and the broken promises; exit code 1 if there is one."""
    parser = argparse.ArgumentParser(prog="python -m tests.tools.kill_table", description=main.__doc__)
    parser.add_argument("--only", default="", help="cells with this text in their names: agent-SIGTERM-start, …")
    parser.add_argument("--write", action="store_true", help="put the table into docs/reliability.md")
    parser.add_argument("--jobs", type=int, default=1, help="number of cells at once")
    known = parser.parse_args()
    if known.write and known.only:
        parser.error("--write is for the whole table")
    mind_ctrl_c()
    outcomes: dict[Cell, Outcome] = {}
    failed = 0
    cells = [cell for cell in CELLS if known.only in str(cell)]
    with ThreadPoolExecutor(known.jobs) as pool:
        for cell, one in zip(cells, pool.map(_try, cells), strict=True):
            outcomes[cell] = one
            bad = wrong(cell, one)
            failed += bool(bad)
            print(f"{cell}: {'; '.join(bad) or 'ok'}: {list(table({cell: one}))[-1]}", flush=True)
            if bad:
                print(f"    {one}", flush=True)
    lines = list(table(outcomes))
    print(*lines, f"{failed} of {len(outcomes)} cells are wrong", sep="\n")
    if known.write:
        before, _, rest = DOCUMENT.read_text(encoding="utf-8").partition(BEGIN)
        after = rest.partition(END)[2]
        DOCUMENT.write_text(before + BEGIN + "\n".join(lines) + "\n" + END + after, encoding="utf-8")
    sys.exit(failed > 0)


if __name__ == "__main__":
    main()
