"""Control of a running network: its status, its clock, and faults that are added and ended.

    with Live() as network:                                     # the one that runs here
        print(network.fault.drop((2, 4), steps=range(50)))      # fault 1: drop 2-4 from step 214 to 264
        network.wait_for_step(300)
        network.heal()

Each request takes effect at a step that the answer names. The steps of a fault count from there.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import psutil
import zenoh
from pydantic import TypeAdapter, ValidationError

from hedgerow.orchestrator.launch.control import ask
from hedgerow.orchestrator.launch.fault_verbs import FaultVerbs, NodeId, Pair
from hedgerow.orchestrator.runs import registry
from hedgerow.topologies.base import node_id
from hedgerow.topologies.describe import describe
from hedgerow.topologies.errors import Code, DeadlineError, HedgerowError, TopologyError, UserError
from hedgerow.topologies.faults import Fault, Jump
from hedgerow.topologies.json_file import loads
from hedgerow.topologies.load import load, parse
from hedgerow.topologies.plain import plain
from hedgerow.topologies.rules import broken_faults
from hedgerow.topologies.schema import Topology
from hedgerow.topologies.wording import in_our_words
from hedgerow.wire.session import WireError, open_client

if TYPE_CHECKING:
    from hedgerow.orchestrator.runs.run import Run

WAIT_DEADLINE_S = 60.0
END_DEADLINE_S = 20.0
_LOOK_EVERY_S = 0.01
_FAULT: TypeAdapter[Fault] = TypeAdapter(Fault)


def checked(fault: Fault | Mapping[str, Any], topology: Topology) -> Fault:
    """Return a fault for a resolved topology; raise UserError with all mistakes, as for a file."""
    if isinstance(fault, Mapping):
        entry = plain(fault)
        kind = entry.get("kind", "fault")
        try:
            model: Fault = _FAULT.validate_python(entry)
        except ValidationError as error:
            raise UserError("\n".join(_lines(kind, _schema_problems(entry, error))), code=Code.FAULT) from None
    else:
        kind, model = fault.kind, fault
    if problems := broken_faults(topology.model_copy(update={"faults": (model,)})):
        raise UserError("\n".join(_lines(kind, problems)), code=Code.FAULT)
    return model


def _schema_problems(entry: Any, refused: ValidationError) -> Sequence[Any]:
    least = {"name": "one", "b": 0.1, "steps": 1, "nodes": [0], "faults": [entry]}
    try:
        parse(json.dumps(least, default=str).encode(), "fault", Path())
    except TopologyError as error:
        return error.problems
    # A file accepts some numbers that Python's types exclude, such as 1e16 for a step.
    return [f"{'.'.join(map(str, found['loc'][1:]))}: {in_our_words(found)}" for found in refused.errors()]


def _lines(kind: str, problems: Sequence[Any]) -> Iterator[str]:
    for problem in problems:
        yield f"{kind}: " + str(problem).removeprefix("fault 1").removeprefix(": ")


def pair(text: str, topology: Topology) -> Pair:
    """Return the two nodes in `2-4`; `2,4` is the same for ambiguous names with a '-' in them."""
    if "," in text:
        one, _, other = text.partition(",")
        return _known(one, text, topology), _known(other, text, topology)
    splits = [(node_id(text[:k]), node_id(text[k + 1 :])) for k, sign in enumerate(text) if sign == "-"]
    found = [ends for ends in splits if all(map(topology.has, ends))]
    linked = [ends for ends in found if topology.graph.joins(*map(topology.position, ends))]
    meant = linked or found
    if len(meant) == 1:
        return meant[0]
    if meant:
        readings = " or ".join(f"{i},{j}" for i, j in meant)
        raise UserError(f"{text}: may be read as {readings}; write the one that you mean", code=Code.OPTION)
    if len(splits) == 1:
        return _known(splits[0][0], text, topology), _known(splits[0][1], text, topology)
    raise UserError(f"{text}: names no two nodes, as 2-4 does; the nodes are {_listed(topology)}", code=Code.OPTION)


def groups(text: str, topology: Topology) -> list[list[NodeId]]:
    """Return the groups of nodes in `1,2,3/4,5`."""
    return [[_known(node, text, topology) for node in group.split(",")] for group in text.split("/")]


def _known(name: NodeId, text: str, topology: Topology) -> NodeId:
    node: NodeId = node_id(name)
    if not topology.has(node):
        raise UserError(f"{text}: {name} is no node; the nodes are {_listed(topology)}", code=Code.OPTION)
    return node


def _listed(topology: Topology) -> str:
    return ", ".join(map(str, topology.ids[:12])) + (", …" if len(topology.ids) > 12 else "")


@dataclass(frozen=True)
class Injected:
    """A fault that was added to a running network."""

    number: int
    """its number for `heal`, from 1"""
    step: int
    """the first possible step; the steps of the fault count from there"""
    fault: Fault
    """the fault as in the run's topology.yaml, with steps of the run"""

    def __str__(self) -> str:
        return f"fault {self.number}: {describe(self.fault)}"


@dataclass(frozen=True)
class Healed:
    """The faults that were ended."""

    numbers: tuple[int, ...]
    step: int
    """the first step without them; a crashed agent returns one step later"""

    def __str__(self) -> str:
        if not self.numbers:
            return "no fault to heal"
        which = "fault" if len(self.numbers) == 1 else "faults"
        return f"{which} {', '.join(map(str, self.numbers))} healed from step {self.step}"


class Live:
    """A session with a running network; a context manager.

    run: the name of a network, or its beginning, or its entry of `registry`; if omitted, the only running network, or
    that of this working directory. Every method raises UserError if the network refuses a request, and WireError if its
    plant does not answer.
    """

    def __init__(self, run: str | registry.Entry | None = None) -> None:
        self.entry = run if isinstance(run, registry.Entry) else registry.find(run)
        """the entry of the run in the registry"""
        self._session: zenoh.Session | None = None
        self._added: dict[int, Fault] = {}

    def __enter__(self) -> Live:
        if self.entry.is_over:
            raise self.entry.over()
        credentials = self.entry.credentials and Path(self.entry.credentials)
        self._session = open_client(self.entry.endpoint, self.entry.namespace, credentials or None)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<Live {self.entry.run}, in {self.entry.folder}>"

    def close(self) -> None:
        """Close the session; the network continues."""
        if self._session is not None:
            self._session.close()  # type: ignore[no-untyped-call]
            self._session = None

    @property
    def run(self) -> str:
        """Return the name of the run."""
        return self.entry.run

    @property
    def folder(self) -> Path:
        """Return the folder of the run."""
        return Path(self.entry.folder)

    @cached_property
    def topology(self) -> Topology:
        """Return the resolved network, with the faults at the time of the first call."""
        return load(str(self.folder))

    def _ask(self, command: str, **request: Any) -> dict[str, Any]:
        if self._session is None:
            raise HedgerowError("no session with the network; use `with Live() as network:`")
        answer = ask(self._session, command, request)
        if "error" in answer:
            raise UserError(
                f"{self.run}: {answer['error']}", code=Code.FAULT if command in ("fault", "heal") else Code.OPTION
            )
        return answer

    def status(self) -> dict[str, Any]:
        """Return the status: `step` of `steps`, `running`, `paused`, `rate`, and the `missing` and `lost` shards."""
        return self._ask("status")

    def pids(self) -> dict[str, int]:
        """Return the pid of every process of the run that lives on this machine, by name, from events.jsonl."""
        from hedgerow.orchestrator.runs.files import load_events  # noqa: PLC0415

        found: dict[str, int] = {}
        for event in load_events(self.folder):
            if event["event"] == "start":
                found |= event.get("pids", {})
            elif event["event"] == "restarted" and "pid" in event:
                found[event["process"]] = event["pid"]
        return {name: pid for name, pid in found.items() if psutil.pid_exists(pid)}

    def inject(self, fault: Fault | Mapping[str, Any]) -> Injected:
        """Add a fault; its steps count from the first possible step: [0, 50) is the next 50 steps."""
        model = checked(fault, self.topology)
        if isinstance(model, Jump) and not isinstance(model.a, float):
            listed = ", ".join(map(repr, self.topology.nodes[model.node].candidates))  # type: ignore[arg-type]
            raise UserError(
                f"jump: a: nothing is drawn while a network runs; name a candidate of {model.node}: {listed}",
                code=Code.FAULT,
            )
        answer = self._ask("fault", entry=model.written())
        added = Injected(answer["fault"], answer["step"], _FAULT.validate_python(answer["entry"]))
        self._added[added.number] = added.fault
        return added

    @property
    def fault(self) -> FaultVerbs[Injected]:
        """Return an object with every kind of fault as a method: `network.fault.drop((2, 4), steps=range(50))`."""
        return _Injecting(self)

    def heal(self, number: int | None = None) -> Healed:
        """End a fault, by its number from 1; or every fault that can be ended."""
        answer = self._ask("heal", fault=number)
        return Healed(tuple(answer["faults"]), answer["step"])

    def faults(self) -> dict[int, Fault]:
        """Return the faults of the file and the added ones, by number, with steps of the run."""
        return self._added | dict(enumerate(load(str(self.folder)).faults, start=1))

    def pause(self) -> int:
        """Pause the network after this step."""
        return int(self._ask("pause")["step"])

    def resume(self) -> int:
        """Resume the network."""
        return int(self._ask("resume")["step"])

    def step(self, steps: int = 1) -> int:
        """Make this number of steps, then pause."""
        if steps < 1:
            raise UserError(f"step {steps}: one step is the least", code=Code.OPTION)
        return int(self._ask("step", steps=steps)["step"])

    def rate(self, rate: float) -> int:
        """Set the rate in steps per second; 0 is as fast as possible."""
        if rate < 0:
            raise UserError(f"rate {rate:g}: must not be negative; 0 is as fast as possible", code=Code.OPTION)
        return int(self._ask("rate", rate=rate)["step"])

    def ask_to_stop(self) -> int:
        """Ask the network to end after the current step, and return that step without waiting for the verdict."""
        return int(self._ask("stop")["step"])

    def stop(self, deadline_s: float = END_DEADLINE_S) -> Run:
        """End the run after the current step, wait for its verdict, and return the run. Raises DeadlineError."""
        self.ask_to_stop()
        return self.wait(deadline_s)

    def wait(self, deadline_s: float = WAIT_DEADLINE_S) -> Run:
        """Wait for the end of the run, and return the run. Raises DeadlineError."""
        from hedgerow.orchestrator.runs.reader import load_run  # noqa: PLC0415 (Arrow takes a while to load)

        until = time.monotonic() + deadline_s
        while not self._gone():
            if time.monotonic() > until:
                raise DeadlineError(f"{self.run}: still runs after {deadline_s:g} s")
            time.sleep(_LOOK_EVERY_S)
        return load_run(self.folder)

    def wait_for_step(self, step: int, deadline_s: float = WAIT_DEADLINE_S) -> int:
        """Wait until all steps before `step` are made; return the current step.

        Raise DeadlineError after the deadline, and HedgerowError if the run ends before that step.
        """
        until = time.monotonic() + deadline_s
        last = "its plant does not answer"
        while time.monotonic() < until:
            try:
                status = self.status()
            except WireError:
                gone, done = self._gone(), self._done()
                if done is not None and done >= step:
                    return done
                if gone or done is not None:
                    how = "without a verdict" if done is None else f"at step {done}"
                    raise HedgerowError(f"{self.run}: ended {how}, before step {step}; see {self.folder}") from None
            else:
                if step > status["steps"]:
                    raise UserError(
                        f"{self.run}: has {status['steps']} steps, and never comes to step {step}", code=Code.OPTION
                    )
                if status["step"] >= step:
                    return int(status["step"])
                last = f"it is at {where(status)}"
            time.sleep(_LOOK_EVERY_S)
        raise DeadlineError(f"{self.run}: not at step {step} after {deadline_s:g} s: {last}")

    def _gone(self) -> bool:
        try:
            return bool(psutil.Process(self.entry.pid).status() == psutil.STATUS_ZOMBIE)
        except psutil.NoSuchProcess:
            return True

    def _done(self) -> int | None:
        """Return the number of steps of a finished run, None without a verdict."""
        from hedgerow.orchestrator.runs.files import read_file  # noqa: PLC0415 (Arrow takes a while to load)

        try:
            verdict: dict[str, Any] = loads(self.folder / "verdict.json", read_file(self.folder / "verdict.json"))
        except OSError:
            return None
        return int(verdict["steps_done"])


class _Injecting(FaultVerbs[Injected]):
    def __init__(self, live: Live) -> None:
        self._live = live

    def inject(self, fault: Fault | Mapping[str, Any]) -> Injected:
        return self._live.inject(fault)


def where(status: Mapping[str, Any]) -> str:
    """Return the progress of a network, and the missing processes, in words."""
    text = f"step {status['step']} of {status['steps']}"
    if status["paused"]:
        text += ", paused"
    if status["missing"]:
        text += f", waiting for {', '.join(status['missing'][:8])}"
    if status["lost"]:
        text += f", without {', '.join(status['lost'][:8])}"
    return text
