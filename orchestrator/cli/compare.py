"""The command that compares laws."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hedgerow.orchestrator.cli.names import EXPERIMENT
from hedgerow.orchestrator.cli.numbers import whole
from hedgerow.orchestrator.cli.options import File, NoProgress, Sets
from hedgerow.topologies.errors import check_options
from hedgerow.topologies.escape import echo
from hedgerow.topologies.paths import user_path

Laws = Annotated[
    list[str] | None, typer.Option("--law", metavar="LAW", help="a law, once or more; `all` for those of the project")
]
Disturbances = Annotated[
    str,
    typer.Option(
        metavar="NAME,...",
        help="file, sinusoid, white, ar1, constant, confuse or none, or {kind: ...} as in a file; + adds some",
    ),
]
Seeds = Annotated[str, typer.Option(metavar="FIRST:STOP", help="every seed from FIRST up to, and without, STOP")]
Steps = Annotated[int | None, whole("replace `steps:`")]
Out = Annotated[
    Path | None,
    typer.Option(parser=user_path, metavar="DIR", help="the folder, new or of this comparison [comparisons/NAME-HASH]"),
]
Jobs = Annotated[int | None, whole("processes that run at once [the cores]")]


def register(app: typer.Typer) -> None:
    """Add this command to the operator's."""
    app.command(rich_help_panel=EXPERIMENT)(compare)


def compare(
    file: File,
    law: Laws = None,
    disturbances: Disturbances = "file",
    seeds: Seeds = "0:50",
    steps: Steps = None,
    sets: Sets = None,
    out: Out = None,
    jobs: Jobs = None,
    quiet: NoProgress = False,
) -> int:
    """Compare laws under the same seeds: one table, one figure, and the law that wins under each disturbance."""
    from hedgerow.orchestrator.experiments.compare import compare as run  # noqa: PLC0415
    from hedgerow.orchestrator.experiments.compare.plan import comparison, disturbances_of  # noqa: PLC0415
    from hedgerow.orchestrator.experiments.sweep.plan import seeds_of  # noqa: PLC0415

    check_options(jobs=jobs)
    settings = [*(sets or []), *([] if steps is None else [f"steps={steps}"])]
    plan = comparison(Path(file), law or ["minimax"], disturbances_of(disturbances), seeds_of(seeds), settings)
    found = run(plan, out, jobs, quiet)
    if found is None:
        return 3
    echo(str(found))
    echo(f"{found.folder}: runs.csv, means.csv, tests.csv, compare.md, compare.pdf and compare.png")
    for line in found.not_valid:
        echo(line)
    return found.exit_code
