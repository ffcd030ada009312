"""The commands for a running network: its faults, and its clock."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hedgerow.orchestrator.cli.names import WATCH, Commands
from hedgerow.orchestrator.cli.options import AsJson
from hedgerow.topologies.escape import echo

if TYPE_CHECKING:
    from hedgerow.orchestrator.launch.live import Injected, Live
    from hedgerow.topologies.faults import Fault

faults = typer.Typer(
    cls=Commands,
    help="Make things go wrong in a running network; steps are counted from the next that it makes.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

Run = Annotated[
    str | None,
    typer.Option("--run", metavar="RUN", help="a running network's name [the only one, or that of this folder]"),
]
Link = Annotated[str, typer.Argument(metavar="I-J", help="two neighbours; I,J where a '-' is part of a name")]
Node = Annotated[str, typer.Argument(metavar="NODE", help="the id of a node")]
For = Annotated[int | None, typer.Option("--for", metavar="N", min=1, help="number of steps [until healed]")]
After = Annotated[int, typer.Option("--after", metavar="N", min=0, help="number of steps to wait first")]
OneWay = Annotated[bool, typer.Option("--one-way", help="only messages from I to J")]
Probability = Annotated[float, typer.Option(metavar="P", help="its probability at each step, for each message")]
Number = Annotated[int | None, typer.Argument(metavar="[ID]", help="the fault's number [all that can be ended]")]


def register(app: typer.Typer) -> None:
    """Add these commands to the operator's."""
    app.add_typer(faults, name="fault", rich_help_panel=WATCH)
    for command in (heal, pause, resume, step, rate):
        app.command(rich_help_panel=WATCH)(command)


def _with(run: str | None, as_json: bool, ask: Callable[[Live], tuple[str, dict[str, Any]]]) -> int:
    """Send a request to a network, and print its name and the answer, in one line or as JSON."""
    from hedgerow.orchestrator.launch.live import Live  # noqa: PLC0415

    with Live(run) as live:
        text, answer = ask(live)
        echo(json.dumps({"run": live.run, **answer}) if as_json else f"{live.run}: {text}")
    return 0


def _inject(run: str | None, as_json: bool, inject: Callable[[Live], Injected]) -> int:
    def ask(live: Live) -> tuple[str, dict[str, Any]]:
        added = inject(live)
        return str(added), {"fault": added.number, "step": added.step, "entry": added.fault.written()}

    return _with(run, as_json, ask)


def _steps(after: int, steps: int | None) -> tuple[int, int] | None:
    from hedgerow.topologies.effects import FOREVER  # noqa: PLC0415

    if not after and steps is None:
        return None
    return after, FOREVER if steps is None else after + steps


@faults.command()
def drop(
    link: Link,
    steps: For = None,
    after: After = 0,
    one_way: OneWay = False,
    probability: Probability = 1.0,
    run: Run = None,
    as_json: AsJson = False,
) -> int:
    """Drop the messages of a link."""
    from hedgerow.orchestrator.launch.live import pair  # noqa: PLC0415

    return _inject(
        run,
        as_json,
        lambda live: live.fault.drop(
            pair(link, live.topology), steps=_steps(after, steps), one_way=one_way, probability=probability
        ),
    )


@faults.command()
def delay(
    link: Link,
    by: Annotated[int, typer.Option(metavar="N", min=1, help="delay in steps")],
    steps: For = None,
    after: After = 0,
    one_way: OneWay = False,
    probability: Probability = 1.0,
    run: Run = None,
    as_json: AsJson = False,
) -> int:
    """Delay the messages of a link."""
    from hedgerow.orchestrator.launch.live import pair  # noqa: PLC0415

    return _inject(
        run,
        as_json,
        lambda live: live.fault.delay(
            pair(link, live.topology), by=by, steps=_steps(after, steps), one_way=one_way, probability=probability
        ),
    )


@faults.command()
def cut(
    edge: Link,
    steps: For = None,
    after: After = 0,
    probability: Probability = 1.0,
    run: Run = None,
    as_json: AsJson = False,
) -> int:
    """Stop the flow over an edge, at both its ends."""
    from hedgerow.orchestrator.launch.live import pair  # noqa: PLC0415

    return _inject(
        run,
        as_json,
        lambda live: live.fault.cut(pair(edge, live.topology), steps=_steps(after, steps), probability=probability),
    )


@faults.command()
def partition(
    groups: Annotated[str, typer.Argument(metavar="I,J/K,L", help="groups of nodes")],
    cut_too: Annotated[bool, typer.Option("--cut", help="cut the edges between them too")] = False,
    steps: For = None,
    after: After = 0,
    run: Run = None,
    as_json: AsJson = False,
) -> int:
    """Drop all messages between groups of nodes."""
    from hedgerow.orchestrator.launch.live import groups as groups_in  # noqa: PLC0415

    return _inject(
        run,
        as_json,
        lambda live: live.fault.partition(*groups_in(groups, live.topology), steps=_steps(after, steps), cut=cut_too),
    )


@faults.command()
def sensor(
    node: Node,
    steps: For = None,
    after: After = 0,
    probability: Probability = 1.0,
    run: Run = None,
    as_json: AsJson = False,
) -> int:
    """Drop the readings of a node's state."""
    from hedgerow.topologies.base import node_id  # noqa: PLC0415

    return _inject(
        run,
        as_json,
        lambda live: live.fault.sensor(node_id(node), steps=_steps(after, steps), probability=probability),
    )


@faults.command()
def actuator(
    node: Node,
    steps: For = None,
    after: After = 0,
    probability: Probability = 1.0,
    run: Run = None,
    as_json: AsJson = False,
) -> int:
    """Drop a node's inputs on their way to the plant."""
    from hedgerow.topologies.base import node_id  # noqa: PLC0415

    return _inject(
        run,
        as_json,
        lambda live: live.fault.actuator(node_id(node), steps=_steps(after, steps), probability=probability),
    )


@faults.command()
def crash(
    node: Annotated[str | None, typer.Argument(metavar="[NODE]", help="the node of the agent")] = None,
    process: Annotated[int | None, typer.Option(metavar="P", help="kill this process with all its agents")] = None,
    restart_after: Annotated[
        int | None, typer.Option(metavar="N", help="number of steps that it misses [until healed]")
    ] = None,
    after: After = 0,
    run: Run = None,
    as_json: AsJson = False,
) -> int:
    """Kill an agent, with or without a restart."""
    from hedgerow.topologies.base import node_id  # noqa: PLC0415

    return _inject(
        run,
        as_json,
        lambda live: live.fault.crash(
            None if node is None else node_id(node), process=process, at=after, restart_after=restart_after
        ),
    )


@faults.command()
def jump(
    node: Node,
    to: Annotated[float, typer.Option(metavar="A", help="the new truth, one of the node's candidates")],
    after: After = 0,
    run: Run = None,
    as_json: AsJson = False,
) -> int:
    """Change a node's true a to another of its candidates."""
    from hedgerow.topologies.base import node_id  # noqa: PLC0415

    return _inject(run, as_json, lambda live: live.fault.jump(node_id(node), to=to, at=after))


@faults.command(name="list")
def list_(run: Run = None, as_json: AsJson = False) -> int:
    """List the faults of the file and the added ones."""
    from hedgerow.topologies.describe import describe, window  # noqa: PLC0415

    def when(fault: Fault, step: int) -> str:
        start, stop = window(fault)
        return "to come" if step < start else "over" if step >= stop else "now"

    def ask(live: Live) -> tuple[str, dict[str, Any]]:
        step, listed = live.status()["step"], sorted(live.faults().items())
        lines = [f"{number:3}  {when(fault, step):7}  {describe(fault)}" for number, fault in listed]
        entries = [{"fault": number, "when": when(fault, step), "entry": fault.written()} for number, fault in listed]
        text = "\n".join([f"{len(lines)} fault{'s' * (len(lines) > 1)}", *lines]) if lines else "no faults"
        return text, {"step": step, "faults": entries}

    return _with(run, as_json, ask)


@faults.command()
def heal(number: Number = None, run: Run = None, as_json: AsJson = False) -> int:
    """End a fault of a running network, or all of them."""

    def ask(live: Live) -> tuple[str, dict[str, Any]]:
        healed = live.heal(number)
        return str(healed), {"faults": list(healed.numbers), "step": healed.step}

    return _with(run, as_json, ask)


def pause(run: Run = None, as_json: AsJson = False) -> int:
    """Pause a running network before its next step."""
    return _clock(run, as_json, lambda live: live.pause(), "paused before step {}")


def resume(run: Run = None, as_json: AsJson = False) -> int:
    """Resume a paused network."""
    return _clock(run, as_json, lambda live: live.resume(), "continues from step {}")


def step(
    steps: Annotated[int, typer.Argument(metavar="[N]", min=1, help="number of steps")] = 1,
    run: Run = None,
    as_json: AsJson = False,
) -> int:
    """Make a number of steps, then pause."""
    return _clock(
        run, as_json, lambda live: live.step(steps), f"{steps} step{'s' * (steps > 1)} from step {{}}, then paused"
    )


def rate(
    per_second: Annotated[
        float, typer.Argument(metavar="R", min=0, help="steps per second, 0 for as fast as possible")
    ],
    run: Run = None,
    as_json: AsJson = False,
) -> int:
    """Set the rate of a running network."""
    fast = f"{per_second:g} steps/s" if per_second else "as fast as possible"
    return _clock(run, as_json, lambda live: live.rate(per_second), f"{fast} from step {{}}")


def _clock(run: str | None, as_json: bool, ask: Callable[[Live], int], said: str) -> int:
    def told(live: Live) -> tuple[str, dict[str, Any]]:
        at = ask(live)
        return said.format(at), {"step": at}

    return _with(run, as_json, told)
