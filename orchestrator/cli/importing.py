"""The command that makes a topology from a file of another tool."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hedgerow.orchestrator.cli.names import INSPECT
from hedgerow.orchestrator.cli.numbers import real, whole
from hedgerow.orchestrator.cli.options import Seed
from hedgerow.topologies.escape import command, echo
from hedgerow.topologies.paths import user_path

_FILE = typer.Argument(parser=user_path, metavar="FILE", help="GraphML, GML, CSV, MATPOWER, EPANET, …")
_OUT = typer.Option("-o", "--out", parser=user_path, metavar="FILE", help="the topology file [NAME.yaml]")
_NUMBER = "NAME|NUMBER"


def register(app: typer.Typer) -> None:
    """Add this command to the operator's."""
    app.command(name="import", rich_help_panel=INSPECT)(import_)


def import_(
    file: Annotated[Path, _FILE],
    out: Annotated[Path | None, _OUT] = None,
    weight: Annotated[
        str | None, typer.Option(metavar=_NUMBER, help="an attribute of edges, or one weight for all [weight, else 1]")
    ] = None,
    storage: Annotated[
        str | None, typer.Option(metavar=_NUMBER, help="an attribute of nodes, or one storage for all; b_i = b/sqrt(c)")
    ] = None,
    junction_storage: Annotated[float | None, real("of nodes without one; of junctions [100 m^2]", metavar="C")] = None,
    largest_component: Annotated[
        bool, typer.Option("--largest-component", help="keep the largest connected piece alone")
    ] = False,
    directed: Annotated[
        bool, typer.Option("--directed", help="i,j and j,i of a list are one edge, not two parallel ones")
    ] = False,
    max_degree: Annotated[
        int | None, whole("keep at most D edges per node, those of the largest weights", metavar="D")
    ] = None,
    time_step: Annotated[
        float | None, real("seconds per step of an EPANET network [half of what (3) allows]", metavar="S")
    ] = None,
    leak: Annotated[float | None, real("loss per hour: a = exp(-R dt) [a is drawn]")] = None,
    reservoir_storage: Annotated[
        float | None, real("keep reservoirs, with C m^2 [they are dropped]", metavar="C")
    ] = None,
    b: Annotated[float | None, real("the gain [half of what (3) allows]", "--b", metavar="B")] = None,
    steps: Annotated[int | None, whole("steps of the run [300]")] = None,
    seed: Seed = None,
    name: Annotated[str | None, typer.Option(help="the name of the run [that of the file]")] = None,
    force: Annotated[bool, typer.Option("--force", help="replace existing files")] = False,
) -> int:
    """Make a topology from a file of another tool; report the contents, the assumptions and the changes."""
    # Loading the topology modules takes most of a second.
    from hedgerow.topologies.importing.options import Options  # noqa: PLC0415
    from hedgerow.topologies.importing.written import import_file  # noqa: PLC0415

    options = Options(
        name=name,
        weight=weight,
        storage=storage,
        junction_storage=junction_storage,
        largest_component=largest_component,
        directed=directed,
        max_degree=max_degree,
        b=b,
        steps=steps,
        seed=1 if seed is None else seed,
        time_step=time_step,
        leak=leak,
        reservoirs=reservoir_storage,
    )
    network = import_file(file, options)
    target = out or Path(f"{network.content['name']}.yaml")
    if not network.arrays:
        network.topology(target)  # check before anything is written
    written = network.save(target, force)
    if network.arrays:
        network.topology(target)
    nodes, edges = network.size
    echo(f"{file}: {nodes:,} nodes, {edges:,} edges; wrote {', '.join(map(str, written))}")
    for title, sentences in (
        ("from the source", network.facts),
        ("assumed", network.assumptions),
        ("changed", network.changes),
    ):
        for sentence in sentences:
            echo(f"{title}: {sentence}")
    echo(f"next: {command(['orchestrator', 'check', target])}")
    return 0
