"""The command line of the operator."""

from __future__ import annotations

import contextlib
import functools
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TextIO

import typer

from hedgerow.orchestrator.cli import files as cli_files
from hedgerow.orchestrator.cli import keys as cli_keys
from hedgerow.orchestrator.cli import live as cli_live
from hedgerow.orchestrator.cli import machines as cli_machines
from hedgerow.orchestrator.cli import report as cli_report
from hedgerow.orchestrator.cli import soak as cli_soak
from hedgerow.orchestrator.cli import sweep as cli_sweep
from hedgerow.orchestrator.cli import watch as cli_watch
from hedgerow.orchestrator.cli.exit_code import code_of_run, leave, run_to_exit_code
from hedgerow.orchestrator.cli.names import Commands
from hedgerow.orchestrator.cli.options import AsJson, File, Law, RunDir, Seed, Sets, Steps
from hedgerow.orchestrator.launch.fork_client import ForkClient
from hedgerow.topologies.errors import Code, DeadlineError, UserError, check_options
from hedgerow.topologies.escape import command, echo
from hedgerow.topologies.paths import user_path
from hedgerow.wire import start
from hedgerow.wire.child import escape_warnings
from hedgerow.wire.runtime import let_numbers_overflow

# What a topology needs takes most of a second to load: each command loads what it needs itself.
if TYPE_CHECKING:
    from hedgerow.orchestrator.runs.folder import RunFolder
    from hedgerow.orchestrator.views.screen import Screen
    from hedgerow.topologies.schema import Topology

app = typer.Typer(
    name="orchestrator",
    cls=Commands,
    help="Networks of agents that hedge with their neighbours, each its own process, over Zenoh.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
    rich_markup_mode=None,
)
_BEGAN = time.monotonic()
_FORK_CLIENT: ForkClient | None = None

Record = Annotated[bool, typer.Option("--record/--no-record", help="write run.rrd")]
SplitRecording = Annotated[
    float, typer.Option(metavar="MB", min=0, help="go on in run-001.rrd and so on past so many MB, 0 for never")
]
Plain = Annotated[bool, typer.Option("--plain", help="lines rather than a live table, on a terminal too")]
RunName = Annotated[
    str | None, typer.Argument(metavar="[RUN]", help="a running network's name [the only one, or that of this folder]")
]
Viewer = Annotated[
    str, typer.Option(metavar="native|web|none|URL", help="where to watch live [native, if there is a display]")
]


def run_command(began: float, fork_client: ForkClient | None) -> None:
    """Run the command line and leave with its exit code; `began` is when the process did, by time.monotonic()."""
    global _BEGAN, _FORK_CLIENT
    _BEGAN, _FORK_CLIENT = began, fork_client
    let_numbers_overflow()
    escape_warnings()
    leave(run_to_exit_code(lambda: app(standalone_mode=False) or 0))


def _importable(topology: Topology) -> Topology:
    """The topology, whose law is code: a module that fails to load is better known before a run begins."""
    from hedgerow.agents.shard import law_class  # noqa: PLC0415
    from hedgerow.orchestrator.ground.assignment import law_of  # noqa: PLC0415

    law_class(law_of(topology))
    return topology


def read(file: str, sets: list[str] | None, **replace: object) -> Topology:
    from hedgerow.topologies.load import find, load  # noqa: PLC0415
    from hedgerow.topologies.override import Override  # noqa: PLC0415
    from hedgerow.topologies.resolve import resolve  # noqa: PLC0415

    options = [Override.of_option(key, value) for key, value in replace.items() if value is not None]
    return resolve(load(file, [*options, *(sets or [])]), find(file).parent)


@app.command()
def up(
    file: File,
    processes: Annotated[
        str | None, typer.Option(metavar="P", help="agent processes, or auto, or per-node [per-node up to 64 nodes]")
    ] = None,
    steps: Steps = None,
    seed: Seed = None,
    law: Law = None,
    rate: Annotated[float, typer.Option(metavar="R", help="steps per second, 0 for as fast as possible")] = 0.0,
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
        str | None, typer.Option(metavar="ENDPOINT", help="use this Zenoh router, e.g. tcp/host:7447")
    ] = None,
    secure: Annotated[
        bool | None, typer.Option("--secure/--open", help="certificates for all, and a router that refuses the rest")
    ] = None,
    keys: Annotated[
        Path | None,
        typer.Option(parser=user_path, metavar="DIR", help="what `orchestrator keys` made, for a router that is there"),
    ] = None,
    external: Annotated[
        str | None, typer.Option(metavar="NAMES", help="nodes that are started elsewhere, `all`, `plant`")
    ] = None,
    listen: Annotated[
        str | None, typer.Option(metavar="ENDPOINT", help="open a port for them, e.g. tcp/0.0.0.0:7447")
    ] = None,
    namespace: Annotated[str | None, typer.Option(metavar="KEY", help="where all of them meet [hedgerow/NAME]")] = None,
    wait: Annotated[
        float | None, typer.Option(metavar="S", help="seconds that they have to come [600, on Ray 120]")
    ] = None,
    on: Annotated[
        str | None, typer.Option(metavar="ray|ray://HOST:PORT", help="the cluster that the agents live on")
    ] = None,
    deadline: Annotated[float, typer.Option(metavar="S", help="seconds to wait for an agent before going on")] = 10.0,
    verify: Annotated[bool, typer.Option("--verify", help="compare with the in-process reference afterwards")] = False,
    detach: Annotated[bool, typer.Option("--detach", help="return once it runs")] = False,
    lifeline: Annotated[bool, typer.Option("--lifeline", help="end when standard input does")] = False,
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Run a network: one process an agent, one for the plant, over Zenoh."""
    if lifeline and detach:
        raise UserError(
            "--lifeline --detach: choose one; what runs in the background has no standard input to end with"
        )
    if lifeline:
        threading.Thread(target=_end_with_standard_input, name="lifeline", daemon=True).start()
    from hedgerow.orchestrator.ground.assignment import layout, places, views_of  # noqa: PLC0415
    from hedgerow.orchestrator.launch.endpoints import check as check_security  # noqa: PLC0415
    from hedgerow.orchestrator.launch.endpoints import meeting_place  # noqa: PLC0415
    from hedgerow.orchestrator.launch.recording import Watching  # noqa: PLC0415
    from hedgerow.orchestrator.launch.up import Network, Options  # noqa: PLC0415
    from hedgerow.orchestrator.runs import folder as folders  # noqa: PLC0415
    from hedgerow.orchestrator.views.screen import screen  # noqa: PLC0415

    check_options(rate=rate, deadline=deadline, wait=wait)
    count_of: object = int(processes) if processes and processes.lstrip("-").isdecimal() else processes
    topology = _importable(read(file, sets, steps=steps, seed=seed, law=law, processes=count_of, secure=secure))
    shards = layout(topology, topology.process_count)
    where = places(views_of(topology, shards))
    check_security(topology.secure, router, keys, where, external is not None, listen, namespace)
    if keys is not None and (on is not None or external is not None):
        router, namespace = meeting_place(keys, where, router, listen, namespace)
    elsewhere = None
    if on is not None:
        _check_cluster(on, external)
    elif external is not None:
        from hedgerow.orchestrator.launch.external_agents import chosen, namespace_of  # noqa: PLC0415

        meet = namespace or namespace_of(topology)
        elsewhere = chosen(external, topology, shards, router, listen, meet, wait or 600.0)
    elif listen or namespace:
        raise UserError("--listen and --namespace are for processes that are started elsewhere: name them, --external")
    viewer = _viewer(viewer, keep)
    if detach:
        return _start_detached()
    stack = contextlib.ExitStack()
    on_ray = None
    if on is not None:
        from hedgerow.orchestrator.launch.ray_agents import chosen as chosen_on_ray  # noqa: PLC0415

        on_ray = stack.enter_context(chosen_on_ray(on, topology, shards, router, listen, namespace, wait))
        elsewhere = on_ray.external
    folder = folders.create(topology, run_dir)
    display = stack.enter_context(contextlib.closing(screen(topology, as_json, plain, watched=viewer != "none")))
    _introduce(topology, len(shards), folder, display)
    watching = Watching(record, viewer, split_recording, _keeps(keep, display))
    options = Options(rate, deadline, router, keys, elsewhere, on_ray, watching, verify)

    def on_first_step(after_s: float) -> None:
        display.say(f"running: first step after {after_s:.2f} s")
        if os.environ.get(_DETACHED):
            display.say(f"running in the background; `{command(['orchestrator', 'stop', folder.name])}` ends it")
            _let_go_of_terminal(folder.logs / "up.log")

    with stack:
        fork_client = stack.enter_context(contextlib.closing(_FORK_CLIENT or ForkClient()))
        begin = functools.partial(Network, topology, folder, shards, options, display, fork_client, _BEGAN)
        return code_of_run(folders.begun_or_withdrawn(folder, begin).run(on_first_step, stack), display)


def _keeps(keep: bool | None, display: Screen) -> bool:
    """Return True if a page stays after the run: as asked, else if a terminal can send Ctrl-C."""
    return keep if keep is not None else display.interactive or _is_terminal(sys.stdin)


def _is_terminal(stream: TextIO | None) -> bool:
    try:
        return stream is not None and stream.isatty()
    except ValueError:  # it is closed
        return False


def _check_cluster(on: str, external: str | None) -> None:
    """Raise UserError for what does not go together with a cluster, and for what names none."""
    from hedgerow.orchestrator.launch.ray_cluster import check  # noqa: PLC0415

    if external is not None:
        raise UserError("--external --on: choose one; on a cluster, Ray starts all agents")
    check(on)


def _introduce(topology: Topology, processes: int, folder: RunFolder, display: Screen) -> None:
    """Say what is run, and what of it is written down."""
    from hedgerow.orchestrator.metrics.summary import count  # noqa: PLC0415
    from hedgerow.orchestrator.runs.selection import told  # noqa: PLC0415

    what = f"{count(len(topology.ids), 'node')} in {count(processes, 'process', 'es')}, {topology.steps} steps"
    display.say(f"{topology.name}: {what}, run {folder.name}")
    if folder.note:
        display.say(folder.note)
    for line in told(topology):
        display.say(line)


def _end_with_standard_input() -> None:
    """Whoever started us holds the other end of the pipe; even SIGKILL makes them let go of it."""
    while os.read(0, 4096):
        pass
    # SIGTERM may be ignored, and then the kernel would drop it.
    numbers = (signal.SIGTERM, signal.SIGHUP, signal.SIGINT)
    os.kill(os.getpid(), next((one for one in numbers if not start.ignored([one])), signal.SIGKILL))


_DETACHED = "HEDGEROW_DETACHED"
_END_DEADLINE_S = 30.0
"""How long a network has to end that was to be detached."""


def _start_detached() -> int:
    """Run the same command in a session of its own; until its first step, relay what it says, and Ctrl-C to it."""
    asked: list[int] = []
    process = None

    def end(number: int, _: object) -> None:
        asked.append(number)
        if process is not None:
            process.terminate()
            threading.Thread(target=_kill_later, args=(process,), daemon=True).start()

    for number in (signal.SIGINT, signal.SIGTERM):
        start.handle(number, end)
    command = [
        sys.executable,
        "-P",
        "-m",
        "hedgerow.orchestrator",
        *(word for word in sys.argv[1:] if word != "--detach"),
    ]
    process = subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,
        env=os.environ | {_DETACHED: "1"},
    )
    if asked:  # while it was started
        end(asked[0], None)
    assert process.stdout is not None
    for line in process.stdout:
        echo(line.decode(errors="replace"), end="")
    try:
        code = process.wait(timeout=1.0)
    except subprocess.TimeoutExpired:
        code = 0
    if asked:
        process.wait()
        code = 128 + asked[0]
    return code


def _kill_later(process: subprocess.Popen[bytes]) -> None:
    try:
        process.wait(_END_DEADLINE_S)
    except subprocess.TimeoutExpired:
        process.kill()


def _let_go_of_terminal(log: Path) -> None:
    sys.stdout.flush()
    descriptor = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    os.dup2(descriptor, 1)
    os.dup2(descriptor, 2)


def _viewer(asked: str, keep: bool | None = None) -> str:
    """Return the viewer that `asked` names here; UserError if a page is to be kept and no page is asked for."""
    choice = asked
    if asked != "none":
        from hedgerow.orchestrator.views.rerun.viewer import choose  # noqa: PLC0415

        choice = choose(asked)
    if keep and not choice.startswith(("web", "http:")):
        raise UserError(f"--keep: there is no page to keep with --viewer {asked}. Add --viewer web.", code=Code.OPTION)
    return choice


@app.command()
def simulate(
    file: File,
    steps: Steps = None,
    seed: Seed = None,
    law: Law = None,
    run_dir: RunDir = None,
    sets: Sets = None,
    viewer: Viewer = "none",
    record: Record = True,
    split_recording: SplitRecording = 256.0,
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Run the same network in this one process, without Zenoh: the reference, and the quick way."""
    from hedgerow.orchestrator.ground.assignment import layout  # noqa: PLC0415
    from hedgerow.orchestrator.launch.recording import Watching  # noqa: PLC0415
    from hedgerow.orchestrator.launch.simulation import simulate_into  # noqa: PLC0415
    from hedgerow.orchestrator.runs import folder as folders  # noqa: PLC0415
    from hedgerow.orchestrator.runs.selection import told  # noqa: PLC0415
    from hedgerow.orchestrator.views.screen import screen  # noqa: PLC0415

    topology = _importable(read(file, sets, steps=steps, seed=seed, law=law))
    folder = folders.create(topology, run_dir)
    viewer = _viewer(viewer)
    with contextlib.closing(screen(topology, as_json, plain, watched=viewer != "none")) as display:
        for line in filter(None, [folder.note, *told(topology)]):
            display.say(line)
        watching = Watching(record, viewer, split_recording)
        return code_of_run(simulate_into(topology, folder, layout(topology, 1), watching, display), display)


@app.command()
def check(
    file: File,
    steps: Steps = None,
    seed: Seed = None,
    law: Law = None,
    sets: Sets = None,
    import_law: Annotated[
        bool, typer.Option("--import-law", help="load the law as well: a law is code, and runs then")
    ] = False,
) -> int:
    """Validate a topology file and show what it says, node by node; exit code 2 and every mistake if it is wrong."""
    from hedgerow.orchestrator.metrics.summary import table  # noqa: PLC0415

    topology = read(file, sets, steps=steps, seed=seed, law=law)
    echo(table(_importable(topology) if import_law else topology))
    return 0


@app.command()
def schema() -> int:
    """Print the JSON Schema of topology files, for editors."""
    from hedgerow.topologies.schema import Topology  # noqa: PLC0415

    echo(json.dumps(Topology.model_json_schema(), indent=2))
    return 0


@app.command()
def ps(as_json: AsJson = False) -> int:
    """List the networks that are running."""
    from hedgerow.orchestrator.runs import registry  # noqa: PLC0415

    entries = registry.running()
    if as_json:
        echo(json.dumps([vars(entry) for entry in entries]))
        return 0
    for entry in entries:
        since = datetime.fromtimestamp(entry.started).strftime("%H:%M:%S")
        echo(f"{entry.run}  pid {entry.pid}  since {since}  {entry.folder}")
    if not entries:
        echo("no network is running")
    return 0


@app.command()
def status(run: RunName = None, as_json: AsJson = False) -> int:
    """Say how far a running network is."""
    from hedgerow.orchestrator.launch.live import Live, where  # noqa: PLC0415

    with Live(run) as live:
        answer = live.status()
    echo(json.dumps({**vars(live.entry), **answer}) if as_json else f"{live.run}: {where(answer)}")
    return 0


@app.command()
def stop(
    run: RunName = None,
    deadline: Annotated[float, typer.Option(metavar="S", help="seconds to wait for its end")] = 20.0,
) -> int:
    """End a running network cleanly, as Ctrl-C does, and wait until it is gone."""
    from hedgerow.orchestrator.launch.live import Live  # noqa: PLC0415
    from hedgerow.orchestrator.runs import registry  # noqa: PLC0415
    from hedgerow.wire.session import WireError  # noqa: PLC0415

    check_options(deadline=deadline)
    entry = registry.find(run)
    try:
        with Live(entry) as live:
            live.ask_to_stop()
    except WireError:  # the plant is gone or frozen: then its parent must see to it
        with contextlib.suppress(ProcessLookupError):
            os.kill(entry.pid, signal.SIGTERM)
    until = time.monotonic() + deadline
    while entry in registry.running():
        if time.monotonic() > until:
            raise DeadlineError(f"{entry.run}: still there after {deadline:g} s; kill -9 {entry.pid} ends it at once")
        time.sleep(0.05)
    echo(f"{entry.run}: stopped; {entry.folder}")
    return 0


@app.command()
def chaos(
    seed: Annotated[
        int, typer.Option(metavar="N", min=0, help="the first seed; all that happens is drawn from it")
    ] = 0,
    runs: Annotated[int, typer.Option(min=1, help="how many seeds to try, one after the other")] = 1,
    nodes: Annotated[int, typer.Option(min=2, max=200, help="networks of 2 to so many nodes")] = 12,
) -> int:
    """Run random networks under random faults until one misbehaves, and leave the least file that does; exit code 1."""
    from hedgerow.orchestrator.experiments.chaos import hunt, write  # noqa: PLC0415

    with tempfile.TemporaryDirectory(prefix="hedgerow-") as scratch:
        finding = hunt(range(seed, seed + runs), nodes, Path(scratch), echo)
    if finding is None:
        return 0
    file = Path(f"chaos-{finding.seed}.yaml")
    write(finding, file)
    again = command(["orchestrator", "up", file, "--verify"])
    echo(f"{finding.wrong}\nagain with: {again}")
    return 1


cli_live.register(app)
cli_machines.register(app)
cli_files.register(app)
cli_keys.register(app)
cli_report.register(app)
cli_soak.register(app)
cli_sweep.register(app)
cli_watch.register(app)
