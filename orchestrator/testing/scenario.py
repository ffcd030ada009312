"""A network with its faults before it runs: immutable, so tests may share it."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from hedgerow.orchestrator.ground import laws
from hedgerow.orchestrator.ground.assignment import layout, truth_of, views_of
from hedgerow.orchestrator.launch.fault_verbs import FaultVerbs
from hedgerow.orchestrator.launch.live import checked
from hedgerow.orchestrator.launch.recording import Recording
from hedgerow.orchestrator.launch.running import Running, run_to_the_end
from hedgerow.orchestrator.launch.watching import Watching
from hedgerow.orchestrator.metrics.verdict import INVALID, VALID, Ending
from hedgerow.orchestrator.runs import reference
from hedgerow.orchestrator.runs.folder import create
from hedgerow.orchestrator.runs.reader import load_run
from hedgerow.orchestrator.runs.run import Run
from hedgerow.topologies.errors import Code, HedgerowError, UserError
from hedgerow.topologies.faults import Fault
from hedgerow.topologies.named import Given, Named
from hedgerow.topologies.named import given as as_given
from hedgerow.topologies.record import Record
from hedgerow.topologies.resolve import resolve
from hedgerow.topologies.schema import Topology
from hedgerow.wire import crash
from hedgerow.wire.message import End, Telemetry

RUN_DEADLINE_S = 120.0
LIVE_STEPS = 1_000_000
_OPTIONS = ("--viewer", "none", "--no-record")


class VerdictError(HedgerowError):
    """A run of a test that is not valid."""

    default_code = Code.VERDICT

    def __init__(self, run: Run, cure: str) -> None:
        """`run` is the run, and `cure` what to do."""
        reasons = "; ".join(run.verdict.content["reasons"])
        super().__init__(f"run {run.folder.name} is {run.verdict.verdict}: {reasons}. {cure}")
        self.run = run


@dataclass(frozen=True)
class Scenario(FaultVerbs["Scenario"]):
    """A network with its settings and faults; each method returns a new one, and nothing runs until `run` or `up`.

    Steps of faults are steps of the run. A mistake that a file would be refused for raises UserError at once.
    """

    given: Given
    """the network with its settings, before its numbers are drawn"""
    new_folder: Callable[[str], Path] = field(repr=False, compare=False)
    """makes an empty folder for a run with a similar name"""
    on_result: Callable[[Run], None] = field(repr=False, compare=False, default=lambda _: None)
    """called with every result"""
    faults: tuple[Fault, ...] = ()

    @cached_property
    def topology(self) -> Topology:
        """Return the resolved network, with all rows recorded."""
        with crash.reported():
            read = self.given.parse()
            drawn = resolve(read.model_copy(update={"record": Record(nodes="all")}), self.given.folder)
            return laws.checked(resolve(drawn.model_copy(update={"faults": (*drawn.faults, *self.faults)})))

    def set(self, *settings: str) -> Scenario:
        """Return a copy with values of the file replaced: `path=value`, as for `--set` on the command line."""
        return _now(replace(self, given=self.given.with_overrides(*settings)))

    def inject(self, fault: Fault | Mapping[str, Any]) -> Scenario:
        """Return a copy with one more fault: a model of `hedgerow.topologies.faults`, or a mapping as a file spells
        it.
        """
        return replace(self, faults=(*self.faults, checked(fault, self.topology)))

    def run(
        self,
        steps: int | None = None,
        processes: int | None = None,
        engine: Literal["in-process", "zenoh"] = "in-process",
        seed: int | None = None,
        deadline_s: float = RUN_DEADLINE_S,
        check: bool = True,
    ) -> Run:
        """Run to the last step, and return the run; steps, processes and seed replace those of the file.

        engine: `in-process` is the reference, without processes, and takes milliseconds; `zenoh` is `orchestrator up`,
        with processes. Both give the same bits. Raise DeadlineError after `deadline_s`, which is for zenoh.

        check: raise VerdictError if the run is not valid; a fault that could not strike is one reason.
        """
        scenario = self._with(steps=steps, processes=processes, seed=seed)
        folder = self.new_folder(scenario.topology.name)
        match engine:
            case "in-process":
                with crash.reported():
                    result = _run_here(scenario.topology, folder)
            case "zenoh":
                with crash.reported():
                    result = run_to_the_end(scenario.topology, folder, *_OPTIONS, deadline_s=deadline_s, listed=False)
            case _:
                raise UserError(f"engine={engine!r}: is neither 'in-process' nor 'zenoh'", code=Code.OPTION)
        self.on_result(result)
        if check and result.verdict.verdict != VALID:
            raise VerdictError(result, "Correct the cause, or write run(check=False).")
        return result

    def up(
        self,
        rate: float = 0.0,
        steps: int | None = LIVE_STEPS,
        processes: int | None = None,
        seed: int | None = None,
        step_deadline_s: float = 10.0,
    ) -> Running:
        """Launch it as `orchestrator up` does, for a `with` block; the network ends with the block, for any reason.

        rate: steps per second, 0 for as fast as possible. steps: far more than a test waits for; None for the number in
        the file. step_deadline_s: the time that the plant waits for an answer, `up --deadline`.
        """
        scenario = self._with(steps=steps, processes=processes, seed=seed)
        folder = self.new_folder(scenario.topology.name)
        options = (*_OPTIONS, "--rate", str(rate), "--deadline", str(step_deadline_s))
        return Running(scenario.topology, folder, *options, listed=False, on_run=self._take)

    def _take(self, result: Run) -> None:
        self.on_result(result)
        if result.verdict.verdict == INVALID:
            raise VerdictError(result, "Correct the cause.")

    def _with(self, **settings: int | None) -> Scenario:
        given = [f"{key}={value}" for key, value in settings.items() if value is not None]
        return self.set(*given) if given else self


def _now(scenario: Scenario) -> Scenario:
    """Return the scenario after a check, so a mistake is reported at its own line."""
    _ = scenario.topology
    return scenario


def _run_here(topology: Topology, path: Path) -> Run:
    """Run as `orchestrator simulate` does, but pass Ctrl-C and errors of a law to the test."""
    folder = create(topology, path)
    ending = Ending(run=folder.name, engine="in-process", processes=0)
    run = Recording(topology, folder, Watching(record=False), ending)
    folder.event("start", engine=ending.engine)
    run.tell_faults()
    shards = layout(topology, topology.processes if isinstance(topology.processes, int) else 1)
    rows = reference.run(truth_of(topology, shards), views_of(topology, shards))
    for batch in _batches(rows, run.rows_at_once):
        if steps := [row for row in batch if isinstance(row, Telemetry)]:
            run.take(steps)
        if isinstance(batch[-1], End):
            run.finish(batch[-1])
    run.close()
    return load_run(path)


def _batches(rows: Iterator[Telemetry | End], size: int) -> Iterator[list[Telemetry | End]]:
    while batch := list(itertools.islice(rows, size)):
        yield batch


@dataclass(frozen=True)
class Networks:
    """The fixture `network`: a call with a network returns a Scenario."""

    new_folder: Callable[[str], Path] = field(repr=False)
    on_result: Callable[[Run], None] = field(repr=False, default=lambda _: None)

    def __call__(self, network: Named, *settings: str) -> Scenario:
        """Return a scenario of a network: a bundled name, a file, a run folder, a Topology, a dictionary, or a file's
        text.

        settings: `path=value`, as for `--set` on the command line. Raise UserError for a mistake.
        """
        return _now(Scenario(as_given(network).with_overrides(*settings), self.new_folder, self.on_result))
