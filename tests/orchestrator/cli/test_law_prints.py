"""The output of a law acts on no terminal and no log, and is not in the JSON of a command."""

import json
from pathlib import Path

import pytest

from tests.orchestrator.cli.test_foreign_text import HOSTILE, assert_harmless
from tests.tools.processes import orchestrator

LAW = f"""
import os, sys, threading, warnings
from hedgerow.agents.law import Minimax
TEXT = {HOSTILE!r}
print("loaded", TEXT)
class Law(Minimax):
    def act(self, *given, **more):
        print("told", TEXT)
        print("told", TEXT, file=sys.stderr)
        warnings.warn(TEXT)
        os.write(2, TEXT.encode())
        thread = threading.Thread(target=lambda: (_ for _ in ()).throw(ValueError(TEXT)))
        thread.start()
        thread.join()
        return super().act(*given, **more)
"""


@pytest.fixture
def file(here: Path) -> str:
    (here / "loud.py").write_text(LAW, encoding="utf-8")
    (here / "pair.yaml").write_text(
        "{name: pair, b: 0.1, steps: 6, seed: 3, law: 'loud:Law', nodes: [p, q], edges: [[p, q]]}"
    )
    return "pair.yaml"


def test_what_a_law_prints_acts_on_no_terminal(file: str) -> None:
    done = orchestrator("simulate", file, "--no-record")
    assert done.returncode == 0, done.stderr
    assert "told" in done.stdout
    assert_harmless(done.stdout, done.stderr)


@pytest.mark.parametrize(
    "words", [("simulate", "pair.yaml", "--no-record"), ("worst", "pair.yaml", "--budget", "0.2s", "--steps", "100")]
)
def test_the_json_of_a_command_is_its_only_output(file: str, words: tuple[str, ...]) -> None:
    assert words[1] == file
    done = orchestrator(*words, "--json")
    assert done.returncode == 0, done.stderr
    assert isinstance(json.loads(done.stdout), dict)
    assert "told" in done.stderr
    assert_harmless(done.stderr)


def test_the_log_of_an_agent_acts_on_no_terminal(file: str, here: Path) -> None:
    # What C code writes to an agent's log stays as it is.
    (here / "loud.py").write_text(LAW.replace("os.write", "print"), encoding="utf-8")
    done = orchestrator("up", file, "--viewer", "none", "--no-record", "--json")
    assert done.returncode == 0, done.stderr
    assert isinstance(json.loads(done.stdout), dict)
    log = (here / "runs/latest/logs/agent-p.log").read_text(encoding="utf-8")
    assert log.count("told") >= 12
    assert_harmless(log, done.stderr)
