"""The entry point of the command `hedgerow-agent`, before slow modules are loaded."""

from __future__ import annotations

from hedgerow.wire import first

first.quiet()

from typing import NoReturn  # noqa: E402 (a Ctrl-C while it loads must find the handler of `first`)

from hedgerow.wire import start  # noqa: E402


def main() -> NoReturn:
    """Run the command `hedgerow-agent`; Ctrl-C during loading ends it without a traceback."""
    start.begin()
    with start.whole("hedgerow-agent"):
        from hedgerow.agents.standalone import main as run  # noqa: PLC0415

        run()
