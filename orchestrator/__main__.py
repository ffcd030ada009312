"""`orchestrator`, the command."""

from __future__ import annotations

import time

BEGAN = time.monotonic()


def main() -> None:
    """Run the command line; `BEGAN` is from before anything was loaded."""
    from orchestrator.cli import run_command  # noqa: PLC0415

    run_command(BEGAN)


if __name__ == "__main__":
    main()
