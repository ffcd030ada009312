"""The deaths of agent processes, as the system reports them, compared with the crash faults that cause them."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from hedgerow.orchestrator.ground.assignment import Layout
from hedgerow.topologies.effects import Effect
from hedgerow.topologies.faults import effects
from hedgerow.topologies.schema import Topology

CLAIM = "an agent process ends if faults crash all of its nodes, as the operating system reports"


@dataclass(frozen=True)
class Survivor:
    """A process that should have ended, but did not."""

    node: int | str
    """the id of its first node"""
    step: int
    """the first crash without a death"""
    ended: int
    due: int

    def __str__(self) -> str:
        return f"the process of node {self.node} ended {self.ended} times, and its crash faults end it {self.due} times"


def survivors(
    topology: Topology, shards: Layout, ended: Mapping[int, int], losses: Collection[int], steps: int
) -> list[Survivor]:
    """Return the processes that ended less often than the faults of the first `steps` steps require.

    `ended` counts the deaths of each supervised shard. `losses` are the numbers, from 0, of the crash faults that only
    record a lost agent: such an agent may be silent and alive.
    """
    crashes = [one for one in effects(topology.faults, topology) if one.removes_agents]
    if not crashes:
        return []
    home = {k: p for p in ended for k in map(int, shards[p])}
    of_shard: dict[int, list[Effect]] = {}
    for one in crashes:
        for p in {home[k] for k in one.targets if k in home}:
            of_shard.setdefault(p, []).append(one)
    found = []
    for p, own in sorted(of_shard.items()):
        nodes = set(map(int, shards[p]))
        planned = [one for one in own if one.fault not in losses]
        begun = [t for t in _begun(nodes, own, steps) if _all_gone(nodes, planned, t)]
        due = len(begun) - (len(own) - len(planned))
        if ended[p] < due:
            node = topology.ids[min(nodes)]
            found.append(Survivor(node, begun[ended[p]], ended[p], due))
    return found


def _begun(nodes: set[int], crashes: Sequence[Effect], steps: int) -> list[int]:
    """Return the steps before `steps` at which the last present node of the set crashes."""
    turns = sorted({one.start for one in crashes if one.start < min(one.stop, steps)})
    return [t for t in turns if _all_gone(nodes, crashes, t) and not _all_gone(nodes, crashes, t - 1)]


def _all_gone(nodes: set[int], crashes: Sequence[Effect], t: int) -> bool:
    gone = {k for one in crashes if one.start <= t < one.stop for k in one.targets}
    return nodes <= gone
