"""The generated pages of the site: the commands, and the docstrings of the Python interface."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer
from docutils import nodes
from pygments.lexers.special import TextLexer
from sphinx.application import Sphinx

PAGE = "commands.md"
_CODE = re.compile(r"(?<![`:\w])`([^`]+)`(?![`\w])")
_OPTION = re.compile(r"(?<![`\w-])--[a-z][a-z-]*(?: (?:native|web|none)\b)?(?![`\w])")
_BRACES = re.compile(r"\{([^{}]+)\}")
"""a required argument, as some releases of Typer print it"""
_SPECIAL = re.compile(r"(?<!\w)([|*])(?=\S)|(?<=\w)_(?=\W|$)")


def commands() -> str:
    """Return the page of the command line: every command with its arguments and options."""
    from hedgerow.orchestrator.cli.main import app  # noqa: PLC0415
    from hedgerow.orchestrator.cli.names import PANELS  # noqa: PLC0415

    lines = ["# Commands", "", "Each command prints its part of this page with `--help`.", ""]
    panel = ""
    group: Any = typer.main.get_command(app)
    for name, command in sorted(group.commands.items(), key=lambda one: PANELS.index(one[1].rich_help_panel)):
        if command.rich_help_panel != panel:
            panel = command.rich_help_panel
            lines += [f"## {panel}", ""]
        for path, inside in _walk(f"orchestrator {name}", command):
            lines += _section(path, inside)
    return "\n".join(lines) + "\n"


def _walk(path: str, command: Any) -> Iterator[tuple[str, Any]]:
    if not command.hidden:
        yield path, command
        for name, inside in getattr(command, "commands", {}).items():
            yield from _walk(f"{path} {name}", inside)


def _section(path: str, command: Any) -> list[str]:
    usage = " ".join(command.collect_usage_pieces(command.make_context(path, [], resilient_parsing=True)))
    usage = _BRACES.sub(r"\1", usage)
    lines = [
        f"### {path.removeprefix('orchestrator ')}",
        "",
        f"```text\n{path} {usage}\n```",
        "",
        _coded(command.help or ""),
        "",
    ]
    rows = [_row(parameter) for parameter in command.params if not getattr(parameter, "hidden", False)]
    rows = [row for row in rows if row]
    return [*lines, *(["| Option | Description |", "|---|---|", *rows, ""] if rows else [])]


PIPE = r"\|"
"""a pipe within a cell of a table"""


def _coded(text: str) -> str:
    """Return a help text with its options as code: otherwise the two hyphens become a dash."""
    return _OPTION.sub(r"`\g<0>`", text)


def _row(parameter: Any) -> str:
    spelled = [*parameter.opts, *parameter.secondary_opts]
    if "--help" in spelled:
        return ""
    if parameter.param_type_name == "argument":
        spelled = [(parameter.metavar or parameter.name).upper()]
    elif not parameter.is_flag:
        spelled[-1] += f" {parameter.metavar or spelled[0].strip('-').upper()}"
    names = ", ".join(f"`{name}`" for name in spelled)
    described = _coded(" ".join((getattr(parameter, "help", None) or "").split()))
    default = parameter.default if not callable(parameter.default) else None
    if default not in (None, False, (), [], "") and "default" not in described and "[" not in described:
        described += f" [`{spelled[0] if default is True else default}`]"
    return f"| {names.replace('|', PIPE)} | {described.replace('|', PIPE)} |"


def write(_: Sphinx) -> None:
    """Write the page of the commands, unless it is unchanged: an unchanged file is not built again."""
    page, text = Path(__file__).parents[1] / PAGE, commands()
    if not page.exists() or page.read_text(encoding="utf-8") != text:
        page.write_text(text, encoding="utf-8")


def plain_to_rst(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Rewrite a docstring in place: our docstrings are plain text with `code` in single backticks and indented
    equations.
    """
    del app, what, name, obj, options
    written: list[str] = []
    text: list[str] = []
    literal = False
    for k, line in enumerate(lines):
        indented = line.startswith("    ")
        if indented and not literal and (k == 0 or not lines[k - 1].strip()):
            written += [*_inline(text), "::", ""]
            text, literal = [], True
        elif line.strip() and not indented:
            literal = False
        if literal:
            written.append(line)
        else:
            text.append(line)
    lines[:] = written + _inline(text)


def _inline(text: list[str]) -> list[str]:
    """Return lines of text with code in double backticks, and with the special characters of the rest escaped.

    Code may go on in the next line. It is not escaped: reStructuredText would show the backslashes.
    """
    parts = _CODE.split("\n".join(text))
    marked = (
        f"``{' '.join(part.split())}``" if k % 2 else _SPECIAL.sub(r"\\\g<0>", part) for k, part in enumerate(parts)
    )
    return "".join(marked).split("\n") if text else []


SHORT = 24
"""the maximum length of code that never breaks at the end of a line, such as an option with its hyphens"""


LONG = 40
"""the length of a text in a cell that needs a wide column on a phone"""


def mark_sizes(app: Sphinx, doctree: nodes.document, name: str) -> None:
    """Mark short code and long cells for site.css."""
    del app, name
    for entry in doctree.findall(nodes.entry):
        if len(entry.astext()) >= LONG:
            entry["classes"].append("long")
    for literal in doctree.findall(nodes.literal):
        if len(literal.astext()) <= SHORT:
            literal["classes"].append("short")


def setup(app: Sphinx) -> dict[str, Any]:
    """Connect all of them to a build."""
    app.add_lexer("csv", TextLexer)  # Pygments has no lexer of that name
    app.connect("builder-inited", write)
    app.connect("autodoc-process-docstring", plain_to_rst)
    app.connect("doctree-resolved", mark_sizes)
    return {"parallel_read_safe": True}
