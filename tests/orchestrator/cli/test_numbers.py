"""Numbers on the command line: the spellings of files, and messages with what was written."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
import typer.main

from hedgerow.orchestrator.cli.main import app
from hedgerow.orchestrator.cli.numbers import real_of, whole_of
from tests.tools.processes import orchestrator


@pytest.mark.parametrize(
    ("text", "value"), [("1e3", 1000), ("30", 30), ("3.0", 3), (" 7 ", 7), ("-2", -2), ("0e5", 0), ("1e18", 10**18)]
)
def test_a_whole_number_in_every_spelling_of_a_file(text: str, value: int) -> None:
    assert whole_of(text) == value


@pytest.mark.parametrize(
    ("text", "value"), [("0.5", 0.5), ("1e-3", 0.001), ("20", 20.0), (".5", 0.5), ("1e300", 1e300)]
)
def test_a_number_in_every_spelling_of_a_file(text: str, value: float) -> None:
    assert real_of(text) == value


@pytest.mark.parametrize(
    "text",
    ["", "ten", "1.5", "1_000", "1,000", "１２", "0x10", "nan", "inf", "1e400", "9" * 5000, "1e999999999", "\x1b[31m"],
)
def test_other_texts_are_no_whole_number(text: str) -> None:
    with pytest.raises(typer.BadParameter):
        whole_of(text, high=10**400)


@pytest.mark.parametrize("text", ["", "x", "nan", "inf", "1e400", "1/2", "50%", "0,5"])
def test_other_texts_are_no_number(text: str) -> None:
    with pytest.raises(typer.BadParameter):
        real_of(text)


def test_bounds_are_part_of_the_range() -> None:
    assert whole_of("1", 1, 1) == 1
    for text in ("0", "2"):
        with pytest.raises(typer.BadParameter):
            whole_of(text, 1, 1)


def _numbers(group: Any, *words: str) -> Iterator[tuple[tuple[str, ...], str]]:
    """Yield every command, and its options that look like numbers in the help text."""
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from _numbers(command, *words, name)
        for one in command.params:
            default = getattr(one, "default", None)
            if isinstance(default, int | float) and not isinstance(default, bool) and one.opts[0].startswith("--"):
                yield (*words, name), one.opts[0]


@pytest.mark.parametrize(("words", "option"), list(_numbers(typer.main.get_command(app))))
def test_no_number_is_refused_in_the_words_of_a_library(words: tuple[str, ...], option: str) -> None:
    """Every option with a number as its default is read by our parser."""
    command: Any = typer.main.get_command(app)
    for word in words:
        command = command.commands[word]
    # All arguments of the commands are missing: only the option's own message is compared.
    with pytest.raises(Exception, match="is not a") as caught:
        command.main([option, "many", "x", "x"], standalone_mode=False)
    assert "pars" not in str(caught.value)


@pytest.mark.parametrize("option", ["--steps", "--seed", "--rate", "--deadline", "--wait", "--split-recording"])
def test_a_wrong_number_is_shown_with_its_option(option: str) -> None:
    done = orchestrator("up", "paper7", option, "many")
    assert done.returncode == 2
    assert option in done.stderr
    assert "many" in done.stderr
    assert "pars" not in done.stderr
