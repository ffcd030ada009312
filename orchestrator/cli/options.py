"""The options that several commands share, with one name and one explanation."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hedgerow.orchestrator.cli import complete
from hedgerow.orchestrator.cli.numbers import whole
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.escape import answers_alone
from hedgerow.topologies.paths import user_path

File = Annotated[
    str,
    typer.Argument(
        metavar="FILE", help="a topology file, a bundled name, or a run folder", autocompletion=complete.networks
    ),
]
Running = Annotated[
    str | None,
    typer.Argument(
        metavar="RUN",
        help="name of a running network [the only one, or that of this folder]",
        autocompletion=complete.running,
    ),
]
RunOption = Annotated[
    str | None,
    typer.Option(
        "--run",
        metavar="RUN",
        help="a running network's name [the only one, or that of this folder]",
        autocompletion=complete.running,
    ),
]
Sets = Annotated[list[str] | None, typer.Option("--set", metavar="PATH=VALUE", help="replace a value of the file")]
Steps = Annotated[int | None, whole("replace `steps:`")]
Seed = Annotated[int | None, whole("replace `seed:`")]
Law = Annotated[str | None, typer.Option(help="replace `law:`")]
KeptLaw = Annotated[
    bool, typer.Option("--kept-law", help="FILE is the folder of a run: load the law from its copy there")
]
RunDir = Annotated[
    Path | None, typer.Option(parser=user_path, metavar="DIR", help="the run's folder, new or empty [runs/NAME-TIME]")
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="print the verdict and nothing else")]
NoProgress = Annotated[bool, typer.Option("--quiet", "-q", help="print no progress")]


def _alone(context: typer.Context, as_json: bool) -> bool:
    if as_json:
        context.with_resource(answers_alone())
    return as_json


AsJson = Annotated[bool, typer.Option("--json", help="one JSON object on standard output", callback=_alone)]
Processes = Annotated[int | None, whole("agent processes [one a node]", metavar="P")]


def chosen(run: str | None, option: str | None) -> str | None:
    """Return the name of a running network, given as an argument or with --run; raise UserError for two names."""
    if run is not None and option is not None and run != option:
        raise UserError(f"--run {option}: contradicts {run}. Name one network.", code=Code.OPTION)
    return option if run is None else run
