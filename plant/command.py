"""`plant`, the command, before it loads what is slow."""

from __future__ import annotations

from typing import NoReturn

from hedgerow.wire import start


def main() -> NoReturn:
    """Run the command `plant`; a Ctrl-C while it loads ends it without a traceback."""
    start.begin()
    from hedgerow.plant.standalone import main as run  # noqa: PLC0415

    run()
