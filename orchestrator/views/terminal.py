"""A run on a terminal: a live table, or a bar if a viewer shows the run.

    paper7: step 40 of 100, 10 steps/s, 0:00:06 left
    node            x      ahat  model  missing inputs  state
    5         -0.3882         -  -                   8  dead
    6          0.4995    0.6351  WRONG               0
    1           0.138    0.4907  right               0
    WRONG: the estimate is not the truth. Failures are on top, then WRONG.
    ... 4 more: |x| <= 0.701, none wrong
    edges down: 2-4, 3-5
    links down: 1->2, 3-5
    5 of 7 estimates right, 8 missing inputs, 32 lost messages, regret D 0.9384 (nominal 4.367),
    cost regret +1.734, gain 9.271 with x(0)
    step 30: cut 2-4 from step 30 to 60 (fault 2)

A wrong model is marked by a word and by a colour. Dead nodes come first, then nodes without an input, then nodes with a
wrong model. If the space is short, those with the largest |x| of each kind remain, and a line describes the others.
"""

from __future__ import annotations

import contextlib
import sys
import textwrap
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from datetime import timedelta
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.cells import cell_len, set_cell_size
from rich.console import Console
from rich.live import Live
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.text import Text

from hedgerow.orchestrator.metrics.certificate import storage
from hedgerow.orchestrator.metrics.fault_accounts import at_ends
from hedgerow.orchestrator.metrics.observer import Batch
from hedgerow.orchestrator.metrics.verdict import INVALID, VALID, Verdict, estimates_text, gain_text
from hedgerow.orchestrator.views.outlet import Outlet, left_behind
from hedgerow.topologies.describe import describe
from hedgerow.topologies.escape import escape
from hedgerow.topologies.graph import Index, Mask
from hedgerow.topologies.schema import Topology

REDRAW_S = 0.25
"""The minimum time between two drawings of the table [s]."""
PACE_S = 5.0
"""the time span for the count of steps/s"""
LEGEND = "WRONG: the estimate is not the truth. Failures are on top, then WRONG."
EVENTS = 3
FEW = 4
"""the lines reserved for nodes before sums and events get space"""
NAMES = 60
"""the maximum number of edges in a line"""

Cell = tuple[str, str]
"""a text and its style"""


class Standing:
    """The status of a run: the content of the table, updated with every batch."""

    def __init__(self, topology: Topology) -> None:
        self._topology = topology
        self._ids = topology.ids
        self._ends = at_ends(topology.graph)
        network = topology.network
        self._v0 = float(storage(network.x0[None], network.a)[0])
        self._missing: Index = np.zeros(len(self._ids), dtype=np.int64)
        self._lost = 0
        self._last: Batch | None = None
        self._pace: deque[tuple[float, int]] = deque()
        """pairs of a time and the number of finished steps"""
        self._events: deque[str] = deque(maxlen=EVENTS)
        faults = enumerate(topology.faults, 1)
        self._due = deque(sorted((fault.window[0], k, describe(fault)) for k, fault in faults))

    def happened(self, text: str) -> None:
        """Add a text to the last events."""
        self._events.append(escape(text, keep=""))

    def take(self, batch: Batch, now: float) -> None:
        """Record further steps, finished at the time `now` [s]."""
        self._last = batch
        self._missing += batch.missing.sum(axis=0)
        self._lost += batch.link_up.size - int(np.count_nonzero(batch.link_up))
        while self._due and self._due[0][0] <= batch.t[-1]:
            step, number, what = self._due.popleft()
            self.happened(f"step {step}: {what} (fault {number})")
        self._pace.append((now, int(batch.t[-1]) + 1))
        while self._pace[0][0] < now - PACE_S and len(self._pace) > 2:
            self._pace.popleft()

    def lines(self, width: int, height: int) -> list[Text]:
        """Return the table, in at most `height` lines of `width` cells; a terminal may report zero lines."""
        width, height = max(width, 1), max(height, 0)
        if self._last is None:
            return []
        head = [Text(line, "bold") for line in _folded(self._title(), width)]
        foot = [Text(line) for line in [*self._down(self._last, width), *_folded(self._sums(self._last), width)]]
        foot = foot[: max(0, height - len(head) - FEW)]
        room = height - len(head) - len(foot)
        spare = room - min(1 + len(self._ids), FEW + 1)
        folded = [line for event in self._events for line in textwrap.wrap(event, width)]
        events = folded[-spare:] if spare > 0 else []
        middle = self._nodes(self._last, width, room - len(events))
        lines = [*head, *middle, *foot, *(Text(event, "yellow") for event in events)][:height]
        for line in lines:
            line.truncate(width)
        return lines

    def _title(self) -> list[str]:
        (before, first), (now, done) = self._pace[0], self._pace[-1]
        title = [f"{self._topology.name}: step {done} of {self._topology.steps}"]
        if now > before and self._topology.steps > done > first:
            rate = (done - first) / (now - before)
            left = timedelta(seconds=round((self._topology.steps - done) / rate))
            title += [f"{rate:.{0 if rate >= 10 else 2}f} steps/s", f"{left} left"]
        return title

    def _nodes(self, batch: Batch, width: int, room: int) -> list[Text]:
        """Return a heading and the nodes, the worst first, in `room` lines; nothing if there is no space for a node."""
        if room < 2:
            return []
        x, ahat, dead, wrong = batch.x[-1], batch.ahat[-1], batch.dead[-1], batch.wrong[-1]
        silent = batch.missing[-1] & ~dead
        rank = np.select([dead, silent, wrong], [0, 1, 2], 3)
        hidden: list[Text] = []
        if room - 1 < len(rank):
            shown = _worst(rank, np.abs(x), room - 2)
            others = np.ones(len(rank), dtype=np.bool_)
            others[shown] = False
            counts = [np.count_nonzero(mask & others) for mask in (wrong, dead, silent)]
            what = zip(counts, ("wrong", "dead", "without input"), strict=True)
            others_text = ", ".join(f"{count} {name}" for count, name in what if count) or "none wrong"
            most = np.abs(x).max(where=others, initial=0.0)
            hidden = [Text(f"... {len(rank) - len(shown)} more: |x| <= {most:.4g}, {others_text}")]
        else:
            shown = np.argsort(rank, kind="stable")
        names = [escape(self._topology.network.title(k), keep="") for k in shown]
        broad = min(max(map(cell_len, [*names, "node"])), max(4, width // 4))
        columns: list[tuple[str, list[Cell]]] = [
            (set_cell_size("node", broad), [(set_cell_size(name, broad), "") for name in names]),
            ("          x", [(f"{x[k]:11.4g}", "") for k in shown]),
            ("    ahat", [("       -" if np.isnan(ahat[k]) else f"{ahat[k]:8.4g}", "") for k in shown]),
            ("model", [_model(bool(ahat[k] == batch.a[-1, k]), bool(wrong[k])) for k in shown]),
            ("missing inputs", [(f"{self._missing[k]:14d}", "yellow" if self._missing[k] else "") for k in shown]),
            ("state", [_now(bool(dead[k]), bool(silent[k])) for k in shown]),
        ]
        for expendable in (4, 2):
            if sum(len(heading) + 2 for heading, _ in columns) + len("no input") - len("state") - 2 > width:
                del columns[expendable]
        heading = Text("  ".join(heading for heading, _ in columns), "underline")
        rows = zip(*(cells for _, cells in columns), strict=True)
        legend = [Text(LEGEND, "dim")] if any(wrong[k] for k in shown) and room > len(shown) + 1 + len(hidden) else []
        return [heading, *(_row(cells) for cells in rows), *hidden, *legend]

    def _down(self, batch: Batch, width: int) -> list[str]:
        """Return the edges without flow and the links without messages at the last step."""
        closed: Mask = ~batch.edge_open[-1].astype(bool)
        # Per edge (i, j): True if i lacks j's message; and the reverse.
        lost = ~batch.link_up[-1].astype(bool)[self._ends]
        edges, links = np.flatnonzero(closed), np.flatnonzero(lost.any(axis=1))
        if not len(edges) and not len(links):
            return ["edges and links down: none"]
        lines = []
        if len(edges):
            lines.append(_listed("edges down: ", [self._between(e, "-") for e in edges[:NAMES]], len(edges), width))
        if len(links):
            names = [self._link(e, lost[e]) for e in links[:NAMES]]
            lines.append(_listed("links down: ", names, len(links), width))
        return lines

    def _link(self, edge: int, lost: Mask) -> str:
        if lost.all():
            return self._between(edge, "-")
        return self._between(edge, "->", backwards=bool(lost[0]))

    def _between(self, edge: int, sign: str, backwards: bool = False) -> str:
        i, j = (self._ids[k] for k in self._topology.graph.edges[edge].tolist())
        return f"{j}{sign}{i}" if backwards else f"{i}{sign}{j}"

    def _sums(self, batch: Batch) -> list[str]:
        gain, less = (float(batch.gain(v0)[-1]) for v0 in (0.0, self._v0))
        off = np.abs(batch.ahat[-1] - batch.a[-1])
        known = np.isfinite(off)
        real = bool((known & (batch.index[-1] < 0)).any())
        error = float(off[known].mean()) if known.any() else None
        estimates = [estimates_text(real, int(batch.right[-1]), len(self._ids), error)]
        losses = ((self._missing.sum(), "missing inputs"), (self._lost, "lost messages"))
        return [
            *estimates,
            *(f"{k} {what}" for k, what in losses if k),
            f"regret D {batch.regret_sum[-1]:.4g} (nominal {batch.nominal_regret_sum[-1]:.4g})",
            f"cost regret {batch.cost_regret[-1]:+.4g}",
            gain_text(gain, less, self._topology.network.gamma_star_now, not np.isnan(batch.slack[-1])),
        ]


def _worst(rank: Index, x: NDArray[np.float64], some: int) -> Index:
    """Return up to `some` nodes in order: the lowest rank first and, within a rank, the largest |x|."""
    chosen: list[Index] = []
    for one in range(4):
        found = np.flatnonzero(rank == one)
        if len(found) > some:  # only a few of a million nodes need an order
            found = found[np.sort(np.argpartition(-x[found], some - 1)[:some])] if some else found[:0]
        chosen.append(found[np.argsort(-x[found], kind="stable")])
        some -= len(found)
    return np.concatenate(chosen)


def _model(right: bool, wrong: bool) -> Cell:
    return ("WRONG", "magenta") if wrong else ("right", "green") if right else ("-    ", "")


def _now(dead: bool, silent: bool) -> Cell:
    return ("dead", "bold red") if dead else ("no input", "bold yellow") if silent else ("", "")


def _row(cells: Iterable[Cell]) -> Text:
    row = Text()
    for k, (text, style) in enumerate(cells):
        row.append("  " * (k > 0))
        row.append(text, style)
    return row


def _folded(phrases: Sequence[str], width: int) -> list[str]:
    """Return phrases, separated by commas, in lines of `width`."""
    return textwrap.wrap(", ".join(phrases), width, break_on_hyphens=False)


def _listed(head: str, names: Sequence[str], count: int, width: int) -> str:
    """Return as many names as fit in a line, and the number of the remaining ones."""
    line, named = head, 0
    for name in names:
        rest = f" and {count - named - 1} more" if named + 1 < count else ""
        longer = f"{line}{', ' if named else ''}{name}"
        if cell_len(longer + rest) > width:
            break
        line, named = longer, named + 1
    return line + (f" and {count - named} more" if 0 < named < count else f"{count}" if not named else "")


class Table:
    """A table that is drawn again and again; the last one stays, with the verdict below it."""

    interactive = True

    def __init__(
        self, topology: Topology, console: Console | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._console = _console() if console is None else console
        self.outlet = Outlet()
        self._clock = clock
        self._standing = Standing(topology)
        self._live: Live | None = None
        self._drawn_at = -REDRAW_S
        self._size = self._console.size

    def say(self, text: str) -> None:
        if self._live is None:
            self.outlet.write(lambda: self._console.print(escape(text), markup=False))
            return
        self._standing.happened(text)
        self._draw_if_due()

    def progress(self, batch: Batch) -> None:
        self._standing.take(batch, self._clock())
        if self._live is None:
            self._live = Live(console=self._console, auto_refresh=False, redirect_stdout=False, redirect_stderr=False)
            self.outlet.write(self._live.start)
            self.outlet.write(self._console.show_cursor)  # otherwise a hidden cursor could remain, even after SIGKILL
        self._draw_if_due()

    def _draw_if_due(self) -> None:
        if self._live is not None and self._clock() - self._drawn_at >= REDRAW_S:
            self._drawn_at = self._clock()
            self._draw(self._live)

    def _draw(self, live: Live, refresh: bool = True) -> None:
        if (size := self._console.size) != self._size:
            self._size = size
            self.outlet.write(self._console.clear)  # in folded lines, the start of the table is unknown
        # The last line remains empty, for the cursor and for the ^C of the terminal.
        lines = self._standing.lines(size.width, size.height - 2)
        self.outlet.write(lambda: live.update(Text("\n").join([*lines, Text()]), refresh=refresh))

    def verdict(self, verdict: Verdict, folder: Path) -> None:
        self.close()
        self.outlet.write(lambda: _tell(self._console, verdict, folder))

    def close(self) -> None:
        if self._live is not None:
            self._draw(self._live, refresh=False)
            self.outlet.write(self._live.stop)
            self._live = None


class Bar:
    """A progress bar."""

    interactive = True

    def __init__(self, steps: int) -> None:
        self._console = _console()
        self.outlet = Outlet()
        self._bar = Progress(
            TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[rate]}"),
            TimeRemainingColumn(), console=self._console, transient=True, auto_refresh=False,
            redirect_stdout=False, redirect_stderr=False,
        )  # fmt: skip
        self._task = self._bar.add_task("steps", total=steps, rate="")
        self._began: float | None = None
        self._drawn_at = -REDRAW_S

    def say(self, text: str) -> None:
        self.outlet.write(lambda: self._console.print(escape(text), markup=False))

    def progress(self, batch: Batch) -> None:
        done = int(batch.t[-1]) + 1
        if self._began is None:
            self._began = time.monotonic()
            self.outlet.write(self._bar.start)
        seconds = time.monotonic() - self._began
        rate = f"{done / seconds:.0f} steps/s" if seconds > 0 else ""
        # Draw here, not on a thread of Rich: that would end with a traceback when the terminal is closed.
        due = time.monotonic() - self._drawn_at >= REDRAW_S
        self._drawn_at = time.monotonic() if due else self._drawn_at
        self.outlet.write(lambda: self._bar.update(self._task, completed=done, rate=rate, refresh=due))

    def verdict(self, verdict: Verdict, folder: Path) -> None:
        self.close()
        self.outlet.write(lambda: _tell(self._console, verdict, folder))

    def close(self) -> None:
        self.outlet.write(self._bar.stop)


def _console() -> Console:
    with contextlib.suppress(AttributeError):  # a name that this terminal cannot write must not end the run
        sys.stdout.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]
    return Console(highlight=False, soft_wrap=True, markup=False, emoji=False)


def _tell(console: Console, verdict: Verdict, folder: Path) -> None:
    console.print(escape(left_behind(folder)), markup=False)
    colour = {VALID: "green", INVALID: "bold red"}.get(verdict.verdict, "yellow")
    console.print(escape(verdict.line()), style=colour, markup=False)
