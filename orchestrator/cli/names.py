"""The names of commands, and the words that users try instead."""

from __future__ import annotations

from typing import Any

import typer.core

_MEANT = {
    **dict.fromkeys(("run", "start", "launch"), "up"),
    **dict.fromkeys(("list", "ls", "networks"), "ps"),
    **dict.fromkeys(("end", "kill", "down", "quit"), "stop"),
    **dict.fromkeys(("continue", "unpause"), "resume"),
    **dict.fromkeys(("validate", "lint", "show"), "check"),
    **dict.fromkeys(("view", "viewer"), "watch"),
    **dict.fromkeys(("plot", "figures"), "report"),
    **dict.fromkeys(("sim",), "simulate"),
    **dict.fromkeys(("speed",), "rate"),
}


PANELS = RUN, WATCH, INSPECT, EXPERIMENT, DEPLOY = "Run", "Watch and control", "Inspect", "Experiment", "Deploy"
"""The panels of the help text, in order."""


class Commands(typer.core.TyperGroup):
    """A group of commands in panels, which also knows the command that a wrong word means.

    The closest spelling alone would suggest `heal` for `help`.
    """

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands in their panels, each with its whole first sentence."""
        panels: dict[str, list[tuple[str, str]]] = {name: [] for name in PANELS}
        for name in self.list_commands(ctx):
            command = self.get_command(ctx, name)
            if command is None:
                continue
            panel = getattr(command, "rich_help_panel", None)
            shown = panel if isinstance(panel, str) else "Commands"
            panels.setdefault(shown, []).append((name, command.get_short_help_str(limit=10_000)))
        for panel, commands in panels.items():
            if commands:
                with formatter.section(panel):
                    formatter.write_dl(commands)

    # Some releases of typer contain their own click, so no type of click fits all of them.
    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the command that the first word names; a wrong word ends with the command that was meant."""
        word = args[0] if args else ""
        if self.get_command(ctx, word) is None:
            if word in ("help", "usage", "version"):
                ctx.fail(f"No such command '{word}'. Write `{ctx.command_path} --help`, or `… COMMAND --help`.")
            meant = _MEANT.get(word)
            if meant is not None and self.get_command(ctx, meant) is not None:
                ctx.fail(f"No such command '{word}'. Did you mean '{meant}'?")
        return super().resolve_command(ctx, args)
