"""Every kind of fault as a typed method, for running networks and for scenarios of tests.

The command line makes its commands from these methods, so this module loads nothing large.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from hedgerow.topologies.errors import Code, UserError

if TYPE_CHECKING:
    from hedgerow.topologies.faults import Fault

NodeId = int | str
Pair = tuple[NodeId, NodeId]
Steps = range | tuple[int, int] | None
T_co = TypeVar("T_co", covariant=True)


class FaultVerbs(ABC, Generic[T_co]):
    """Every kind of fault as a method; `steps` is a range or (from, to), and every step if omitted."""

    @abstractmethod
    def inject(self, fault: Fault | Mapping[str, Any]) -> T_co:
        """Add any fault: a model of `hedgerow.topologies.faults`, or a mapping as in a file."""

    def _inject(self, kind: str, **keys: Any) -> T_co:
        return self.inject({"kind": kind} | {key: value for key, value in keys.items() if value is not None})

    def drop(
        self,
        link: Pair | None = None,
        *,
        steps: Steps = None,
        one_way: bool = False,
        probability: float | None = None,
        at: Mapping[int, Sequence[Pair]] | None = None,
    ) -> T_co:
        """Lose the messages of a link; with `one_way`, only those from the first node to the second.

        `at` alone lists, by step, the pairs (from, to) that lose their message.
        """
        return self._inject("drop", **_ends(link, one_way), steps=window_of(steps), probability=probability, at=at)

    def delay(
        self,
        link: Pair,
        *,
        by: int,
        steps: Steps = None,
        one_way: bool = False,
        probability: float | None = None,
    ) -> T_co:
        """Delay the messages of a link by `by` steps; `one_way` as for `drop`."""
        return self._inject("delay", **_ends(link, one_way), by=by, steps=window_of(steps), probability=probability)

    def cut(
        self,
        edge: Pair | None = None,
        *,
        steps: Steps = None,
        probability: float | None = None,
        at: Mapping[int, Sequence[Pair]] | None = None,
    ) -> T_co:
        """Close an edge at both its ends; `at` alone lists the edges by step."""
        return self._inject("cut", edge=edge, steps=window_of(steps), probability=probability, at=at)

    def partition(self, *groups: Sequence[NodeId], steps: Steps = None, cut: bool = False) -> T_co:
        """Lose all messages between groups of nodes; `cut` also closes the edges between them."""
        return self._inject("partition", groups=groups, steps=window_of(steps), cut=cut)

    def sensor(self, node: NodeId, *, steps: Steps = None, probability: float | None = None) -> T_co:
        """Lose the readings of a node's state; the node then sends no input."""
        return self._inject("sensor", node=node, steps=window_of(steps), probability=probability)

    def actuator(self, node: NodeId, *, steps: Steps = None, probability: float | None = None) -> T_co:
        """Lose the inputs of a node on their way to the plant."""
        return self._inject("actuator", node=node, steps=window_of(steps), probability=probability)

    def crash(
        self,
        node: NodeId | None = None,
        *,
        process: int | None = None,
        at: int = 0,
        restart_after: int | None = None,
    ) -> T_co:
        """Kill the agent of a node, or a whole process of agents; restart it `restart_after` steps later, or never."""
        return self._inject("crash", node=node, process=process, at=at, restart_after=restart_after)

    def jump(self, node: NodeId, *, to: float, at: int = 0) -> T_co:
        """Change the true a of a node to another of its candidates."""
        try:
            return self._inject("jump", node=node, at=at, a=to)
        except UserError as error:  # a file names this argument `a`
            error.args = tuple(
                one.replace("jump: a: ", "jump: to: ") if isinstance(one, str) else one for one in error.args
            )
            raise


VERBS = tuple(name for name in vars(FaultVerbs) if not name.startswith("_") and name != "inject")
"""The kinds of faults, which are the names of the methods."""


def _ends(link: Pair | None, one_way: bool) -> dict[str, Any]:
    if link is None or not one_way:
        return {"link": link}
    return {"from": link[0], "to": link[1]}


def window_of(steps: Steps) -> tuple[int, int] | None:
    """Return a window of steps as a pair (from, to). Raises UserError for a range with a stride."""
    if isinstance(steps, range):
        if steps.step != 1:
            raise UserError(
                f"steps={steps}: a fault holds at every step of its window; use a range with no stride", code=Code.FAULT
            )
        return steps.start, steps.stop
    return steps
