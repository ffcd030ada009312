"""The command `orchestrator`."""

from __future__ import annotations

import contextlib
import os
import sys
import time

import hedgerow
from hedgerow.topologies.escape import echo
from hedgerow.wire import start

BEGAN = time.monotonic()


def main() -> None:
    """Run the command line; for `up`, start the fork server first, so that both load at the same time."""
    start.begin()
    _settle_environment()
    launches = "up" in sys.argv[1:2] and not {"--help", "--detach"} & set(sys.argv)
    try:
        from hedgerow.orchestrator.launch.fork_client import ForkClient  # noqa: PLC0415

        fork_client = ForkClient() if launches else None
        from hedgerow.orchestrator.cli.main import run_command  # noqa: PLC0415

        run_command(BEGAN, fork_client)
    except KeyboardInterrupt:  # no run has begun that must end properly
        os._exit(start.INTERRUPTED)
    except BaseException as error:
        if isinstance(error, ModuleNotFoundError) and (error.name or "").partition(".")[0] in hedgerow.NEEDED:
            echo(f"error: {hedgerow.missing('this command', error.name)}", error=True)
            os._exit(2)
        os._exit(_failed(error))


def _settle_environment() -> None:
    """Set the environment variables that our libraries read; child processes inherit them."""
    # Threads of linear algebra would compete with the network for its cores, and the order of a sum would vary.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # A notebook sets a backend that exists only in its interpreter; we draw to files.
    os.environ["MPLBACKEND"] = "Agg"
    for name in ("COLUMNS", "LINES"):
        if not _is_size(os.environ.get(name, "1")):
            del os.environ[name]  # a terminal of size zero: let libraries ask the terminal


def _is_size(text: str) -> bool:
    return text.isascii() and text.isdecimal() and len(text) < 6 and int(text) > 0


def _failed(error: BaseException) -> int:
    """Print one line about an error before the command line existed; return the exit code."""
    from hedgerow.topologies.errors import Exit  # noqa: PLC0415
    from hedgerow.wire import crash  # noqa: PLC0415
    from hedgerow.wire.limits import limit_reached  # noqa: PLC0415

    reached = limit_reached(error)
    with contextlib.suppress(OSError):
        echo(f"error: {reached or crash.report(error)}", error=True)
    return Exit.CRASH if reached is None else Exit.UNKNOWN


if __name__ == "__main__":
    main()
