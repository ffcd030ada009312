"""A signal at any moment of a command: no traceback, no temporary file, and the exit code of the signal."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import pytest

from hedgerow.topologies.errors import Exit
from tests.orchestrator.cli.test_shells import code, run

SIGNALS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]
PAIR = '{"name": "pair", "b": 0.1, "steps": 6, "seed": 3, "nodes": ["p", "q"], "edges": [["p", "q"]]}'
LAW = "import os\nos.kill(os.getpid(), {})\nfrom hedgerow.agents.law import Minimax as Law\n"


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def planted(module: str, name: str, number: int) -> tuple[str, ...]:
    """A command that gets a signal in a function, when the modules are loaded."""
    return code(
        f"import os, importlib\nm = importlib.import_module('{module}')\nwhole = m.{name}\n"
        f"def planted(*a, **k):\n os.kill(os.getpid(), {int(number)})\n return whole(*a, **k)\nm.{name} = planted\n"
    )


@pytest.mark.parametrize("number", SIGNALS[:2])
def test_a_report_leaves_nothing_half_written(here: Path, number: signal.Signals) -> None:
    assert run("simulate", "paper7", "--steps", "3", "--no-record", "--run-dir", "done", "-q").returncode == 0
    before = names(here)
    save = planted("matplotlib.backends.backend_agg", "FigureCanvasAgg.print_png", number)
    done = run("report", "done", "--figures", "gain", command=save)
    assert done.returncode == 128 + number, done.stderr
    assert done.stderr == b""
    assert names(here) == before


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_while_the_law_loads_leaves_no_run(here: Path, number: signal.Signals) -> None:
    (here / "slow.py").write_text(LAW.format(int(number)))
    (here / "pair.yaml").write_text(json.dumps(json.loads(PAIR) | {"law": "slow:Law"}))
    done = run("simulate", "pair.yaml", "--no-record")
    assert done.returncode == 128 + number, done.stderr
    assert done.stderr == b""
    assert names(here) == {"slow.py", "pair.yaml"}


@pytest.mark.parametrize("number", SIGNALS[1:2])
def test_a_signal_before_the_first_step_leaves_no_run(here: Path, number: signal.Signals) -> None:
    (here / "pair.yaml").write_text(PAIR)
    done = run("simulate", "pair.yaml", command=planted("hedgerow.orchestrator.launch.recording", "Observer", number))
    assert done.returncode == 128 + number, done.stderr
    assert names(here / "runs") == set()


@pytest.mark.parametrize("command", ["simulate", "up"])
def test_a_refused_run_leaves_no_folder(here: Path, command: str) -> None:
    (here / "pair.yaml").write_text(PAIR)
    assert run(command, "pair.yaml", "--viewer", "nowhere").returncode == Exit.USER_MISTAKE
    assert names(here) == {"pair.yaml"}
