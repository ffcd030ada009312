"""Changes to agents, plant and network that a verdict must find, and the table of its results.

python -m tests.tools.tampering --write     # the table of docs/reliability.md
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from hedgerow.agents.law import Array, Minimax
from hedgerow.agents.shard import Shard
from hedgerow.agents.view import View
from hedgerow.orchestrator.ground.assignment import layout, truth_of, views_of
from hedgerow.orchestrator.metrics.observer import Observer
from hedgerow.orchestrator.metrics.replay import Replay
from hedgerow.orchestrator.metrics.verdict import Ending, Verdict, judge
from hedgerow.orchestrator.runs import reference
from hedgerow.plant.truth import Truth
from hedgerow.plant.world import World
from hedgerow.topologies.schema import Topology
from hedgerow.wire.message import End, Telemetry
from tests.tools import tampered_agents as agents
from tests.tools import tampered_plant as plant
from tests.tools.networks import Trajectory, gathered
from tests.tools.watched_network import FORGETFUL, NODE, SILENT, UNLEARNING, WATCHED

PAGE = Path(__file__).parents[2] / "docs" / "reliability.md"


BEGIN, STOP = "<!-- tampering table: python -m tests.tools.tampering --write -->", "<!-- end of tampering table -->"


Rows = Callable[[list[Telemetry], End], tuple[list[Telemetry], End | None]]


@dataclass(frozen=True)
class Tampering:
    """One change, and where it is made."""

    name: str
    where: str
    law: type[Minimax] | None = None
    """the law of the changed agent"""
    shard: type[Shard] | None = None
    """the changed agent without its law"""
    world: Callable[[Truth], World] | None = None
    rows: Rows | None = None
    """the telemetry that arrives instead of the sent one"""
    topology: Topology = WATCHED

    def run(self) -> Trajectory:
        """The telemetry that the plant sends."""
        topology = self.topology
        shards = layout(topology, None)
        views = views_of(topology, shards)
        if self.law is not None:
            k = topology.position(NODE)
            views[k] = replace(views[k], law=f"{self.law.__module__}:{self.law.__name__}")
        changed = self.shard or Shard

        def shard(view: View, law: None) -> Shard:
            return (changed if view.ids[0] == NODE else Shard)(view)

        with mock.patch.multiple(reference, World=self.world or World, Shard=shard), np.errstate(all="ignore"):
            return gathered(reference.run(truth_of(topology, shards), views))

    def verdict(self) -> Verdict:
        """Return the verdict of such a run."""
        ran = self.run()
        rows, end = (ran.rows, ran.end) if self.rows is None else self.rows(list(ran.rows), ran.end)
        return verdict(self.topology, rows, end)


def verdict(topology: Topology, rows: Sequence[Telemetry], end: End | None) -> Verdict:
    """Return the verdict of an observer and a replay of these rows."""
    observer, replay = Observer(topology), Replay(topology)
    for row in rows:
        with np.errstate(all="ignore"):
            observer.take([row])
        replay.take([row])
    if end is not None:
        observer.finish(end)
    return judge(topology, observer, Ending("run", "in-process", 0, replay=replay))


def _row(rows: list[Telemetry], t: int, **columns: Any) -> list[Telemetry]:
    return [row._replace(**columns) if row.t == t else row for row in rows]


def _ulp(values: Array) -> Array:
    return np.where(np.arange(len(values)) == NODE - 1, np.nextafter(values, np.inf), values)


def twice(rows: list[Telemetry], end: End) -> tuple[list[Telemetry], End | None]:
    """One row comes twice."""
    return [*rows[:12], rows[11], *rows[12:]], end


def swapped(rows: list[Telemetry], end: End) -> tuple[list[Telemetry], End | None]:
    """Two rows change places."""
    return [*rows[:11], rows[12], rows[11], *rows[13:]], end


def lost(rows: list[Telemetry], end: End) -> tuple[list[Telemetry], End | None]:
    """One row is lost."""
    return [*rows[:11], *rows[12:]], end


def no_end(rows: list[Telemetry], end: End) -> tuple[list[Telemetry], End | None]:
    """The final state is lost."""
    return rows, None


def other_state(rows: list[Telemetry], end: End) -> tuple[list[Telemetry], End | None]:
    """One state is the next float."""
    return _row(rows, 11, x=_ulp(rows[11].x)), end


def other_input(rows: list[Telemetry], end: End) -> tuple[list[Telemetry], End | None]:
    """One input is the next float."""
    return _row(rows, 11, u=_ulp(rows[11].u)), end


def other_end(rows: list[Telemetry], end: End) -> tuple[list[Telemetry], End | None]:
    """One node of the final state is the next float."""
    return rows, end._replace(x=_ulp(end.x))


def _all() -> Iterable[Tampering]:
    for law in (
        agents.SecondBest,
        agents.NeverLearns,
        agents.LearnsTwice,
        agents.NoFlow,
        agents.LastOfTies,
        agents.OtherCandidates,
        agents.HalfState,
        agents.OneUlpInput,
        agents.ForgedEstimate,
        agents.ForgedMargin,
    ):
        yield Tampering(_change(law), "agent", law=law)
    for shard in (
        agents.ZeroForMissing,
        agents.HeldForMissing,
        agents.NoBackfill,
        agents.ActsBlind,
        agents.ForgedReceipt,
        agents.DeniedReceipt,
    ):
        yield Tampering(_change(shard), "agent", shard=shard)
    yield Tampering(_change(agents.BackfillReversed), "agent", shard=agents.BackfillReversed, topology=SILENT)
    yield Tampering(_change(agents.KeepsMemory), "agent", shard=agents.KeepsMemory, topology=FORGETFUL)
    for world in (
        plant.StartOff,
        plant.LargerW,
        plant.OtherSeed,
        plant.LateW,
        plant.OneUlpMotion,
        plant.OtherA,
        plant.OtherB,
        plant.ShorterDelay,
        plant.LongerCrash,
        plant.LateJump,
        plant.OtherLots,
        plant.OneSidedCut,
        plant.HeldInput,
        plant.EdgeReportedOpen,
        plant.ShortHistory,
    ):
        yield Tampering(_change(world), "plant", world=world)
    for kind in ("delay", "drop", "cut", "sensor", "actuator", "crash", "jump"):
        yield Tampering(f"Leaves out the {kind} faults", "plant", world=functools.partial(plant.Without, kind))
    for topology in UNLEARNING:
        yield Tampering(
            f"{_change(plant.ShorterDelay)}, law `{topology.law}`", "plant", world=plant.ShorterDelay, topology=topology
        )
    for mail in (agents.MessageLost, agents.MessageChanged, agents.MessageTwice, agents.MessagesLate):
        yield Tampering(_change(mail), "wire", shard=mail)
    for rows in (twice, swapped, lost, no_end, other_state, other_input, other_end):
        yield Tampering(_change(rows), "wire", rows=rows)


def _change(what: Any) -> str:
    return str(what.__doc__).strip().rstrip(".")


ALL = list(_all())


def row(tampering: Tampering) -> list[str]:
    """Return the row of the table: place, change, verdict, the first failed check, and its step and node."""
    content = tampering.verdict().content
    failed = {name: check for name, check in content["checks"].items() if not check["ok"]}
    named = [(name, check) for name, check in failed.items() if check.get("node") is not None]
    name, check = next(iter(named or failed.items()), ("", dict[str, Any]()))
    first = content["reasons"][0] if content["reasons"] and not failed else ""
    step, node = check.get("step"), check.get("node")
    equal = content["verdict"] == "valid" and tampering.run().same_bits(
        Tampering("", "", topology=tampering.topology).run()
    )
    verdict_ = "valid, equal to the bit" if equal else content["verdict"]
    return [
        tampering.where,
        tampering.name,
        verdict_,
        f"`{name}`" if name else first,
        "" if step is None else str(step),
        "" if node is None else str(node),
    ]


def table() -> list[str]:
    """The lines of the table."""
    head = ["where", "change", "verdict", "check", "step", "node"]
    lines = [head, ["---"] * len(head), *(row(one) for one in ALL)]
    return [f"| {' | '.join(line)} |" for line in lines]


def written() -> list[str]:
    """The table as the page has it."""
    return PAGE.read_text(encoding="utf-8").partition(BEGIN)[2].partition(STOP)[0].strip().splitlines()


if __name__ == "__main__":
    from tests.tools.tampering import PAGE, table  # the laws are loaded by the name of this module

    lines = "\n".join(table())
    print(lines)
    if "--write" in sys.argv:
        text = PAGE.read_text(encoding="utf-8")
        before, _, rest = text.partition(BEGIN)
        PAGE.write_text(f"{before}{BEGIN}\n{lines}\n{STOP}{rest.partition(STOP)[2]}", encoding="utf-8")
