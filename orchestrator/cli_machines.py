"""Commands for networks on many machines: bundle, compose."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from topologies.errors import UserError

File = Annotated[str, typer.Argument(metavar="FILE", help="a topology file, a bundled name, or the folder of a run")]
Sets = Annotated[list[str] | None, typer.Option("--set", metavar="PATH=VALUE", help="replace a value of the file")]
Steps = Annotated[int | None, typer.Option(help="replace `steps:`")]
Seed = Annotated[int | None, typer.Option(help="replace `seed:`")]
Law = Annotated[str | None, typer.Option(help="replace `law:`")]
Processes = Annotated[int | None, typer.Option(metavar="P", help="agent processes [one a node]")]
Namespace = Annotated[str | None, typer.Option(metavar="KEY", help="where all meet [hedgerow/NAME]")]


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command()(bundle)
    app.command()(compose)


def bundle(
    file: File,
    out: Annotated[Path, typer.Option(metavar="DIR", help="the folder to write, new or empty")],
    router: Annotated[
        str, typer.Option(metavar="ENDPOINT", help="where the agents find the run, as seen from their machines")
    ] = "tcp/localhost:7447",
    namespace: Namespace = None,
    processes: Processes = None,
    steps: Steps = None,
    seed: Seed = None,
    law: Law = None,
    sets: Sets = None,
) -> int:
    """Write what each process is told, a file each, to carry to other machines, and how to start them there."""
    from orchestrator.assign import layout  # noqa: PLC0415
    from orchestrator.bundle import write  # noqa: PLC0415
    from orchestrator.cli import read  # noqa: PLC0415
    from orchestrator.external import configs, namespace_of  # noqa: PLC0415

    topology = read(file, sets, steps=steps, seed=seed, law=law, processes=processes)
    shards = layout(topology, topology.process_count)
    told = configs(topology, shards, router, namespace or namespace_of(topology))
    try:
        out.mkdir(parents=True, exist_ok=True)
        if any(out.iterdir()):
            raise UserError(f"--out {out}: holds something already; name a new folder")
        write(out, topology, told)
    except OSError as error:
        raise UserError(f"--out {out}: {error.strerror}; choose another folder") from None
    print(f"{out}: {len(told)} processes; {out / 'README.md'} says how to start them")
    return 0


class Format(StrEnum):
    """What runs the containers."""

    COMPOSE = "compose"
    KUBERNETES = "kubernetes"


def compose(
    file: File,
    form: Annotated[Format, typer.Option("--format", help="for Docker, or for Kubernetes")] = Format.COMPOSE,
    rate: Annotated[float, typer.Option(metavar="R", help="steps per second, 0 for as fast as possible")] = 10.0,
    namespace: Namespace = None,
    processes: Processes = None,
    steps: Steps = None,
    seed: Seed = None,
    law: Law = None,
    sets: Sets = None,
) -> int:
    """Print a Compose file, or Kubernetes manifests, that run a network in containers."""
    from orchestrator import compose as made  # noqa: PLC0415
    from orchestrator.assign import layout  # noqa: PLC0415
    from orchestrator.cli import read  # noqa: PLC0415
    from orchestrator.external import namespace_of  # noqa: PLC0415

    if rate < 0:
        raise UserError("--rate must not be negative")
    topology = read(file, sets, steps=steps, seed=seed, law=law, processes=processes)
    shards = layout(topology, topology.process_count)
    docker = form is Format.COMPOSE
    most = made.MOST_BYTES if docker else made.MOST_MAP_BYTES
    one = made.containers(topology, shards, namespace or namespace_of(topology), rate, most)
    print(made.compose(one) if docker else made.kubernetes(one), end="")
    return 0
