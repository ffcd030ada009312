"""The end of a run over Zenoh: the fates of its processes, and why it ended."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from hedgerow.orchestrator.ground.assignment import Layout
from hedgerow.orchestrator.launch.launching import Launched
from hedgerow.orchestrator.launch.recording import Recording
from hedgerow.orchestrator.launch.supervisor import Dead, cause
from hedgerow.orchestrator.metrics.deaths import survivors
from hedgerow.orchestrator.metrics.verdict import Ending
from hedgerow.orchestrator.runs.folder import RunFolder
from hedgerow.topologies.errors import Exit
from hedgerow.wire.child import USER_ERROR


class Fates(NamedTuple):
    """The processes of a run that ended unplanned."""

    dead: Sequence[Dead] = ()
    """those that ended the run"""
    down: Sequence[Dead] = ()
    """agents that stayed down while the run continued"""
    slow_law: str = ""
    """the law that an agent was busy with at the end"""


def fates(launched: Launched, run: Recording, shards: Layout, ending: Ending) -> Fates:
    """Return how the processes of a run ended, and record it in `ending`."""
    processes, fleet, step = launched.processes, launched.fleet, run.observer.next_step
    dead = processes.dead()
    ending.mistaken = any(one.code == USER_ERROR for one in dead)
    ending.restarts = processes.restarts + (0 if fleet is None else fleet.restarts)
    ending.down = [*map(str, processes.down), *([] if fleet is None else fleet.down)]
    ending.survivors = survivors(run.topology, shards, processes.deaths, ending.losses, step)
    return Fates(dead, processes.down, processes.slow_law(step))


def explain(found: Fates | None, run: Recording, folder: RunFolder, ending: Ending) -> None:
    """Record in `ending` why the run ended before its last step, if it did; `found` is None if nothing was launched."""
    found = found or Fates()
    done = run.observer.end.t if run.observer.end is not None else run.observer.next_step
    if found.dead:
        folder.event("processes_died", processes=[str(one) for one in found.dead])
    ending.crashed |= any(one.code == Exit.CRASH for one in [*found.dead, *found.down])
    if done < run.topology.steps:
        reason = ending.stopped or (cause(found.dead) if found.dead else "stopped on request")
        if found.slow_law and "no input from" in reason:
            reason += f"; {found.slow_law}"
        ending.stopped = f"stopped at step {done}: {reason}"
