"""`orchestrator`, the command."""

from __future__ import annotations

import os
import sys
import time

from orchestrator.nursery import Nursery

BEGAN = time.monotonic()


def main() -> None:
    """Run the command line; when it is `up`, the nursery loads beside us from the very beginning."""
    launches = "up" in sys.argv[1:2] and not {"--help", "--detach"} & set(sys.argv)
    try:
        nursery = Nursery() if launches else None
        from orchestrator.cli import run_command  # noqa: PLC0415

        run_command(BEGAN, nursery)
    except KeyboardInterrupt:  # before there was a run to end
        os._exit(130)


if __name__ == "__main__":
    main()
