"""The command line of the operator."""

from __future__ import annotations

import contextlib
import copy
import functools
import json
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TextIO

import typer

from hedgerow.orchestrator.cli import compare as cli_compare
from hedgerow.orchestrator.cli import detached
from hedgerow.orchestrator.cli import files as cli_files
from hedgerow.orchestrator.cli import gain as cli_gain
from hedgerow.orchestrator.cli import importing as cli_importing
from hedgerow.orchestrator.cli import keys as cli_keys
from hedgerow.orchestrator.cli import laws as cli_laws
from hedgerow.orchestrator.cli import live as cli_live
from hedgerow.orchestrator.cli import machines as cli_machines
from hedgerow.orchestrator.cli import report as cli_report
from hedgerow.orchestrator.cli import runs as cli_runs
from hedgerow.orchestrator.cli import soak as cli_soak
from hedgerow.orchestrator.cli import sweep as cli_sweep
from hedgerow.orchestrator.cli import watch as cli_watch
from hedgerow.orchestrator.cli.exit_code import code_of_run, run_to_exit_code
from hedgerow.orchestrator.cli.names import EXPERIMENT, INSPECT, RUN, Commands
from hedgerow.orchestrator.cli.numbers import real, whole, whole_of
from hedgerow.orchestrator.cli.options import (
    AsJson,
    File,
    KeptLaw,
    Law,
    NoProgress,
    Quiet,
    RunDir,
    Seed,
    Sets,
    Steps,
)
from hedgerow.orchestrator.cli.topology import importable, read, undrawn
from hedgerow.orchestrator.launch.fork_client import ForkClient
from hedgerow.topologies.errors import Code, UserError, check_options
from hedgerow.topologies.escape import command, echo
from hedgerow.topologies.paths import user_path
from hedgerow.wire.child import escape_warnings
from hedgerow.wire.runtime import let_numbers_overflow
from hedgerow.wire.start import loading

# Loading the topology modules takes most of a second: each command imports what it needs.
if TYPE_CHECKING:
    from hedgerow.orchestrator.ground.assignment import Layout
    from hedgerow.orchestrator.launch.external_agents import External
    from hedgerow.orchestrator.metrics.verdict import Verdict
    from hedgerow.orchestrator.runs.folder import RunFolder
    from hedgerow.orchestrator.views.screen import Screen
    from hedgerow.topologies.schema import Topology

app = typer.Typer(
    name="orchestrator",
    cls=Commands,
    help="Run networks of independent controllers, each its own process, over Zenoh.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
_BEGAN = time.monotonic()
_FORK_CLIENT: ForkClient | None = None

Record = Annotated[
    bool, typer.Option("--record/--no-record", help="write run.rrd, from which a run opens faster than from its tables")
]
SplitRecording = Annotated[
    float,
    real("size of a file of the recording, 0 for one file", metavar="MB", low=0),
]
Plain = Annotated[bool, typer.Option("--plain", help="print lines instead of a live table")]
Viewer = Annotated[
    str, typer.Option(metavar="native|web|none|URL", help="viewer that follows the run [native, if there is a display]")
]


def _print_version(asked: bool) -> None:
    if asked:
        from hedgerow.wire.release import release  # noqa: PLC0415

        echo(f"hedgerow {release('hedgerow')}")
        raise typer.Exit


@app.callback()
def _whole(
    version: Annotated[
        bool, typer.Option("--version", help="print the version and exit", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    """Run networks of independent controllers, each its own process, over Zenoh."""


def run_command(began: float, fork_client: ForkClient | None) -> int:
    """Run the command line, and return its exit code. `began` is the start of the process by time.monotonic()."""
    global _BEGAN, _FORK_CLIENT
    _BEGAN, _FORK_CLIENT = began, fork_client
    let_numbers_overflow()
    escape_warnings()
    needed = _without_other_commands(app, *sys.argv[1:2])
    return run_to_exit_code(lambda: needed(standalone_mode=False) or 0)


def _without_other_commands(whole: typer.Typer, word: str = "") -> typer.Typer:
    """Return the command line with the command `word` alone; all of it if no command has this name.

    Typer takes longer to build all commands than `up` takes to load numpy.
    """
    named = [one for one in whole.registered_commands if one.callback and word == (one.name or one.callback.__name__)]
    part = copy.copy(whole)
    if named:
        part.registered_commands, part.registered_groups = named, []
    return part


@app.command(rich_help_panel=RUN)
def up(
    file: File,
    processes: Annotated[
        str | None, typer.Option(metavar="P", help="agent processes, or auto, or per-node [per-node up to 64 nodes]")
    ] = None,
    steps: Steps = None,
    seed: Seed = None,
    law: Law = None,
    kept_law: KeptLaw = False,
    rate: Annotated[float, real("steps per second, 0 for as fast as possible")] = 0.0,
    run_dir: RunDir = None,
    sets: Sets = None,
    viewer: Viewer = "auto",
    keep: Annotated[
        bool | None,
        typer.Option(
            "--keep/--no-keep", help="leave the page of --viewer web open until Ctrl-C [if a terminal can send it]"
        ),
    ] = None,
    record: Record = True,
    split_recording: SplitRecording = 256.0,
    router: Annotated[
        str | None, typer.Option(metavar="ENDPOINT", help="an existing Zenoh router, such as tcp/host:7447")
    ] = None,
    secure: Annotated[
        bool | None, typer.Option("--secure/--open", help="give every process a certificate, and refuse all others")
    ] = None,
    keys: Annotated[
        Path | None,
        typer.Option(parser=user_path, metavar="DIR", help="keys from `orchestrator keys`, for an existing router"),
    ] = None,
    external: Annotated[
        str | None, typer.Option(metavar="NAMES", help="processes that start elsewhere: nodes, `all`, `plant`")
    ] = None,
    listen: Annotated[
        str | None,
        typer.Option(metavar="ENDPOINT", help="port to open for them, such as tcp/0.0.0.0:7447"),
    ] = None,
    namespace: Annotated[str | None, typer.Option(metavar="KEY", help="prefix of all keys [hedgerow/NAME]")] = None,
    wait: Annotated[
        float | None,
        real("seconds to wait for them [600, on Ray 120]", metavar="S"),
    ] = None,
    on: Annotated[str | None, typer.Option(metavar="ray|ray://HOST:PORT", help="cluster that runs the agents")] = None,
    deadline: Annotated[float, real("seconds to wait for an agent at a step", metavar="S")] = 10.0,
    verify: Annotated[bool, typer.Option("--verify", help="repeat the run here, and compare all bits")] = False,
    detach: Annotated[bool, typer.Option("--detach", help="return after the first step; the network runs on")] = False,
    lifeline: Annotated[bool, typer.Option("--lifeline", help="end the run when standard input ends")] = False,
    plain: Plain = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> int:
    """Run a network over Zenoh, with one process per agent and one for the plant."""
    if lifeline and detach:
        raise UserError("--lifeline --detach: choose one; a network in the background has no standard input")
    if lifeline:
        threading.Thread(target=detached.end_with_standard_input, name="lifeline", daemon=True).start()
    with loading():
        from hedgerow.orchestrator.ground.assignment import layout, places, views_of  # noqa: PLC0415
        from hedgerow.orchestrator.launch.endpoints import check as check_security  # noqa: PLC0415
        from hedgerow.orchestrator.launch.endpoints import meeting_place  # noqa: PLC0415
        from hedgerow.orchestrator.launch.options import Options  # noqa: PLC0415
        from hedgerow.orchestrator.launch.up import Network  # noqa: PLC0415
        from hedgerow.orchestrator.launch.watching import Watching  # noqa: PLC0415
        from hedgerow.orchestrator.runs import folder as folders  # noqa: PLC0415
        from hedgerow.orchestrator.views.screen import screen  # noqa: PLC0415

    check_options(rate=rate, deadline=deadline, wait=wait)
    count_of: object = whole_of(processes) if processes and processes[-1:].isdigit() else processes
    drawn = read(file, sets, steps=steps, seed=seed, law=law, processes=count_of, secure=secure)
    topology = importable(drawn, file, kept_law)
    shards = layout(topology, topology.process_count)
    where = places(views_of(topology, shards))
    check_security(topology.secure, router, keys, where, external is not None, listen, namespace)
    if keys is not None and (on is not None or external is not None):
        router, namespace = meeting_place(keys, where, router, listen, namespace)
    if on is not None:
        _check_cluster(on, external)
    elsewhere = None if on is not None else _elsewhere(external, topology, shards, router, listen, namespace, wait)
    wanted, viewer = viewer, _viewer(viewer, keep)
    hidden = wanted == "auto" and viewer == "none"
    if detach:
        return detached.start_detached()
    stack = contextlib.ExitStack()
    on_ray = None
    if on is not None:
        from hedgerow.orchestrator.launch.ray_agents import chosen as chosen_on_ray  # noqa: PLC0415

        on_ray = stack.enter_context(chosen_on_ray(on, topology, shards, router, listen, namespace, wait))
        elsewhere = on_ray.external
    folder = folders.create(topology, run_dir)
    shown = screen(topology, as_json, plain, quiet, watched=viewer != "none")
    display = stack.enter_context(contextlib.closing(shown))
    _introduce(topology, len(shards), folder, display, hidden)
    watching = Watching(record, viewer, split_recording, _keeps(keep, display))
    options = Options(rate, deadline, router, keys, elsewhere, on_ray, watching, verify)

    def on_first_step(after_s: float) -> None:
        display.say(f"running: first step after {after_s:.2f} s")
        if detached.is_detached():
            display.say(f"running in the background; `{command(['orchestrator', 'stop', folder.name])}` ends it")
            detached.release_terminal(folder.logs / "up.log")

    with stack:
        fork_client = stack.enter_context(contextlib.closing(_FORK_CLIENT or ForkClient()))

        def begin() -> Verdict:
            network = Network(topology, folder, shards, options, display, fork_client, _BEGAN)
            return network.run(on_first_step, stack)

        return code_of_run(folders.begun_or_withdrawn(folder, begin), display)


def _keeps(keep: bool | None, display: Screen) -> bool:
    """Return True if a page stays after the run: as requested, or by default if a terminal can send Ctrl-C."""
    return keep if keep is not None else display.interactive or _is_terminal(sys.stdin)


def _is_terminal(stream: TextIO | None) -> bool:
    try:
        return stream is not None and stream.isatty()
    except ValueError:  # it is closed
        return False


def _elsewhere(
    external: str | None,
    topology: Topology,
    shards: Layout,
    router: str | None,
    listen: str | None,
    namespace: str | None,
    wait: float | None,
) -> External | None:
    """Return the processes that start elsewhere, None if `up` starts all of them. Raises UserError."""
    if external is None:
        if listen or namespace:
            raise UserError(
                "--listen and --namespace: are for processes that start elsewhere. Name them with --external.",
                code=Code.OPTION,
            )
        return None
    from hedgerow.orchestrator.launch.endpoints import namespace_of  # noqa: PLC0415
    from hedgerow.orchestrator.launch.external_agents import chosen  # noqa: PLC0415

    meet = namespace or namespace_of(topology.name)
    return chosen(external, topology, shards, router, listen, meet, wait or 600.0)


def _check_cluster(on: str, external: str | None) -> None:
    """Raise UserError if `external` is given too, or if `on` names no cluster."""
    from hedgerow.orchestrator.launch.ray_cluster import check  # noqa: PLC0415

    if external is not None:
        raise UserError("--external --on: choose one; on a cluster, Ray starts all agents")
    check(on)


def _introduce(topology: Topology, processes: int, folder: RunFolder, display: Screen, hidden: bool = False) -> None:
    """Print the size of the network, the run folder, and the rows that are recorded.

    `hidden` is True if a viewer was wanted and there is no display.
    """
    from hedgerow.orchestrator.runs.selection import notes  # noqa: PLC0415
    from hedgerow.topologies.describe import count  # noqa: PLC0415 (pydantic takes a while to load)

    what = f"{count(len(topology.ids), 'node')} in {count(processes, 'process', 'es')}, {topology.steps} steps"
    display.say(f"{topology.name}: {what}, run {folder.name}")
    if folder.note:
        display.say(folder.note)
    for line in notes(topology):
        display.say(line)
    if hidden and display.interactive:
        display.say("no display here: --viewer web shows the run on a page")


def _viewer(asked: str, keep: bool | None = None) -> str:
    """Return the viewer that `asked` names. Raises UserError if `keep` is given without a page."""
    choice = asked
    if asked != "none":
        from hedgerow.orchestrator.views.rerun.viewer import choose  # noqa: PLC0415

        choice = choose(asked)
    if keep and not choice.startswith(("web", "http:")):
        raise UserError(f"--keep: there is no page to keep with --viewer {asked}. Add --viewer web.", code=Code.OPTION)
    return choice


@app.command(rich_help_panel=RUN)
def simulate(
    file: File,
    steps: Steps = None,
    seed: Seed = None,
    law: Law = None,
    kept_law: KeptLaw = False,
    run_dir: RunDir = None,
    sets: Sets = None,
    viewer: Viewer = "none",
    record: Record = True,
    split_recording: SplitRecording = 256.0,
    plain: Plain = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> int:
    """Run a network in this process, without Zenoh; the result has the same bits as that of `up`."""
    from hedgerow.orchestrator.ground.assignment import layout  # noqa: PLC0415
    from hedgerow.orchestrator.launch.simulation import simulate_into  # noqa: PLC0415
    from hedgerow.orchestrator.launch.watching import Watching  # noqa: PLC0415
    from hedgerow.orchestrator.runs import folder as folders  # noqa: PLC0415
    from hedgerow.orchestrator.runs.selection import notes  # noqa: PLC0415
    from hedgerow.orchestrator.views.screen import screen  # noqa: PLC0415

    topology = importable(read(file, sets, steps=steps, seed=seed, law=law), file, kept_law)
    viewer = _viewer(viewer)
    folder = folders.create(topology, run_dir)
    with contextlib.closing(screen(topology, as_json, plain, quiet, watched=viewer != "none")) as display:
        for line in filter(None, [folder.note, *notes(topology)]):
            display.say(line)
        watching = Watching(record, viewer, split_recording)
        begin = functools.partial(simulate_into, topology, folder, layout(topology, 1), watching, display)
        return code_of_run(folders.begun_or_withdrawn(folder, begin), display)


@app.command(rich_help_panel=RUN)
def check(
    file: File,
    steps: Steps = None,
    seed: Seed = None,
    law: Law = None,
    sets: Sets = None,
    import_law: Annotated[bool, typer.Option("--import-law", help="also import the law, which runs its code")] = False,
) -> int:
    """Validate a topology file and print its nodes; exit code 2 and all mistakes if it is wrong."""
    from hedgerow.orchestrator.metrics.summary import replaced, table  # noqa: PLC0415
    from hedgerow.topologies.load import find  # noqa: PLC0415
    from hedgerow.topologies.resolve import resolve  # noqa: PLC0415

    given = undrawn(file, sets, steps=steps, seed=seed, law=law)
    topology = resolve(given, find(file).parent)
    echo(table(importable(topology) if import_law else topology))
    for line in replaced(given):
        echo(line)
    return 0


@app.command(rich_help_panel=INSPECT)
def schema() -> int:
    """Print the JSON Schema of topology files, for editors."""
    from hedgerow.topologies.schema import Topology  # noqa: PLC0415

    echo(json.dumps(Topology.model_json_schema(), indent=2))
    return 0


@app.command(rich_help_panel=EXPERIMENT)
def chaos(
    seed: Annotated[int, whole("first seed; it determines the network and the faults", low=0)] = 0,
    runs: Annotated[int, whole("number of seeds to try", low=1)] = 1,
    nodes: Annotated[int, whole("largest number of nodes of a network", low=2, high=200)] = 12,
    quiet: NoProgress = False,
) -> int:
    """Run random networks under random faults until a check fails; write the smallest file that fails; exit code 1."""
    from hedgerow.orchestrator.experiments.chaos import hunt, write  # noqa: PLC0415

    with tempfile.TemporaryDirectory(prefix="hedgerow-") as scratch:
        finding = hunt(range(seed, seed + runs), nodes, Path(scratch), (lambda _: None) if quiet else echo)
    if finding is None:
        return 0
    file = Path(f"chaos-{finding.seed}.yaml")
    write(finding, file)
    again = command(["orchestrator", "up", file, "--verify"])
    echo(f"{finding.wrong}\nagain with: {again}")
    return 1


cli_compare.register(app)
cli_live.register(app)
cli_machines.register(app)
cli_files.register(app)
cli_gain.register(app)
cli_importing.register(app)
cli_keys.register(app)
cli_laws.register(app)
cli_report.register(app)
cli_runs.register(app)
cli_soak.register(app)
cli_sweep.register(app)
cli_watch.register(app)
