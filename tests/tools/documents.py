"""Documents as tests read them: fenced blocks, the commands in them, tables, and a folder to run them in."""

from __future__ import annotations

import doctest
import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.tools import preloaded

ROOT = Path(__file__).parents[2]
DOCS = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
COMMAND_DEADLINE_S = 120.0


@dataclass(frozen=True)
class Block:
    """One fenced block: its language, the file name after it, its first line, and its content."""

    language: str
    name: str
    line: int
    text: str


def blocks(document: Path) -> Iterator[Block]:
    """Yield the fenced blocks of a document, in order; a block of output right after a block is recognised by its
    line.
    """
    fence = re.compile(r"^```(\w+)?[ ]*(\S*)[^\n]*\n(.*?)^```$", re.MULTILINE | re.DOTALL)
    text = document.read_text(encoding="utf-8")
    for found in fence.finditer(text):
        line = text[: found.start()].count("\n") + 1
        yield Block(found[1] or "", found[2], line, found[3])


def follows(before: Block, block: Block) -> bool:
    """Return True if only an empty line separates two blocks."""
    return block.line == before.line + before.text.count("\n") + 3


def commands(console: str) -> Iterator[tuple[str, int, str]]:
    """Yield each command to run, its expected exit code, and its output on the page."""
    for part in re.split(r"^\$ ", console, flags=re.MULTILINE)[1:]:
        command, _, shown = part.partition("\n")
        command, _, comment = command.partition("#")
        if not command.startswith("orchestrator") or "not run" in comment:
            continue
        claim = re.search(r"exits?(?: code)? (\d+)", comment)
        yield command.strip(), int(claim[1]) if claim else 0, shown


def same_output(shown: str, printed: str) -> bool:
    """Return True if the shown output was printed, up to blanks and with `...` for any text."""
    flags = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    return doctest.OutputChecker().check_output(shown.strip(), printed.strip(), flags)


class Scratch:
    """The folder of a document: no command writes or reads outside of it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        runtime = folder / ".runtime"
        runtime.mkdir()
        hidden = ("DISPLAY", "WAYLAND_DISPLAY", "PYTHONPATH")
        self.environment = {key: value for key, value in os.environ.items() if key not in hidden} | {
            "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
            "XDG_RUNTIME_DIR": str(runtime),
            "COLUMNS": "160",
        }
        self.python: tuple[str, ...] = (sys.executable, "-W", "error")

    def preload(self) -> None:
        """Let commands and programs begin in processes that have loaded the modules already."""
        self.python = (str(preloaded.SESSION.programs / "program"),)
        self.environment["PATH"] = f"{preloaded.SESSION.programs}{os.pathsep}{self.environment['PATH']}"

    def _started(self, command: Sequence[str], alone: bool = False) -> subprocess.Popen[str]:
        """A command that runs, with its output as one text; `alone` gives it a session, and so a group to kill."""
        return subprocess.Popen(
            command,
            cwd=self.folder,
            env=self.environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=alone,
        )

    def run(self, *command: str) -> tuple[int, str]:
        """The exit code of a command, and all that it printed."""
        with self._started(command) as process:
            try:
                printed, _ = process.communicate(timeout=COMMAND_DEADLINE_S)
            except subprocess.TimeoutExpired:
                process.kill()
                raise
        return process.returncode, printed

    def run_command(self, command: str) -> tuple[int, str]:
        """The same for a command of a page in a shell; a network with a rate soon runs without it."""
        shell = ("bash", "-o", "pipefail", "-c", command)
        if "--rate" not in command or "--detach" in command:
            return self.run(*shell)
        with self._started(shell, alone=True) as process:
            assert process.stdout is not None
            end = threading.Timer(COMMAND_DEADLINE_S, os.killpg, (process.pid, signal.SIGKILL))
            end.start()
            printed, paced = "", True
            for line in process.stdout:
                printed += line
                if paced and line.startswith("step "):
                    paced = self.run("orchestrator", "rate", "0")[0] != 0
            end.cancel()
        assert not paced, printed
        return process.returncode, printed


def table(document: str, heading: str, number: int = 0) -> list[dict[str, str]]:
    """Return the rows of a table of a section, by column name, without backquotes."""
    text = (ROOT / "docs" / document).read_text(encoding="utf-8")
    section = re.split(r"^#+ ", text.split(f"# {heading}\n", 1)[1], maxsplit=1, flags=re.MULTILINE)[0]
    found = re.findall(r"(?:^\|.*\|\n)+", section, flags=re.MULTILINE)[number]
    lines = [re.split(r"(?<!\\)\|", line)[1:-1] for line in found.splitlines()]
    titles, _, *rows = [[cell.strip().replace("`", "").replace("\\|", "|") for cell in line] for line in lines]
    return [dict(zip(titles, row, strict=True)) for row in rows]
