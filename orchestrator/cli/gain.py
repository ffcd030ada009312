"""The commands that bound the gain of the adaptive law from above and from below."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Annotated

import typer

from hedgerow.orchestrator.cli.names import EXPERIMENT
from hedgerow.orchestrator.cli.numbers import whole
from hedgerow.orchestrator.cli.options import AsJson, File, Law, NoProgress, Sets
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.escape import command, echo
from hedgerow.topologies.paths import user_path

Full = Annotated[bool, typer.Option("--full", help="a full storage matrix P, for networks of up to 30 nodes")]
Split = Annotated[bool, typer.Option("--split", help="one small matrix per node at any size, which may take minutes")]
Budget = Annotated[
    str,
    typer.Option(
        metavar="TIME", help="how long to search, as 90, 60s or 5m; the runs that repeat the gain come after it"
    ),
]
Faults = Annotated[bool, typer.Option("--faults", help="search cuts and drops too")]
SearchSeed = Annotated[int, whole("seed of the search", "--seed", low=0)]
Length = Annotated[
    int | None,
    whole(
        "steps of the run of a disturbance that holds its last value [10000; 4000 of more than 100 nodes]",
        "--steps",
        low=100,
        high=10**6,
    ),
]
Out = Annotated[Path, typer.Option(parser=user_path, metavar="FILE", help="the network that repeats the gain")]


def register(app: typer.Typer) -> None:
    """Add these commands to the operator's."""
    app.command(rich_help_panel=EXPERIMENT)(bound)
    app.command(rich_help_panel=EXPERIMENT)(worst)


def bound(file: File, full: Full = False, split: Split = False, sets: Sets = None, as_json: AsJson = False) -> int:
    """Compute upper bounds on the gain of the adaptive law that hold under faults, each with a certificate."""
    from hedgerow.orchestrator.cli.topology import read  # noqa: PLC0415
    from hedgerow.orchestrator.experiments.bounds import bound as bounds_of  # noqa: PLC0415
    from hedgerow.orchestrator.metrics.gain_bound import Method  # noqa: PLC0415

    if full and split:
        raise UserError("--split: contradicts --full. Choose one of them.", code=Code.OPTION)
    method = Method.FULL if full else Method.SPLIT if split else None
    found = bounds_of(read(file, sets), method)
    echo(json.dumps(found.to_dict()) if as_json else found.text())
    return 0


def worst(
    file: File,
    budget: Budget = "60s",
    law: Law = None,
    faults: Faults = False,
    seed: SearchSeed = 0,
    steps: Length = None,
    out: Out = Path("worst.yaml"),
    sets: Sets = None,
    quiet: NoProgress = False,
    as_json: AsJson = False,
) -> int:
    """Search for the disturbance with the largest gain; write a network that repeats it; run again to continue."""
    from hedgerow.orchestrator.cli.topology import read  # noqa: PLC0415
    from hedgerow.orchestrator.experiments.worst import worst as search  # noqa: PLC0415
    from hedgerow.orchestrator.ground.laws import checked  # noqa: PLC0415
    from hedgerow.orchestrator.ground.signals import Interrupts  # noqa: PLC0415
    from hedgerow.orchestrator.views.progress import Progress  # noqa: PLC0415

    seconds = seconds_of(budget)
    topology = checked(read(file, sets, law=law))
    is_stopped = False
    with Interrupts() as interrupts, Progress(f"worst {topology.name}", seconds, quiet=quiet or as_json) as progress:

        def quit_now() -> bool:
            nonlocal is_stopped
            progress.update()
            if interrupts.count and not is_stopped:
                is_stopped = True
                progress.say(f"stopped: {interrupts.name}; repeating the best attack found so far")
            return is_stopped

        found = search(topology, seconds, faults, seed, steps, out, progress.say, quit_now)
    # A comment of the shell, so that the line can be copied. The run of the file may be shorter than the claim needs.
    again = f"again with: {command(['orchestrator', 'up', out])}  # gain {found.gain:.4g}"
    echo(json.dumps(found.to_dict()) if as_json else f"{found.text()}\n{again}")
    return 0


def seconds_of(text: str) -> float:
    """Return a time in seconds; raises UserError."""
    match = re.fullmatch(r"(\d+(?:\.\d+)?)\s*(s|m|h|)", text.strip())
    seconds = float(match[1]) * {"": 1, "s": 1, "m": 60, "h": 3600}[match[2]] if match else 0.0
    if not 0 < seconds <= 7 * 86400:
        raise UserError(f"--budget {text}: is no time. Write 90, 60s or 5m.")
    return seconds
