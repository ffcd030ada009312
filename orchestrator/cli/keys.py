"""The commands for the access rules: the matrix of permitted messages, and the keys for a separate router."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hedgerow.orchestrator.cli.names import DEPLOY, INSPECT
from hedgerow.orchestrator.cli.numbers import real
from hedgerow.orchestrator.cli.options import AsJson, File, Processes
from hedgerow.topologies.escape import command, echo
from hedgerow.topologies.paths import user_path

if TYPE_CHECKING:
    from hedgerow.wire.access import Place

MATRIX_MOST = 16
"""the maximum number of processes for a matrix; larger networks get one line each"""


def register(app: typer.Typer) -> None:
    """Add these commands to the operator's."""
    app.command(rich_help_panel=DEPLOY)(keys)
    app.command(rich_help_panel=INSPECT)(audit)


def _places(file: str, processes: int | None) -> tuple[str, list[Place]]:
    from hedgerow.orchestrator.cli.topology import read  # noqa: PLC0415
    from hedgerow.orchestrator.ground.assignment import layout, places, views_of  # noqa: PLC0415

    topology = read(file, None, processes=processes)
    return topology.name, places(views_of(topology, layout(topology, topology.process_count)))


def keys(
    file: File,
    out: Annotated[Path, typer.Option(parser=user_path, metavar="DIR", help="a new folder")],
    router: Annotated[
        str, typer.Option(metavar="ENDPOINT", help="where the router will be: tls/HOST:PORT")
    ] = "tls/localhost:7447",
    processes: Processes = None,
    days: Annotated[float, real("days that the certificates hold", metavar="N", low=0.01, high=366)] = 7,
) -> int:
    """Make the keys of a secure network with a separate router: a folder for each process, and the router's."""
    from hedgerow.orchestrator.launch.certificates import CONFIGURATION, to_carry  # noqa: PLC0415
    from hedgerow.orchestrator.launch.endpoints import namespace_of  # noqa: PLC0415
    from hedgerow.wire.session import check_endpoint  # noqa: PLC0415

    check_endpoint(router)
    name, places = _places(file, processes)
    made = to_carry(out, places, namespace_of(name), router, days)
    echo(f"{out}: keys for {', '.join(made)}; they hold for {days:g} days")
    again = ["orchestrator", "up", file, "--secure", "--keys", str(out)]
    again += [] if processes is None else ["--processes", str(processes)]
    echo(f"router: zenohd -c {CONFIGURATION}, in its folder; then: {command(again)}")
    return 0


def audit(
    file: File,
    processes: Processes = None,
    as_rights: Annotated[
        bool, typer.Option("--rights", help="all that the router of a secure run lets each process do")
    ] = False,
    as_json: AsJson = False,
) -> int:
    """Show the permitted messages: one row per process, with the messages that it receives from the process of each
    column.
    """
    from rich.console import Console  # noqa: PLC0415
    from rich.table import Table  # noqa: PLC0415

    from hedgerow.orchestrator.metrics.message_audit import channels  # noqa: PLC0415
    from hedgerow.wire.access import rights  # noqa: PLC0415
    from hedgerow.wire.keys import PLANT  # noqa: PLC0415

    _, places = _places(file, processes)
    found, granted = channels(places), rights(places)
    if as_json:
        listed = [{"key": one.key, "from": one.sender, "to": one.receiver} for one in found]
        echo(json.dumps({"channels": listed, "rights": {name: some._asdict() for name, some in granted.items()}}))
        return 0
    if as_rights:
        for name, some in granted.items():
            echo(f"{name}:")
            for right, allowed in some._asdict().items():
                if allowed:
                    echo(f"  {right} {', '.join(allowed)}")
        return 0
    names = [PLANT, *(place.name for place in places)]
    cells = {(one.receiver, one.sender): one.key for one in found}
    if len(names) <= MATRIX_MOST:
        table = Table("receives", *(f"of {name}" for name in names))
        for receiver in names:
            table.add_row(receiver, *(cells.get((receiver, sender), "") for sender in names))
    else:
        table = Table("process", "receives")
        for receiver in names:
            table.add_row(receiver, ", ".join(cells[pair] for pair in cells if pair[0] == receiver))
    # Never cut a key: a narrow terminal wraps the lines instead.
    wide = Console(width=10_000).measure(table).maximum
    Console(width=wide).print(table)
    return 0
