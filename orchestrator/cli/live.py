"""The commands for running networks: their list, their ends, their faults, and their clocks."""

from __future__ import annotations

import contextlib
import inspect
import json
import os
import re
import signal
import time
from collections.abc import Callable
from datetime import datetime
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hedgerow.orchestrator.cli.names import WATCH, Commands
from hedgerow.orchestrator.cli.numbers import real, real_argument, whole, whole_argument
from hedgerow.orchestrator.cli.options import AsJson, Running, RunOption, chosen
from hedgerow.orchestrator.launch.fault_verbs import VERBS, FaultVerbs
from hedgerow.topologies.errors import DeadlineError, check_options
from hedgerow.topologies.escape import echo, escape

if TYPE_CHECKING:
    from hedgerow.orchestrator.launch.live import Injected, Live
    from hedgerow.topologies.faults import Fault

faults = typer.Typer(
    cls=Commands,
    help="Make things go wrong in a running network; steps are counted from the next that it makes.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

_Link = Annotated[str, typer.Argument(metavar="I-J", help="two neighbours; I,J where a '-' is part of a name")]
_Chance = Annotated[float, real("its probability at each step, for each message", metavar="P")]
_For = Annotated[int | None, whole("number of steps [until healed]", "--for", low=1)]
_Back = Annotated[int | None, whole("number of steps that it misses [until healed]")]
_Process = Annotated[int | None, whole("kill this process with all its agents", metavar="P")]
_NODE_OR_PROCESS = Annotated[str | None, typer.Argument(metavar="NODE", help="the node of the agent")]
_REQUIRED = inspect.Parameter.empty
_ARGUMENTS: dict[str, tuple[Any, Any]] = {
    "link": (_Link, _REQUIRED),
    "edge": (_Link, _REQUIRED),
    "groups": (Annotated[str, typer.Argument(metavar="I,J/K,L", help="groups of nodes")], _REQUIRED),
    "node": (Annotated[str, typer.Argument(metavar="NODE", help="the id of a node")], _REQUIRED),
    "process": (_Process, None),
    "to": (Annotated[float, real("the new truth, one of the node's candidates", metavar="A")], _REQUIRED),
    "by": (Annotated[int, whole("delay in steps", low=1)], _REQUIRED),
    "cut": (Annotated[bool, typer.Option("--cut", help="cut the edges between them too")], False),
    "one_way": (Annotated[bool, typer.Option("--one-way", help="only the messages from I to J")], False),
    "probability": (_Chance, 1.0),
    "steps": (_For, None),
    "restart_after": (_Back, None),
    "after": (Annotated[int, whole("number of steps to wait first", "--after", low=0)], 0),
    "run": (RunOption, None),
    "as_json": (AsJson, False),
}
"""The command-line form of each argument of the methods of FaultVerbs, and its default."""
Number = Annotated[int | None, whole_argument("the fault's number [all that can be ended]", metavar="ID")]


_PIDS_SHOWN = 16


def register(app: typer.Typer) -> None:
    """Add these commands to the operator's."""
    app.add_typer(faults, name="fault", rich_help_panel=WATCH)
    for command in (ps, status, stop, heal, pause, resume, step, rate):
        app.command(rich_help_panel=WATCH)(command)


def ps(as_json: AsJson = False) -> int:
    """List the running networks."""
    from hedgerow.orchestrator.runs import registry  # noqa: PLC0415

    entries = registry.running()
    if as_json:
        listed = (
            {**vars(entry), "over": entry.is_over, "verdict": (entry.verdict or None) if entry.is_over else None}
            for entry in entries
        )
        echo(json.dumps([*listed]))
        return 0
    for entry in entries:
        since = datetime.fromtimestamp(entry.started).strftime("%H:%M:%S")
        over = f"  {entry.ending()}" if entry.is_over else ""
        echo(f"{entry.run}  pid {entry.pid}  since {since}  {entry.folder}{over}")
    if not entries:
        echo("no network is running")
    return 0


def status(run: Running = None, named: RunOption = None, as_json: AsJson = False) -> int:
    """Print the step of a running network, the agents that it waits for, and the pids of its processes."""
    from hedgerow.orchestrator.launch.live import Live, where  # noqa: PLC0415

    with Live(chosen(run, named)) as live:
        answer, pids = live.status(), live.pids()
    if as_json:
        echo(json.dumps({**vars(live.entry), **answer, "pids": pids}))
        return 0
    echo(f"{live.run}: {where(answer)}")
    if pids:
        shown = ", ".join(f"{escape(name)} {pid}" for name, pid in [*pids.items()][:_PIDS_SHOWN])
        more = f" and {len(pids) - _PIDS_SHOWN} more, see --json" if len(pids) > _PIDS_SHOWN else ""
        echo(f"pids: {shown}{more}")
    return 0


def stop(
    run: Running = None,
    named: RunOption = None,
    deadline: Annotated[float, real("seconds to wait for the end", metavar="S")] = 20.0,
) -> int:
    """End a running network as Ctrl-C does, and wait for its end."""
    from hedgerow.orchestrator.launch.live import Live  # noqa: PLC0415
    from hedgerow.orchestrator.runs import registry  # noqa: PLC0415
    from hedgerow.wire.session import WireError  # noqa: PLC0415

    check_options(deadline=deadline)
    entry = registry.find(chosen(run, named))
    try:
        if entry.is_over:
            raise WireError("its plant has ended")
        with Live(entry) as live:
            live.ask_to_stop()
    except WireError:  # the plant is gone or frozen: ask its parent process
        with contextlib.suppress(ProcessLookupError):
            os.kill(entry.pid, signal.SIGTERM)
    until = time.monotonic() + deadline
    while entry in registry.running():
        if time.monotonic() > until:
            raise DeadlineError(f"{entry.run}: still there after {deadline:g} s; kill -9 {entry.pid} ends it at once")
        time.sleep(0.05)
    echo(f"{entry.run}: stopped; {entry.folder}")
    return 0


def _with(run: str | None, as_json: bool, ask: Callable[[Live], tuple[str, dict[str, Any]]]) -> int:
    """Send a request to a network, and print its name and the answer, in one line or as JSON."""
    from hedgerow.orchestrator.launch.live import Live  # noqa: PLC0415

    with Live(run) as live:
        text, answer = ask(live)
        echo(json.dumps({"run": live.run, **answer}) if as_json else f"{live.run}: {text}")
    return 0


def _steps(after: int, steps: int | None) -> tuple[int, int] | None:
    from hedgerow.topologies.effects import FOREVER  # noqa: PLC0415

    if not after and steps is None:
        return None
    return after, FOREVER if steps is None else after + steps


def _read(name: str, value: Any, live: Live) -> Any:
    """Return an argument of a fault from its text."""
    from hedgerow.orchestrator.launch.live import groups, pair  # noqa: PLC0415
    from hedgerow.topologies.base import node_id  # noqa: PLC0415

    match name:
        case "link" | "edge":
            return pair(value, live.topology)
        case "groups":
            return groups(value, live.topology)
        case "node":
            return node_id(value)
    return value


def _kind(kind: str) -> Callable[..., int]:
    """Return the command that injects faults of a kind, with the arguments of its method of FaultVerbs."""
    verb = getattr(FaultVerbs, kind)
    arguments = inspect.signature(verb).parameters
    options = {name: _ARGUMENTS[name] for name in (*arguments, "after", "run", "as_json") if name in _ARGUMENTS}
    if "process" in arguments:
        options["node"] = _NODE_OR_PROCESS, None

    def command(run: str | None, as_json: bool, after: int, **given: Any) -> int:
        def inject(live: Live) -> tuple[str, dict[str, Any]]:
            values = {name: _read(name, value, live) for name, value in given.items() if value is not None}
            when = {"steps": _steps(after, values.pop("steps", None))} if "steps" in arguments else {"at": after}
            added: Injected = getattr(live.fault, kind)(*values.pop("groups", ()), **values, **when)
            return str(added), {"fault": added.number, "step": added.step, "entry": added.fault.written()}

        return _with(run, as_json, inject)

    command.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [
            inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
            for name, (annotation, default) in options.items()
        ]
    )
    command.__annotations__ = {name: annotation for name, (annotation, _) in options.items()}
    command.__doc__ = re.split("[;.]", inspect.getdoc(verb) or "")[0] + "."
    return command


for _verb in VERBS:
    faults.command(name=_verb)(_kind(_verb))


@faults.command(name="list")
def list_(run: RunOption = None, as_json: AsJson = False) -> int:
    """List the faults of the file and the added ones."""
    from hedgerow.topologies.describe import describe  # noqa: PLC0415

    def when(fault: Fault, step: int) -> str:
        start, stop = fault.window
        return "to come" if step < start else "over" if step >= stop else "now"

    def ask(live: Live) -> tuple[str, dict[str, Any]]:
        step, listed = live.status()["step"], sorted(live.faults().items())
        lines = [f"{number:3}  {when(fault, step):7}  {describe(fault)}" for number, fault in listed]
        entries = [{"fault": number, "when": when(fault, step), "entry": fault.written()} for number, fault in listed]
        text = "\n".join([f"{len(lines)} fault{'s' * (len(lines) > 1)}", *lines]) if lines else "no faults"
        return text, {"step": step, "faults": entries}

    return _with(run, as_json, ask)


@faults.command()
def heal(number: Number = None, run: RunOption = None, as_json: AsJson = False) -> int:
    """End a fault of a running network, or all of them."""

    def ask(live: Live) -> tuple[str, dict[str, Any]]:
        healed = live.heal(number)
        return str(healed), {"faults": list(healed.numbers), "step": healed.step}

    return _with(run, as_json, ask)


def pause(run: Running = None, named: RunOption = None, as_json: AsJson = False) -> int:
    """Pause a running network before its next step."""
    return _clock(chosen(run, named), as_json, lambda live: live.pause(), "paused before step {}")


def resume(run: Running = None, named: RunOption = None, as_json: AsJson = False) -> int:
    """Resume a paused network."""
    return _clock(chosen(run, named), as_json, lambda live: live.resume(), "continues from step {}")


def step(
    steps: Annotated[int, whole_argument("number of steps", metavar="N", low=1)] = 1,
    run: RunOption = None,
    as_json: AsJson = False,
) -> int:
    """Make a number of steps, then pause."""
    return _clock(
        run, as_json, lambda live: live.step(steps), f"{steps} step{'s' * (steps > 1)} from step {{}}, then paused"
    )


def rate(
    per_second: Annotated[float, real_argument("steps per second, 0 for as fast as possible", metavar="R", low=0)],
    run: RunOption = None,
    as_json: AsJson = False,
) -> int:
    """Set the rate of a running network."""
    fast = f"{per_second:g} steps/s" if per_second else "as fast as possible"
    return _clock(run, as_json, lambda live: live.rate(per_second), f"{fast} from step {{}}")


def _clock(run: str | None, as_json: bool, ask: Callable[[Live], int], sentence: str) -> int:
    def step_of(live: Live) -> tuple[str, dict[str, Any]]:
        at = ask(live)
        return sentence.format(at), {"step": at}

    return _with(run, as_json, step_of)
