"""Every command on a running network takes --run; those without another argument take its name alone too."""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest
import typer

from hedgerow.orchestrator.cli.main import app
from hedgerow.orchestrator.cli.options import chosen
from hedgerow.orchestrator.views.outlet import left_behind
from hedgerow.topologies.errors import Code, Exit, UserError
from tests.orchestrator.cli.test_named_networks import announce, listed
from tests.tools.processes import run_here

__all__ = ["listed"]
LIVE = ["status", "stop", "watch", "pause", "resume", "step", "rate", "heal"]


@pytest.mark.parametrize("name", LIVE)
def test_a_command_on_a_running_network_has_the_option_run(name: str) -> None:
    command = typer.main.get_command(app).get_command(None, name)  # type: ignore[attr-defined]
    assert "--run" in {option for parameter in command.params for option in parameter.opts}


def test_one_name_is_chosen_and_two_are_refused() -> None:
    assert chosen(None, None) is None
    assert chosen("a", None) == chosen(None, "a") == chosen("a", "a") == "a"
    with pytest.raises(UserError) as refused:
        chosen("a", "b")
    assert refused.value.code == Code.OPTION


@pytest.mark.parametrize("name", ["status", "stop", "watch", "pause", "resume"])
def test_two_names_end_a_command(
    name: str, listed: contextlib.ExitStack, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    announce(listed, monkeypatch, "pair-1", tmp_path)
    assert run_here(name, "pair-1", "--run", "pair-2").returncode == Exit.USER_MISTAKE


@pytest.mark.parametrize("parts", [[], ["run.rrd"], ["run-002.rrd"]])
def test_the_last_lines_of_a_run_name_its_recording_or_its_tables(tmp_path: Path, parts: list[str]) -> None:
    """A reader of `--no-record` would expect nothing to see."""
    for part in parts:
        (tmp_path / part).touch()
    folder, command = left_behind(tmp_path).splitlines()
    assert ("run.rrd" in folder) == (not parts)
    assert f" open {tmp_path}" in command
