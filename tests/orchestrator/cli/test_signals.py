"""A signal at any moment of a command: no traceback, no temporary file, and the exit code of the signal."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import pytest

from hedgerow.topologies.errors import Exit
from hedgerow.wire import first, start
from tests.orchestrator.cli.test_shells import code, run
from tests.tools.processes import DEADLINE_S

SIGNALS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]
PAIR = '{"name": "pair", "b": 0.1, "steps": 6, "seed": 3, "nodes": ["p", "q"], "edges": [["p", "q"]]}'
LAW = "import os\nos.kill(os.getpid(), {})\nfrom hedgerow.agents.law import Minimax as Law\n"


def line(number: int) -> bytes:
    """The line of a command that a signal ended."""
    return first.LINE.format(start.name_of(number)).encode()


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
    assert done.stderr == line(number)
    assert names(here) == before


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_while_the_law_loads_leaves_no_run(here: Path, number: signal.Signals) -> None:
    (here / "slow.py").write_text(LAW.format(int(number)))
    (here / "pair.yaml").write_text(json.dumps(json.loads(PAIR) | {"law": "slow:Law"}))
    done = run("simulate", "pair.yaml", "--no-record")
    assert done.returncode == 128 + number, done.stderr
    assert done.stderr == line(number)
    assert names(here) == {"slow.py", "pair.yaml"}


@pytest.mark.parametrize("number", SIGNALS[1:2])
def test_a_signal_before_the_first_step_leaves_no_run(here: Path, number: signal.Signals) -> None:
    (here / "pair.yaml").write_text(PAIR)
    done = run("simulate", "pair.yaml", command=planted("hedgerow.orchestrator.launch.recording", "Observer", number))
    assert done.returncode == 128 + number, done.stderr
    assert names(here / "runs") == set()


@pytest.mark.parametrize("module", ["launch.launching", "launch.recording"])
def test_a_signal_while_the_processes_start_leaves_no_run_or_names_it(here: Path, module: str) -> None:
    """The processes have written logs and views already. The run is long: after its last step a signal is too late."""
    (here / "pair.yaml").write_text(PAIR)
    name = {"launch.launching": "truth_of", "launch.recording": "Recording"}[module]
    command = planted(f"hedgerow.orchestrator.{module}", name, signal.SIGINT)
    done = run("up", "pair.yaml", "--steps", "1000000", "--viewer", "none", "--no-record", command=command)
    assert done.returncode in {Exit.UNKNOWN, 128 + signal.SIGINT}, done.stderr
    for folder in {path.resolve() for path in (here / "runs").iterdir()}:
        assert str(folder).encode() in done.stdout + done.stderr


@pytest.mark.parametrize("logs", [False, True])
def test_a_run_that_a_signal_ended_before_it_began_takes_its_logs_along(here: Path, logs: bool) -> None:
    """A folder that stays after an error is named."""
    (here / "pair.yaml").write_text(PAIR)
    error = "KeyboardInterrupt" if logs else "e.HedgerowError('no')"
    text = (
        "import pathlib, hedgerow.topologies.errors as e, hedgerow.orchestrator.launch.up as m\n"
        "def run(self, *_):\n"
        " (self._folder.logs / 'plant.log').write_text('x')\n (self._folder.processes / '0.npz').write_text('x')\n"
        f" raise {error}\nm.Network.run = run\n"
    )
    done = run("up", "pair.yaml", "--viewer", "none", command=code(text))
    assert done.returncode == (128 + signal.SIGINT if logs else Exit.UNKNOWN), done.stderr
    left = {path.resolve() for path in (here / "runs").iterdir()}
    assert len(left) == (0 if logs else 1)
    for folder in left:
        assert str(folder).encode() in done.stderr


@pytest.mark.parametrize("command", ["simulate", "up"])
def test_a_refused_run_leaves_no_folder(here: Path, command: str) -> None:
    (here / "pair.yaml").write_text(PAIR)
    assert run(command, "pair.yaml", "--viewer", "nowhere").returncode == Exit.USER_MISTAKE
    assert names(here) == {"pair.yaml"}


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_that_arrives_in_a_destructor_is_not_lost(here: Path, number: signal.Signals) -> None:
    """Python reports what a destructor raises, and continues."""
    (here / "slow.py").write_text(
        f"import os, time\nclass Gone:\n def __del__(self):\n  os.kill(os.getpid(), {int(number)})\n  time.sleep(0.1)\n"
    )
    (here / "pair.yaml").write_text(PAIR)
    text = (
        "import sys, time\nsys.path.insert(0, '.')\nimport slow, hedgerow.orchestrator.metrics.summary as c\n"
        f"def table(_):\n slow.Gone()\n time.sleep({DEADLINE_S})\nc.table = table"
    )
    done = run("check", "pair.yaml", command=code(text))
    assert (done.returncode, done.stdout, done.stderr) == (128 + number, b"", line(number))


def test_a_search_that_is_stopped_in_a_run_names_the_signal(here: Path) -> None:
    text = planted("hedgerow.orchestrator.launch.up", "Network._observe", signal.SIGTERM)
    done = run("chaos", command=text)
    assert (done.returncode, done.stdout, done.stderr) == (Exit.UNKNOWN, b"", line(signal.SIGTERM))


def test_the_line_about_a_signal_is_written_once(here: Path) -> None:
    (here / "pair.yaml").write_text(PAIR)
    text = (
        "import os, hedgerow.orchestrator.metrics.summary as c\n"
        "def table(_):\n try:\n  os.kill(os.getpid(), 2)\n finally:\n  os.kill(os.getpid(), 15)\nc.table = table"
    )
    done = run("check", "pair.yaml", command=code(text))
    assert (done.returncode, done.stderr) == (128 + signal.SIGTERM, line(signal.SIGTERM))
