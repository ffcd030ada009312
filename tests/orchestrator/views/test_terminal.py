"""The terminal's view of a run: a live table; only the verdict follows its last line.

paper7:  1 - 2 - 3 - 5      drop  1->2 at every step
             |              cut   2-4 from 30 to 60
         6 - 4 - 7          crash 5 from 32 to 52
"""

from __future__ import annotations

import fcntl
import io
import json
import os
import pty
import re
import struct
import subprocess
import termios
import threading
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType

import pytest
from rich.console import Console

from hedgerow.orchestrator.metrics.observer import Batch, Observer
from hedgerow.orchestrator.views.screen import Json, Lines, screen
from hedgerow.orchestrator.views.terminal import REDRAW_S, Bar, Standing, Table
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from hedgerow.topologies.schema import Topology
from tests.tools.networks import read, simulate
from tests.tools.processes import COMMAND

DEADLINE_S = 60.0
FAULTS = [
    {"kind": "drop", "from": 1, "to": 2},
    {"kind": "cut", "edge": [2, 4], "steps": [30, 60]},
    {"kind": "crash", "node": 5, "at": 32, "restart_after": 20},
]


def paper7(*faults: object) -> Topology:
    return resolve(load("paper7", ["steps=100", f"faults={json.dumps(faults)}"]))


def ring(nodes: int) -> Topology:
    defaults = {"x0": 10, "candidates": {"random": 3}, "disturbance": {"kind": "sinusoid", "amplitude": 1, "omega": 1}}
    edges = [[i, (i + 1) % nodes] for i in range(nodes)]
    whole = {"name": "ring", "b": 0.1, "steps": 10, "defaults": defaults, "nodes": list(range(nodes)), "edges": edges}
    return read(json.dumps(whole))


def batches(topology: Topology, rows: int = 5) -> Iterator[Batch]:
    observer, ran = Observer(topology), simulate(topology)
    return (observer.take(ran.rows[k : k + rows]) for k in range(0, len(ran.rows), rows))


def terminal(width: int = 80, height: int = 24) -> Console:
    return Console(
        file=io.StringIO(), width=width, height=height, force_terminal=True, color_system="standard", record=True
    )


def after(topology: Topology, step: int) -> Standing:
    """Return the status of a run after `step` steps, in batches of five that take half a second each."""
    standing = Standing(topology)
    for k, batch in enumerate(batches(topology)):
        standing.take(batch, k / 2)
        if batch.t[-1] + 1 == step:
            break
    return standing


def picture(standing: Standing, width: int = 80, height: int = 24, styles: bool = False) -> list[str]:
    """Return the picture on a terminal."""
    console = terminal(width, height)
    for line in standing.lines(width, height):
        console.print(line, highlight=False)
    return console.export_text(styles=styles).splitlines()


def row_of(node: int, lines: list[str]) -> list[str]:
    (row,) = (line.split() for line in lines if re.match(rf"{node} +-?[\d.]+ ", line))
    return row


def test_the_table_shows_progress_and_costs() -> None:
    topology = paper7()
    lines = picture(after(topology, 40))
    standing = list(batches(topology))[7]
    assert lines[0] == "paper7: step 40 of 100, 10 steps/s, 0:00:06 left"
    assert "edges and links down: none" in lines
    sums = " ".join(lines[-3:])
    assert f"{standing.right[-1]} of 7 estimates right" in sums
    assert f"regret D {standing.regret_sum[-1]:.4g} (nominal {standing.nominal_regret_sum[-1]:.4g})" in sums
    assert f"cost regret {standing.cost_regret[-1]:+.4g}" in sums
    assert f"gain {standing.gain()[-1]:.4g} " in sums


def test_a_wrong_model_is_a_word_as_well_as_a_colour() -> None:
    topology = paper7()
    batch = next(batches(topology))
    wrong = [node for k, node in enumerate(topology.ids) if batch.ahat[-1, k] != batch.a[-1, k]]
    assert 0 < len(wrong) < 7
    lines = picture(after(topology, 5))
    assert {row[0] for row in map(str.split, lines) if "WRONG" in row[1:]} == {str(node) for node in wrong}
    assert [line.split()[0] for line in lines[2 : 2 + len(wrong)]] == [str(node) for node in wrong], "the worst first"
    coloured = "\n".join(picture(after(topology, 5), styles=True))
    assert "\x1b[35mWRONG" in coloured
    assert "\x1b[32mright" in coloured


def test_dead_nodes_and_cut_edges_are_shown_while_they_last() -> None:
    topology = paper7(*FAULTS)
    before, while_it_lasts, afterwards = (picture(after(topology, step)) for step in (30, 40, 65))
    assert not [line for line in before if line.startswith("edges down") or line.endswith("dead")]
    assert "links down: 1->2" in before

    assert while_it_lasts[2].split() == row_of(5, while_it_lasts)
    assert row_of(5, while_it_lasts)[2:] == ["-", "-", "8", "dead"], "no estimate, no input since step 32"
    assert "edges down: 2-4, 3-5" in while_it_lasts
    assert "links down: 1->2, 3-5" in while_it_lasts
    assert while_it_lasts[-3:] == [
        "step 0: drop 1->2 at every step (fault 1)",
        "step 30: cut 2-4 from step 30 to 60 (fault 2)",
        "step 32: crash 5 from step 32 to 52 (fault 3)",
    ]

    assert not [line for line in afterwards if line.startswith("edges down") or line.endswith("dead")]
    assert row_of(5, afterwards)[4] == "20", "what was missing is not forgotten"
    assert "20 missing inputs" in " ".join(afterwards)


def test_a_silent_but_running_node_is_not_shown_as_dead() -> None:
    lines = picture(after(paper7({"kind": "sensor", "node": 6, "steps": [8, 10]}), 10))
    assert row_of(6, lines)[-3:] == ["2", "no", "input"]
    assert lines[2].split()[0] == "6"


def test_rows_without_space_are_counted() -> None:
    topology = ring(100)
    lines = picture(after(topology, 10), height=12)
    assert len(lines) == 12
    shown = [
        line.split() for line in lines if line.rstrip().endswith(("WRONG               0", "right               0"))
    ]
    *_, batch = batches(topology)
    wrong = (batch.ahat[-1] != batch.a[-1]).sum()
    (rest,) = (line for line in lines if line.startswith("..."))
    found = re.fullmatch(r"\.\.\. (\d+) more: \|x\| <= ([\d.]+), (\d+) wrong", rest)
    assert found is not None, rest
    assert int(found[1]) == 100 - len(shown)
    assert int(found[3]) == wrong - len(shown), "the wrong ones come first"
    hidden = [abs(batch.x[-1, k]) for k in range(100) if str(k) not in {row[0] for row in shown}]
    assert float(found[2]) == pytest.approx(max(hidden), rel=1e-3)


def test_any_terminal_is_large_enough() -> None:
    standing = after(paper7(*FAULTS), 40)
    for width in (1, 10, 33, 60, 200):
        for height in (0, 1, 2, 5, 9, 14, 60):
            lines = picture(standing, width, height)
            assert len(lines) <= height
            assert all(len(line) <= width for line in lines)
    assert row_of(5, picture(standing, 33))[2:] == ["-", "dead"], "a narrow one shows fewer columns"
    assert [line.split()[0] for line in picture(standing, 60, 6)][1:4] == ["node", "5", "6"], "a low one fewer nodes"


def test_it_is_drawn_four_times_a_second_at_most_and_once_more_at_the_end() -> None:
    now, console = [100.0], terminal()
    table = Table(paper7(), console, lambda: now[0])
    table.say("paper7: 7 nodes")
    drawn = []
    for batch in batches(paper7(), rows=1):
        table.progress(batch)
        now[0] += REDRAW_S / 4
        drawn += re.findall(r"step \d+ of 100", console.export_text())
    assert len(drawn) == 25
    table.close()
    table.close()
    last = console.export_text()
    assert last.count("step 100 of 100") == 1
    assert "gain 5.967 with x(0)" in last


def test_messages_during_the_table_are_among_its_last_three_events() -> None:
    now, console = [0.0], terminal()
    table = Table(paper7(), console, lambda: now[0])
    table.progress(next(batches(paper7())))
    for k in range(5):
        now[0] += 1
        table.say(f"[step] {k}: going on without agent {k}")
    console.export_text()
    table.close()
    assert re.findall(r"\[step] (\d)", console.export_text()) == ["2", "3", "4"]


class Pty:
    """A command on a separate terminal."""

    def __init__(self, *arguments: str, width: int = 100, height: int = 30, **environment: str) -> None:
        self._master, slave = pty.openpty()
        self.resize(width, height)
        known = {key: value for key, value in os.environ.items() if key not in ("NO_COLOR", "COLUMNS", "LINES", "CI")}
        self._process = subprocess.Popen(
            [*COMMAND, *arguments],
            stdin=slave,
            stdout=slave,
            stderr=slave,
            start_new_session=True,
            preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),  # noqa: PLW1509 (one system call, no lock)
            env={**known, "TERM": "xterm-256color", **environment},
        )
        os.close(slave)
        self._changed = threading.Condition()
        self._ended = False
        self.output = ""
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()

    def _listen(self) -> None:
        while True:
            try:
                some = os.read(self._master, 65536)
            except OSError:  # the other end is closed
                some = b""
            with self._changed:
                self.output += some.decode(errors="replace")
                self._ended = not some
                self._changed.notify_all()
                if not some:
                    return

    def resize(self, width: int, height: int) -> None:
        fcntl.ioctl(self._master, termios.TIOCSWINSZ, struct.pack("HHHH", height, width, 0, 0))

    def wait_for(self, text: str, after: int = 0) -> int:
        """Wait until `text` appears after this number of characters; return its place."""
        with self._changed:
            assert self._changed.wait_for(lambda: text in self.output[after:] or self._ended, DEADLINE_S), self.output
            assert text in self.output[after:], self.output
            return self.output.index(text, after)

    def press_ctrl_c(self) -> None:
        os.write(self._master, b"\x03")

    def wait(self) -> int:
        code = self._process.wait(DEADLINE_S)
        with self._changed:
            assert self._changed.wait_for(lambda: self._ended, DEADLINE_S)
        return code

    @property
    def last_line(self) -> str:
        """Return the last line without its colours."""
        return re.sub(r"\x1b\[[\d;?]*[a-zA-Z]", "", self.output).replace("\r", "").rstrip("\n").rpartition("\n")[2]

    def leaves_the_terminal_as_it_was(self) -> bool:
        """Return True if the cursor is visible, colours are reset, there is no other screen, and the prompt has its own
        line.
        """
        cursor, colour = re.findall(r"\x1b\[\?25([hl])", self.output), re.findall(r"\x1b\[([\d;]*)m", self.output)
        return (
            cursor[-1:] in (["h"], [])
            and colour[-1:] in (["0"], [])
            and "\x1b[?1049" not in self.output
            and self.output.endswith("\n")
        )

    def __enter__(self) -> Pty:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()
        self._listener.join(DEADLINE_S)
        os.close(self._master)


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_a_simulation_ends_with_its_table_and_the_verdict_and_without_colours_nothing_is_lost() -> None:
    with Pty("simulate", "paper7", "--no-record", NO_COLOR="1") as ran:
        assert ran.wait() == 0
    assert "paper7: step 30 of 30" in ran.output
    assert "right" in ran.output
    assert not re.search(r"\x1b\[[\d;]*3\dm", ran.output)
    assert ran.last_line.startswith("valid: 30 of 30 steps")
    assert ran.leaves_the_terminal_as_it_was()


def test_plain_gives_lines_on_a_terminal_too() -> None:
    with Pty("simulate", "paper7", "--no-record", "--plain") as ran:
        assert ran.wait() == 0
    assert "\x1b" not in ran.output
    assert [line.split()[0] for line in ran.output.splitlines()] == ["run", "draw", "valid:"]


def test_ctrl_c_ends_a_simulation_below_its_table() -> None:
    with Pty("simulate", "paper7", "--no-record", "--steps", "1000000") as ran:
        ran.wait_for("left")
        ran.press_ctrl_c()
        assert ran.wait() == 3
    assert ran.last_line.startswith("unknown (stopped at step ")
    assert "Ctrl-C" in ran.last_line
    assert "\x1b[32mright" in ran.output
    assert ran.leaves_the_terminal_as_it_was()


def test_a_network_on_a_terminal_that_is_resized_and_interrupted() -> None:
    with Pty("up", "paper7", "--no-record", "--viewer", "none", "--steps", "1000000", "--processes", "1") as ran:
        shown = ran.wait_for("  missing inputs  state")
        ran.resize(36, 14)
        cleared = ran.wait_for("\x1b[2J", shown)
        narrow = ran.wait_for("  x  model  state", cleared)
        ran.press_ctrl_c()
        assert ran.wait() == 3
    assert "missing inputs" not in ran.output[narrow:]
    assert ran.last_line.startswith("unknown (stopped at step ")
    assert ran.leaves_the_terminal_as_it_was()


def test_the_cursor_is_visible_even_after_a_kill() -> None:
    with Pty("simulate", "paper7", "--no-record", "--steps", "1000000") as ran:
        ran.wait_for("left")
    assert re.findall(r"\x1b\[\?25([hl])", ran.output)[-1:] == ["h"]


class Tty(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(
    ("expected", "options", "term"),
    [
        (Table, {}, "xterm"),
        (Bar, {"watched": True}, "xterm"),
        (Lines, {"plain": True}, "xterm"),
        (Lines, {}, "dumb"),
        (Json, {"as_json": True, "plain": True}, "xterm"),
    ],
)
def test_the_picture_on_a_terminal(
    expected: type, options: dict[str, bool], term: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TERM", term)
    monkeypatch.setattr("sys.stdout", Tty())
    chosen = screen(paper7(), **{"as_json": False, **options})
    assert type(chosen) is expected
    assert chosen.interactive == (expected is not Json), "a page stays if a user can press Ctrl-C"
