"""The commands for networks on many machines: bundle, compose."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hedgerow.orchestrator.cli.names import DEPLOY
from hedgerow.orchestrator.cli.numbers import choice, real
from hedgerow.orchestrator.cli.options import File, Law, Processes, Seed, Sets, Steps
from hedgerow.topologies.errors import Code, UserError, check_options
from hedgerow.topologies.escape import echo
from hedgerow.topologies.paths import user_path, why_no_folder

Secure = Annotated[
    bool | None, typer.Option("--secure/--open", help="keys for every process, and a router that refuses the rest")
]
Days = Annotated[float | None, real("days that the keys hold [7]", metavar="N", low=0.01, high=366)]
Namespace = Annotated[str | None, typer.Option(metavar="KEY", help="where all meet [hedgerow/NAME]")]


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command(rich_help_panel=DEPLOY)(bundle)
    app.command(rich_help_panel=DEPLOY)(compose)


def bundle(
    file: File,
    out: Annotated[Path, typer.Option(parser=user_path, metavar="DIR", help="the folder to write, new or empty")],
    router: Annotated[
        str | None,
        typer.Option(
            metavar="ENDPOINT", help="where the agents find the run, as seen from their machines [tcp/localhost:7447]"
        ),
    ] = None,
    secure: Secure = None,
    days: Days = None,
    namespace: Namespace = None,
    processes: Processes = None,
    steps: Steps = None,
    seed: Seed = None,
    law: Law = None,
    sets: Sets = None,
) -> int:
    """Write one config file for each process, for other machines, with the commands that start them there."""
    from hedgerow.orchestrator.cli.topology import read  # noqa: PLC0415
    from hedgerow.orchestrator.deploy.bundle import write, write_secure  # noqa: PLC0415
    from hedgerow.orchestrator.ground.assignment import layout, places, views_of  # noqa: PLC0415
    from hedgerow.orchestrator.launch.certificates import LIFE_DAYS  # noqa: PLC0415
    from hedgerow.orchestrator.launch.endpoints import namespace_of  # noqa: PLC0415
    from hedgerow.orchestrator.launch.external_agents import configs  # noqa: PLC0415
    from hedgerow.orchestrator.runs.folder import whole_folder  # noqa: PLC0415
    from hedgerow.wire.session import check_endpoint, check_namespace  # noqa: PLC0415

    topology = read(file, sets, steps=steps, seed=seed, law=law, processes=processes, secure=secure)
    shards = layout(topology, topology.process_count)
    _refuse_days(topology.secure, days)
    router = router or f"{'tls' if topology.secure else 'tcp'}/localhost:7447"
    check_endpoint(router)
    meet = namespace_of(topology.name) if namespace is None else namespace
    check_namespace(meet)
    parts = configs(topology, shards, router, meet)
    try:
        if topology.secure:
            write_secure(out, topology, parts, places(views_of(topology, shards)), days or LIFE_DAYS)
        else:
            with whole_folder(out, f"--out {out}") as part:
                write(part, topology, parts)
    except OSError as error:
        raise UserError(f"--out {out}: {why_no_folder(error)}; choose another folder", code=Code.OUTPUT) from None
    echo(f"{out}: {len(parts)} processes; {out / 'README.md'} explains the start")
    return 0


def _refuse_days(secure: bool, days: float | None) -> None:
    if days is not None and not secure:
        raise UserError(f"--days {days:g}: is how long keys hold, of a secure network; give --secure too")


COMPOSE, KUBERNETES = "compose", "kubernetes"
Format = Annotated[
    str, choice("for Docker, or for Kubernetes", "--format", metavar="compose|kubernetes", words=[COMPOSE, KUBERNETES])
]


def compose(
    file: File,
    form: Format = COMPOSE,
    rate: Annotated[float, real("steps per second, 0 for as fast as possible")] = 10.0,
    out: Annotated[
        Path | None, typer.Option(parser=user_path, metavar="FILE", help="write it there, for you alone to read")
    ] = None,
    secure: Secure = None,
    keys: Annotated[
        Path | None,
        typer.Option(
            parser=user_path, metavar="DIR", help="its folder of keys, made if it does not exist [keys, beside FILE]"
        ),
    ] = None,
    days: Days = None,
    registry: Annotated[
        str, typer.Option(metavar="PREFIX", help="where the images are pushed, e.g. registry.example/team")
    ] = "",
    namespace: Namespace = None,
    processes: Processes = None,
    steps: Steps = None,
    seed: Seed = None,
    law: Law = None,
    sets: Sets = None,
) -> int:
    """Print a Compose file, or Kubernetes manifests, that run a network in containers."""
    from hedgerow.orchestrator.cli.topology import read  # noqa: PLC0415
    from hedgerow.orchestrator.deploy.compose import MOST_BYTES, to_compose  # noqa: PLC0415
    from hedgerow.orchestrator.deploy.containers import containers, provide_keys  # noqa: PLC0415
    from hedgerow.orchestrator.deploy.kubernetes import MOST_MAP_BYTES, to_kubernetes  # noqa: PLC0415
    from hedgerow.orchestrator.ground.assignment import layout, places, views_of  # noqa: PLC0415
    from hedgerow.orchestrator.launch.certificates import write_private  # noqa: PLC0415
    from hedgerow.orchestrator.launch.endpoints import namespace_of  # noqa: PLC0415
    from hedgerow.wire.session import check_namespace  # noqa: PLC0415

    check_options(rate=rate)
    topology = read(file, sets, steps=steps, seed=seed, law=law, processes=processes, secure=secure)
    shards = layout(topology, topology.process_count)
    meet, docker, folder = namespace_of(topology.name) if namespace is None else namespace, form == COMPOSE, None
    check_namespace(meet)
    beside = out.parent if out else Path()
    _refuse_days(topology.secure, days)
    if topology.secure:
        if out is None and not docker:
            raise UserError("--secure: the manifests hold all keys; --out FILE writes a file that only you can read")
        folder = keys or beside / "keys"
        provide_keys(folder, places(views_of(topology, shards)), meet, days)
    elif keys is not None:
        raise UserError(f"--keys {keys}: is for a secure network; give --secure too")
    most = MOST_BYTES if docker else MOST_MAP_BYTES
    one = containers(topology, shards, meet, rate, most, folder, registry)
    text = to_compose(one, beside) if docker else to_kubernetes(one)
    if docker and one.law.files:
        try:
            one.law.write(beside / one.law_folder)
        except OSError as error:
            raise UserError(
                f"{beside / one.law_folder}: {error.strerror}. Choose another --out.", code=Code.OUTPUT
            ) from None
    if out is None:
        echo(text, end="")
        return 0
    try:
        write_private(out, text.encode())
    except OSError as error:
        raise UserError(f"--out {out}: {error.strerror}; choose another name", code=Code.OUTPUT) from None
    return 0
