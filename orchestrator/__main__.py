"""`orchestrator`, the command."""

from __future__ import annotations

import os
import sys
import time

from hedgerow.orchestrator.launch.fork_client import Nursery

BEGAN = time.monotonic()
MORE_THAN_AN_AGENT_NEEDS = {"typer", "pydantic", "yaml", "rich", "rerun", "pyarrow", "scipy", "psutil"}
"""Modules of the extra `orchestrator` (pyproject.toml)."""


def main() -> None:
    """Run the command line; when it is `up`, the nursery loads beside us from the very beginning."""
    _open_standard_streams()
    # Threads of linear algebra would take from the network the cores that they share; and one is always the same sum.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    launches = "up" in sys.argv[1:2] and not {"--help", "--detach"} & set(sys.argv)
    try:
        nursery = Nursery() if launches else None
        from hedgerow.orchestrator.cli.main import run_command  # noqa: PLC0415

        run_command(BEGAN, nursery)
    except ModuleNotFoundError as error:
        if error.name not in MORE_THAN_AN_AGENT_NEEDS:
            raise
        print(f"error: there is no {error.name} here: pip install 'hedgerow[orchestrator]'", file=sys.stderr)
        os._exit(2)
    except KeyboardInterrupt:  # before there was a run to end
        os._exit(130)


def _open_standard_streams() -> None:
    """Those that are closed lead nowhere: a pipe of ours would get the number of one, and be taken for it."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            # It gets the lowest number that is free, which is that one.
            file = open(os.devnull, "w" if number else "r", encoding="utf-8")  # noqa: SIM115
            os.set_inheritable(file.fileno(), True)
            setattr(sys, name, file)


if __name__ == "__main__":
    main()
