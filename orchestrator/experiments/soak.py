"""The soak test: a network runs for a long time, and memory, threads, open files and speed must stay flat.

The network runs as usual, with `orchestrator up` in a separate process and with faults. Messages are lost and late,
edges closed, readings and inputs lost. An agent is killed and restarted every CRASH_EVERY_S.
"""

from __future__ import annotations

import contextlib
import csv
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import numpy as np
import psutil
from numpy.typing import NDArray

from hedgerow.orchestrator.ground.signals import EndNowError, Interrupts
from hedgerow.orchestrator.launch.live import Live
from hedgerow.orchestrator.runs import registry
from hedgerow.orchestrator.runs.files import load_events, read_verdict
from hedgerow.orchestrator.runs.folder import RunFolder
from hedgerow.topologies.errors import DeadlineError, HedgerowError
from hedgerow.topologies.faults import Actuator, Cut, Delay, Drop, Fault, Sensor
from hedgerow.topologies.paths import real_path
from hedgerow.topologies.regular_file import last_text
from hedgerow.topologies.resolve import save
from hedgerow.topologies.schema import Topology
from hedgerow.wire.session import WireError

Say = Callable[[str], None]
Array = NDArray[np.float64]

LOG = "up.log"
STEPS = 10**9
"""more than any soak test makes"""
SAMPLES = 240
"""the approximate number of samples of the processes, at least EVERY_S apart"""
EVERY_S = 0.5
CRASH_EVERY_S = 15.0
CRASHED_STEPS = 5
WARM_UP = 0.25
"""The share of the time that is left out, within these limits."""
LEAST_WARM_UP_S, LONGEST_WARM_UP_S = 10.0, 120.0
LEAST_MINUTES = 0.25
"""A shorter test has too few samples for a line."""
YOUNG_S = 5.0
"""A restarted process is judged only after this time: until then it learns [s]."""
ALONE = ("up", "fork server", "plant")
HISTORY = 1000
"""The number of past steps stored for back-filling.

With the default of 100,000, memory would grow until the history is full.
"""
START_DEADLINE_S = 60.0
END_DEADLINE_S = 30.0

GROWTH, GROWTH_MB = 0.03, 2.0
"""A process is flat if the line through its sizes rises, over the judged time, by less than this share of their mean or
this number of MB.
"""
MORE = 2.0
"""The maximum rise of the line through its numbers of threads and of open files."""
SLOWER = 0.2
"""The speed is flat if the line through it falls by less than this share of its mean."""


@dataclass(frozen=True)
class Sample:
    """One sample of one process."""

    t_s: float
    """the time since the first step [s]"""
    step: int
    process: str
    pid: int
    pss_mb: float
    """its share of the resident memory, if the kernel reports it (Linux); otherwise all of it"""
    rss_mb: float
    """resident memory, including shared pages: unlike the share, it does not depend on other processes"""
    threads: int
    descriptors: int


@dataclass(frozen=True)
class Trend:
    """A line through the samples of one quantity: its mean, its growth per minute and in total."""

    what: str
    unit: str
    mean: float
    per_minute: float
    grown: float
    allowed: float
    """the permitted growth; below 0: the permitted fall"""

    @property
    def flat(self) -> bool:
        return self.grown <= self.allowed if self.allowed >= 0 else self.grown >= self.allowed

    def __str__(self) -> str:
        found = f"{self.what:20} {self.mean:8.2f} {self.unit:7} {self.per_minute:+8.3f} a minute"
        bound = f"{'at most' if self.allowed >= 0 else 'at least'} {self.allowed:+.2f}"
        return f"{found} {self.grown:+7.2f} in all ({bound}){'' if self.flat else '  NOT FLAT'}"


def with_faults(topology: Topology) -> Topology:
    """Return the resolved network with additional random faults during the whole run; its own faults remain."""
    edges, nodes = topology.pairs, topology.ids
    added: list[Fault] = [
        Sensor(node=nodes[0], probability=0.02),
        Actuator(node=nodes[len(nodes) // 2], probability=0.02),
    ]
    if edges:
        added += [
            Drop(link=edges[0], probability=0.05),
            Delay(link=edges[len(edges) // 2], by=2, probability=0.05),
            Cut(edge=edges[-1], probability=0.02),
        ]
    return topology.model_copy(update={"faults": (*topology.faults, *added)})


def run_soak(
    topology: Topology, directory: Path, minutes: float, faults: bool, options: Sequence[str], say: Say
) -> tuple[str, int]:
    """Run a resolved network for `minutes` and judge it; return the verdict in one line and the exit code.

    The new folder gets soak.csv and soak.png. `options` are further options of `orchestrator up`. The exit code is 0 if
    the run is flat, 1 if it is not or is INVALID, 3 if it ended early. Raises HedgerowError.
    """
    folder = RunFolder(real_path(directory))
    folder.path.parent.mkdir(parents=True, exist_ok=True)
    topology = topology.model_copy(update={"steps": STEPS, "history": min(topology.history, HISTORY)})
    if faults:
        topology = with_faults(topology)
    wake = threading.Event()
    with (
        Interrupts(wake.set) as interrupts,
        # On the disk of the run, so that the log can move there.
        tempfile.TemporaryDirectory(dir=folder.path.parent, prefix=".hedgerow-soak-") as scratch,
        _up(Path(scratch), folder, topology, options) as up,
    ):
        say(f"run folder {folder.path}")
        entry = _entry(up, Path(scratch, LOG), folder, records="--no-record" not in options)
        samples = list(_samples(up, entry, minutes * 60, faults, lambda s: wake.wait(s) or interrupts.count > 0))
        up.terminate()  # a SIGINT may be ignored: a background job inherits that
        with contextlib.suppress(subprocess.TimeoutExpired):
            up.wait(END_DEADLINE_S)
    _write(folder.path / "soak.csv", samples)
    verdict = read_verdict(folder.path)
    trends = trends_of(samples)
    for trend in worth_saying(trends):
        say(str(trend))
    if not trends and interrupts.count:
        raise EndNowError(f"{interrupts.name}, before there was anything to measure; see {folder.path}")
    if not trends:
        raise HedgerowError(f"{folder.name}: ended before there was anything to measure; see {folder.logs}")
    _draw(folder.path, samples, say)
    invalid = verdict.get("verdict") not in ("valid", "unknown")
    early = samples[-1].t_s < minutes * 60 * 0.95
    wrong = [trend.what for trend in trends if not trend.flat]
    word = f"not flat: {', '.join(wrong)}" if wrong else "flat"
    word += f"; the run is {verdict.get('verdict', 'without a verdict')}" if invalid else ""
    done, seconds = samples[-1].step, samples[-1].t_s
    line = f"{word}: {done} steps in {seconds / 60:.1f} min, {verdict.get('restarts', 0)} restarts"
    return line, 1 if wrong or invalid else 3 if early else 0


@contextlib.contextmanager
def _up(
    scratch: Path, folder: RunFolder, topology: Topology, options: Sequence[str]
) -> Iterator[subprocess.Popen[bytes]]:
    """Run `orchestrator up` for that network, with its files in `scratch`; it ends with this process."""
    file = scratch / "topology.yaml"
    save(topology, file)
    command = [sys.executable, "-P", "-m", "hedgerow.orchestrator", "up", str(file), "--run-dir", str(folder.path)]
    fixed = ["--viewer", "none", "--lifeline", "--plain"]
    log_file = scratch / LOG
    with log_file.open("wb") as log:
        process = subprocess.Popen(
            [*command, *fixed, *options], stdin=subprocess.PIPE, stdout=log, stderr=log, start_new_session=True
        )
    try:
        yield process
    finally:
        assert process.stdin is not None
        process.stdin.close()
        try:
            process.wait(END_DEADLINE_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        with contextlib.suppress(OSError):
            log_file.replace(folder.logs / LOG)


def _entry(up: subprocess.Popen[bytes], log: Path, folder: RunFolder, records: bool) -> registry.Entry:
    """Return the registry entry of the run, once it has made a step and is fully loaded."""
    until = time.monotonic() + START_DEADLINE_S
    while not (
        any(event["event"] == "first_step" for event in load_events(folder.path))
        and (folder.recording.exists() or not records)
    ):
        if up.poll() is not None:
            raise HedgerowError(f"{folder.name}: ended at once: {last_text(log, 500).strip()}")
        if time.monotonic() > until:
            raise DeadlineError(f"{folder.name}: no step after {START_DEADLINE_S:g} s; see {folder.logs}")
        time.sleep(0.05)
    return next(entry for entry in registry.running() if entry.pid == up.pid)


def _samples(
    up: subprocess.Popen[bytes],
    entry: registry.Entry,
    seconds: float,
    crashes: bool,
    interrupted: Callable[[float], bool],
) -> Iterator[Sample]:
    """Sample every process repeatedly, and kill an agent from time to time, until the time or the run is over."""
    every = max(EVERY_S, seconds / SAMPLES)
    began = time.monotonic()
    crash_at = began
    with Live(entry) as live:
        last = live.topology.process_count - 1
        while time.monotonic() - began < seconds and up.poll() is None:
            try:
                status = live.status()
                if crashes and time.monotonic() > crash_at:
                    crash_at += CRASH_EVERY_S
                    live.fault.crash(process=last, at=1, restart_after=CRASHED_STEPS)
            except WireError:  # it has ended, or is busy
                status = None
            if status is not None:
                looks = look(psutil.Process(up.pid), time.monotonic() - began, int(status["step"]))
                absent = status["absent"].values()
                yield from (one for one in looks if one.process not in absent)
            if interrupted(every):
                return


def look(up: psutil.Process, t_s: float, step: int) -> Iterator[Sample]:
    """Yield a sample of `up` and of every process of its run; skip processes that have ended."""
    for process in (up, *up.children(recursive=True)):
        with contextlib.suppress(psutil.NoSuchProcess, psutil.AccessDenied, psutil.ZombieProcess):
            memory = process.memory_full_info()
            name = "up" if process == up else process.name()
            if name.startswith("python"):
                name = "fork server"
            pss, rss = getattr(memory, "pss", memory.rss) / 1e6, memory.rss / 1e6
            if rss:
                yield Sample(t_s, step, name, process.pid, pss, rss, process.num_threads(), process.num_fds())


def _write(path: Path, samples: Sequence[Sample]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow([field.name for field in fields(Sample)])
        table.writerows([round(x, 3) if isinstance(x, float) else x for x in astuple(one)] for one in samples)


def trends_of(samples: Sequence[Sample]) -> list[Trend]:
    """Return a line through each quantity, after the warm-up; none if there are too few samples."""
    if not samples:
        return []
    later = [one for one in _grown(samples) if one.t_s >= warm_up_s(samples[-1].t_s)]
    trends = []
    for name in dict.fromkeys(one.process for one in later):
        own = [one for one in later if one.process == name]
        t = np.array([one.t_s for one in own])
        for key, what, unit in (("rss_mb", "memory", "MB"), ("threads", "threads", ""), ("descriptors", "files", "")):
            values = np.array([getattr(one, key) for one in own], dtype=float)
            allowed = max(GROWTH_MB, GROWTH * values.mean()) if key == "rss_mb" else MORE
            trends += _trend(f"{name} {what}", unit, t, values, allowed)
    t, pace = pace_of(later)
    trends += _trend("pace", "steps/s", t, pace, -SLOWER * float(pace.mean()) if len(pace) else 0.0)
    return trends


def _grown(samples: Sequence[Sample]) -> list[Sample]:
    """Return the samples without those of recently restarted processes."""
    seen: dict[int, float] = {}
    for one in samples:
        seen.setdefault(one.pid, one.t_s)
    began = samples[0].t_s
    return [one for one in samples if seen[one.pid] == began or one.t_s - seen[one.pid] >= YOUNG_S]


def warm_up_s(seconds: float) -> float:
    """Return the part of the time that is not judged [s]."""
    return min(max(WARM_UP * seconds, LEAST_WARM_UP_S), LONGEST_WARM_UP_S)


def worth_saying(trends: Sequence[Trend]) -> list[Trend]:
    """Return the trends to report: those that are not flat, those of single processes, and the largest of the
    agents.
    """
    of_agents: dict[str, list[Trend]] = {}
    found = []
    for trend in trends:
        process, _, quantity = trend.what.rpartition(" ")
        if trend.what == "pace" or process in ALONE or not trend.flat:
            found.append(trend)
        else:
            of_agents.setdefault(quantity, []).append(trend)
    return found + [max(some, key=lambda trend: trend.grown) for some in of_agents.values()]


def pace_of(samples: Sequence[Sample]) -> tuple[Array, Array]:
    """Return the steps/s between successive samples, and the times."""
    looks = np.array(list({one.t_s: one.step for one in samples}.items()), dtype=float).reshape(-1, 2)
    t = (looks[1:, 0] + looks[:-1, 0]) / 2
    return t, np.diff(looks[:, 1]) / np.diff(looks[:, 0])


def _trend(what: str, unit: str, t: Array, values: Array, allowed: float) -> list[Trend]:
    if len(t) < 3 or t[-1] <= t[0]:
        return []
    slope = float(np.polyfit(t - t[0], values, 1)[0])
    return [Trend(what, unit, float(values.mean()), 60 * slope, slope * float(t[-1] - t[0]), allowed)]


def _draw(folder: Path, samples: Sequence[Sample], say: Say) -> None:
    """Draw soak.png and soak.pdf, if matplotlib is installed."""
    try:
        from hedgerow.orchestrator.report.style import look, save, sheet  # noqa: PLC0415
    except ModuleNotFoundError:
        say("no picture: matplotlib is not installed. Install it with: pip install matplotlib")
        return
    with look():
        figure = sheet(4.4)
        memory, counts, pace = figure.subplots(3, 1, sharex=True, height_ratios=(2, 1, 1))
        for name, series in _sizes(samples).items():
            memory.plot(*_lines(series), label=name)
        memory.set_title("Resident memory of a process [MB]")
        memory.legend(ncols=4)
        for key, name in (("threads", "threads"), ("descriptors", "open files")):
            counts.plot(*_lines(_sum(samples, key)), label=name)
        counts.set_title("Threads and open files of all processes")
        counts.legend(ncols=2)
        t, steps = pace_of(samples)
        pace.plot(t / 60, steps)
        pace.set_title("Steps per second")
        for axes in (memory, counts, pace):
            axes.axvspan(0, warm_up_s(samples[-1].t_s) / 60, color="#EEEEEE", linewidth=0)
            axes.set_ylim(bottom=0)
        pace.set_xlabel("minutes; grey: warm-up, not judged")
        save(figure, folder, "soak", "Soak")


def _lines(series: Mapping[float, float]) -> tuple[Array, Array]:
    return np.array([*series]) / 60, np.array([*series.values()])


def _sizes(samples: Sequence[Sample]) -> dict[str, dict[float, float]]:
    """Return the size of each single process at each sample; for the agents, their mean."""
    looks: dict[str, dict[float, list[float]]] = {}
    for one in samples:
        name = one.process if one.process in ALONE else "an agent"
        looks.setdefault(name, {}).setdefault(one.t_s, []).append(one.rss_mb)
    return {name: {t: float(np.mean(sizes)) for t, sizes in series.items()} for name, series in looks.items()}


def _sum(samples: Sequence[Sample], key: str) -> dict[float, float]:
    total: dict[float, float] = {}
    for one in samples:
        total[one.t_s] = total.get(one.t_s, 0.0) + getattr(one, key)
    return total
