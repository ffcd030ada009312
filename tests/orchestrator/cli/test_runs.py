"""`orchestrator runs`, the options that all commands share, and the help text."""

from __future__ import annotations

import json
import os
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

import hedgerow as hg
from hedgerow.orchestrator.cli.exit_code import run_to_exit_code
from hedgerow.orchestrator.cli.main import app
from tests.tools.processes import COMMAND, Orchestrator

PAIR = {"name": "pair", "b": 0.1, "steps": 6, "seed": 3, "nodes": ["p", "q"], "edges": [["p", "q"]]}


def output_of(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert run_to_exit_code(lambda: app([*words], standalone_mode=False) or 0) == 0
    return capsys.readouterr().out


def test_runs_are_listed_with_their_verdicts(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    hg.simulate(PAIR)
    (here / "runs" / "empty").mkdir()
    (killed := hg.simulate(PAIR, run_dir="runs/killed").folder / "verdict.json").unlink()
    (damaged := hg.simulate(PAIR, run_dir="runs/damaged").folder / "verdict.json").write_text("{")
    found = {one["run"]: one for one in json.loads(output_of(capsys, "runs", "--json"))}
    assert len(found) == 3
    assert found[killed.parent.name]["verdict"] == "none"
    assert found[damaged.parent.name]["verdict"] == "unreadable"
    whole = next(one for one in found.values() if one["verdict"] == "valid")
    assert (whole["network"], whole["law"], whole["steps_done"], whole["steps"]) == ("pair", "minimax", 6, 6)
    assert whole["size"] > 1000
    lines = output_of(capsys, "runs").splitlines()
    assert {line.split()[0] for line in lines} == {"valid", "none", "unreadable"}


def test_older_runs_are_removed_when_asked(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folders = [hg.simulate(PAIR).folder for _ in range(3)]
    for age, folder in enumerate(reversed(folders)):
        for path in (folder, *folder.rglob("*")):
            os.utime(path, (1e9 - 60 * age, 1e9 - 60 * age))
    assert "2 of 3" in output_of(capsys, "runs", "--keep", "1", "--dry-run")
    assert all(folder.exists() for folder in folders)
    output_of(capsys, "runs", "--keep", "1")
    assert [folder.exists() for folder in folders] == [False, False, True]
    output_of(capsys, "runs", "--keep", "0")
    assert not [*Path("runs").iterdir()], "runs/latest must not point to a removed run"


def test_a_running_network_is_never_removed(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with Orchestrator("up", "paper7", "--steps", "1000000", "--viewer", "none", "--no-record") as network:
        network.wait_for_event("first_step")
        (one,) = json.loads(output_of(capsys, "runs", "--json"))
        assert one["verdict"] == "running"
        output_of(capsys, "runs", "--keep", "0")
        assert Path(one["folder"]).exists()


def test_quiet_prints_the_verdict_alone(here: Path, capfd: pytest.CaptureFixture[str]) -> None:
    done = subprocess.run([*COMMAND, "simulate", "paper7", "-q"], capture_output=True, text=True, check=True)
    assert re.fullmatch(r"valid: .*\n", done.stdout)
    assert not done.stderr


@pytest.mark.parametrize(
    ("words", "lines"),
    [
        (("sweep", "pair.yaml", "--seeds", "0:2", "--jobs", "1"), 1),
        (("worst", "pair.yaml", "--budget", "1s"), None),
        (("compare", "pair.yaml", "--seeds", "0:2", "--jobs", "1"), None),
        (("chaos", "--nodes", "3"), 0),
    ],
)
def test_quiet_prints_no_progress(
    here: Path, capfd: pytest.CaptureFixture[str], words: tuple[str, ...], lines: int | None
) -> None:
    Path("pair.yaml").write_text(json.dumps(PAIR))
    run_to_exit_code(lambda: app([*words, "-q"], standalone_mode=False) or 0)
    printed = capfd.readouterr()
    assert not printed.err
    assert lines is None or len(printed.out.splitlines()) == lines


def test_the_version_is_that_of_the_package(capsys: pytest.CaptureFixture[str]) -> None:
    assert output_of(capsys, "--version") == f"hedgerow {hg.__version__}\n"


def test_every_command_is_in_a_panel_and_no_text_is_cut(capsys: pytest.CaptureFixture[str]) -> None:
    text = output_of(capsys, "--help")
    panels = re.findall(r"^(\S.*):$", text, re.MULTILINE)
    assert panels == ["Options", "Run", "Watch and control", "Inspect", "Experiment", "Deploy"]
    assert "..." not in text.split("Options:")[1]


def commands(group: Any, *words: str) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield every command with its words."""
    for name, command in group.commands.items():
        yield (*words, name), command
        if hasattr(command, "commands"):
            yield from commands(command, *words, name)


COMMANDS = dict(commands(typer.main.get_command(app)))


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_help_fits_80_columns_and_shows_all_options(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    text = output_of(capsys, *words, "--help")
    assert max(map(len, text.splitlines())) <= 80
    assert all(option in text for parameter in COMMANDS[words].params for option in parameter.opts if option[0] == "-")
    assert not [line for line in text.splitlines()[1:] if line.endswith("...")]


@pytest.mark.parametrize("name", ["compare", "simulate", "soak", "sweep", "up", "worst", "chaos"])
def test_commands_that_print_progress_can_be_quiet(name: str) -> None:
    assert "-q" in {option for parameter in COMMANDS[(name,)].params for option in parameter.opts}


@pytest.mark.parametrize(
    ("words", "offered"), [("check pap", {"paper7"}), ("runs --ke", {"--keep"}), ("report pair", {"pair-1", "pair-2"})]
)
def test_a_shell_completes_names(here: Path, words: str, offered: set[str]) -> None:
    for name in ("pair-1", "pair-2", "other"):
        hg.simulate(PAIR, run_dir=f"runs/{name}")
    shell = {"_ORCHESTRATOR_COMPLETE": "complete_bash", "COMP_WORDS": f"orchestrator {words}", "COMP_CWORD": "2"}
    program = "import sys; sys.argv = ['orchestrator']; from hedgerow.orchestrator.__main__ import main; main()"
    done = subprocess.run(
        [COMMAND[0], "-c", program], env=os.environ | shell, capture_output=True, text=True, check=False
    )
    assert offered == set(done.stdout.split())
