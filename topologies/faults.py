"""The faults as data: one model per kind of fault, and its effects as plain numbers.

    drop        messages of a link are lost
    delay       messages of a link arrive late
    cut         an edge carries no flow, at both ends
    partition   all links between groups of nodes are dropped, and their edges cut if asked
    sensor      a node's reading of its state is lost
    actuator    a node's input is lost on its way to the plant
    crash       a node's agent, or a process with all its agents, dies, and may come back
    jump        a node's true a becomes another of its candidates

A window of steps includes its first step and excludes its last, as Python's range does. Nodes are named by their ids.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self, cast

import numpy as np
from pydantic import (
    AfterValidator,
    AliasChoices,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    StrictBool,
    StrictInt,
    Tag,
    WithJsonSchema,
    model_validator,
)
from pydantic_core import PydanticCustomError

from hedgerow.topologies.base import Model, NodeId, TrueA, kind_of, number
from hedgerow.topologies.effects import FOREVER, Effect

if TYPE_CHECKING:
    from hedgerow.topologies.graph import Index, Mask
    from hedgerow.topologies.schema import Topology

Shard = Annotated[StrictInt, Field(ge=0, lt=2**31)]
Step = Annotated[StrictInt, Field(ge=0, le=FOREVER)]
Pair = tuple[NodeId, NodeId]
_DIGITS = "(0|[1-9][0-9]{0,18})"


def _step(key: Any) -> Any:
    """Return a step; JSON has text as keys."""
    return int(key) if isinstance(key, str) and re.fullmatch(_DIGITS, key) else key


def _each_once(value: Any) -> Any:
    """Refuse a table that has a step both as a number and as text: one of the two entries would be lost."""
    steps = Counter(map(_step, value)) if isinstance(value, Mapping) else {}
    for step, count in steps.items():
        if count > 1:
            raise PydanticCustomError("twice", "names step {step} twice; keep one of the two", {"step": step})
    return value


def _ends(value: Any) -> Any:
    """Return a Python range of single steps as its two ends."""
    if not isinstance(value, range):
        return value
    if value.step != 1:
        raise PydanticCustomError("range", "a fault holds at every step of its window; use a range with no stride")
    return value.start, value.stop


def _not_empty(window: tuple[int, int]) -> tuple[int, int]:
    if window[0] >= window[1]:
        raise PydanticCustomError("window", "holds no step")
    return window


def _disjoint(groups: tuple[tuple[int | str, ...], ...]) -> tuple[tuple[int | str, ...], ...]:
    seen: set[int | str] = set()
    for node in (node for group in groups for node in group):
        if node in seen:
            raise PydanticCustomError(
                "disjoint", "node {node} is in the groups twice; keep it in one of them", {"node": node}
            )
        seen.add(node)
    return groups


Window = Annotated[
    Annotated[tuple[Step, Step], AfterValidator(_not_empty), BeforeValidator(_ends)] | None,
    Field(description="[from, to): the steps when it is active; all of them if absent"),
]
Probability = Annotated[
    float,
    Field(ge=0, le=1, description="its probability: drawn for each step, and for each message, edge or node"),
    BeforeValidator(number),
]
Table = Annotated[
    dict[
        Annotated[Step, BeforeValidator(_step), WithJsonSchema({"type": "string", "pattern": f"^{_DIGITS}$"})],
        tuple[Pair, ...],
    ],
    Field(min_length=1, json_schema_extra={"additionalProperties": False}),
    BeforeValidator(_each_once),
]
Link = Annotated[Pair | None, Field(description="two neighbours: messages both ways")]
Sender = Annotated[
    NodeId | None,
    Field(
        validation_alias=AliasChoices("from", "from_"),
        serialization_alias="from",
        description="the sender of the affected messages; the receiver is `to`",
    ),
]
Receiver = Annotated[NodeId | None, Field(description="the neighbour that receives the messages")]
Struck = Annotated[NodeId, Field(description="the affected node")]


def _closed(schema: dict[str, Any], model: type[FaultModel]) -> None:
    """Require `kind:` in a file, although Python may omit it, and one of the forms."""
    schema["required"] = ["kind", *schema.get("required", ())]
    if model.FORMS:
        schema["oneOf"] = [{"required": list(form)} for form in model.FORMS]


class FaultModel(Model):
    """The base of all fault models."""

    model_config = ConfigDict(json_schema_extra=cast("Any", _closed))

    FORMS: ClassVar[tuple[tuple[str, ...], ...]] = ()
    """The alternative sets of keys for the target of the fault: exactly one of these sets is given."""

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        given = self.written().keys()
        keys = {key for form in self.FORMS for key in form}
        if self.FORMS and not any(keys & given == set(form) for form in self.FORMS):
            forms = ", or ".join(" with ".join(f"`{key}:`" for key in form) for form in self.FORMS)
            raise PydanticCustomError("form", "takes {forms}; give exactly one of them", {"forms": forms})
        if "at" in keys & given and given & {"steps", "probability"}:
            raise PydanticCustomError("form", "names every step with `at:`; remove `steps:` and `probability:`")
        return self

    def written(self) -> dict[str, Any]:
        """Return the shortest mapping in a file that means this fault."""
        short = self.model_dump(by_alias=True, exclude_none=True, exclude_defaults=True)
        return {"kind": kind_of(self), **short}

    def effects(self, fault: int, at: Places) -> list[Effect]:
        """Return the effects of the fault on the nodes, links and edges that `at` finds; `fault` is its number in the
        list.
        """
        raise NotImplementedError


class Drop(FaultModel):
    """Messages of a link are lost."""

    FORMS = (("link",), ("from", "to"), ("at",))

    kind: Literal["drop"] = "drop"
    link: Link = None
    from_: Sender = None
    to: Receiver = None
    at: Table | None = Field(
        None, description="by step, the pairs [from, to] that lose their message; the only key then"
    )
    steps: Window = None
    probability: Probability = 1.0

    def effects(self, fault: int, at: Places) -> list[Effect]:
        if self.at is not None:
            return [_by_step(fault, self.kind, {step: at.links(pairs) for step, pairs in self.at.items()})]
        links = at.links(_directed(self.link, self.from_, self.to))
        return [Effect(fault, self.kind, links, *_window(self.steps), self.probability)]


class Delay(FaultModel):
    """Messages of a link arrive late."""

    FORMS = (("link",), ("from", "to"))

    kind: Literal["delay"] = "delay"
    link: Link = None
    from_: Sender = None
    to: Receiver = None
    by: Annotated[StrictInt, Field(ge=1, le=10**6)] = Field(description="the delay, in steps")
    steps: Window = None
    probability: Probability = 1.0

    def effects(self, fault: int, at: Places) -> list[Effect]:
        links = at.links(_directed(self.link, self.from_, self.to))
        return [Effect(fault, self.kind, links, *_window(self.steps), self.probability, by=self.by)]


class Cut(FaultModel):
    """An edge carries no flow, at both its ends."""

    FORMS = (("edge",), ("at",))

    kind: Literal["cut"] = "cut"
    edge: Annotated[Pair | None, Field(description="two neighbours")] = None
    at: Table | None = Field(None, description="by step, the edges that are cut; the only key then")
    steps: Window = None
    probability: Probability = 1.0

    def effects(self, fault: int, at: Places) -> list[Effect]:
        if self.at is not None:
            return [_by_step(fault, self.kind, {step: at.edges(pairs) for step, pairs in self.at.items()})]
        edges = at.edges([self.edge] if self.edge else [])
        return [Effect(fault, self.kind, edges, *_window(self.steps), self.probability)]


class Partition(FaultModel):
    """All links between nodes of different groups are dropped."""

    kind: Literal["partition"] = "partition"
    groups: Annotated[
        tuple[Annotated[tuple[NodeId, ...], Field(min_length=1)], ...], Field(min_length=2), AfterValidator(_disjoint)
    ] = Field(description="two lists of nodes or more, without a node in common; other nodes are not affected")
    steps: Window = None
    cut: StrictBool = Field(False, description="true: the edges between the groups are cut too")

    def effects(self, fault: int, at: Places) -> list[Effect]:
        apart = at.apart(self.groups)
        found = [Effect(fault, "drop", _plain(np.flatnonzero(apart)), *_window(self.steps))]
        if self.cut:
            edges = np.unique(at.graph.edge[apart])
            found.append(Effect(fault, "cut", _plain(edges), *_window(self.steps)))
        return found


class Sensor(FaultModel):
    """The reading of a node's state is lost, and the node sends no input."""

    kind: Literal["sensor"] = "sensor"
    node: Struck
    steps: Window = None
    probability: Probability = 1.0

    def effects(self, fault: int, at: Places) -> list[Effect]:
        return [Effect(fault, self.kind, at.nodes([self.node]), *_window(self.steps), self.probability)]


class Actuator(FaultModel):
    """A node's input is lost on its way to the plant."""

    kind: Literal["actuator"] = "actuator"
    node: Struck
    steps: Window = None
    probability: Probability = 1.0

    def effects(self, fault: int, at: Places) -> list[Effect]:
        return [Effect(fault, self.kind, at.nodes([self.node]), *_window(self.steps), self.probability)]


class Crash(FaultModel):
    """A node's agent, or a process with all its agents, dies and forgets everything."""

    FORMS = (("node",), ("process",))

    kind: Literal["crash"] = "crash"
    node: Annotated[NodeId | None, Field(description="the node; only its agent crashes")] = None
    process: Shard | None = Field(None, description="the process to kill, from 0")
    at: Step = Field(description="the first step that it misses")
    restart_after: Annotated[StrictInt, Field(ge=1, le=FOREVER)] | None = Field(
        None, description="the number of steps that it misses; all of them if absent"
    )

    def effects(self, fault: int, at: Places) -> list[Effect]:
        nodes = at.shard(self.process) if self.process is not None else at.nodes([cast("int | str", self.node)])
        stop = FOREVER if self.restart_after is None else min(self.at + self.restart_after, FOREVER)
        return [Effect(fault, self.kind, nodes, self.at, stop)]


class Jump(FaultModel):
    """A node's true a becomes another of its candidates."""

    kind: Literal["jump"] = "jump"
    node: Struck
    at: Step = Field(description="the first step of the new truth")
    a: TrueA = Field(description="the new truth, one of the candidates; or `random`: another candidate, drawn")

    def effects(self, fault: int, at: Places) -> list[Effect]:
        assert isinstance(self.a, float), "resolving draws it"
        return [Effect(fault, self.kind, at.nodes([self.node]), self.at, FOREVER, a=self.a)]


KINDS: dict[str, type[FaultModel]] = {
    model.model_fields["kind"].default: model for model in (Drop, Delay, Cut, Partition, Sensor, Actuator, Crash, Jump)
}
Fault = Annotated[
    Annotated[Drop, Tag("drop")]
    | Annotated[Delay, Tag("delay")]
    | Annotated[Cut, Tag("cut")]
    | Annotated[Partition, Tag("partition")]
    | Annotated[Sensor, Tag("sensor")]
    | Annotated[Actuator, Tag("actuator")]
    | Annotated[Crash, Tag("crash")]
    | Annotated[Jump, Tag("jump")],
    Discriminator(kind_of, custom_error_type="fault", custom_error_message=f"a fault has `kind:` {', '.join(KINDS)}"),
]


def known_keys(model: type[Model]) -> list[str]:
    """Return the keys of a model, as a file spells them."""
    return [field.serialization_alias or field.alias or name for name, field in model.model_fields.items()]


def effects(faults: Sequence[Fault], topology: Topology) -> list[Effect]:
    """Return the effects of `faults` on a resolved topology, in their order; all must obey `hedgerow.topologies.rules`.

    A partition that cuts has two effects, any other fault has one.
    """
    places = Places(topology)
    return [effect for k, fault in enumerate(faults) for effect in fault.effects(k, places)]


class Places:
    """The positions, in the arrays of a run, of the nodes, links and edges that faults name."""

    def __init__(self, topology: Topology) -> None:
        self.graph = topology.graph
        self._topology = topology
        self._position = topology.position
        self._incidence = self.graph.node * self.graph.n + self.graph.neighbour  # ascending, as they are ordered

    def nodes(self, ids: Iterable[int | str]) -> tuple[int, ...]:
        """Return the positions of `ids`, in their order."""
        return tuple(self._position(node) for node in ids)

    def links(self, pairs: Iterable[tuple[int | str, int | str]]) -> tuple[int, ...]:
        """Return, per pair (from, to), the incidence where `to` receives from `from`; each once, ascending."""
        keys = np.unique([self._position(to) * self.graph.n + self._position(sender) for sender, to in pairs])
        found = np.searchsorted(self._incidence, keys)
        if not (self._incidence[np.minimum(found, len(self._incidence) - 1)] == keys).all():
            raise KeyError("rules.py refuses a link that does not exist")
        return _plain(found)

    def edges(self, pairs: Iterable[tuple[int | str, int | str]]) -> tuple[int, ...]:
        """Return the edges between the nodes of each pair; each once, ascending."""
        return _plain(np.unique(self.graph.edge[list(self.links(pairs))]))

    def apart(self, groups: Sequence[Sequence[int | str]]) -> Mask:
        """Return a mask of the incidences with ends in different groups."""
        group = np.full(self.graph.n, -1)
        for k, members in enumerate(groups):
            group[list(self.nodes(members))] = k
        one, other = group[self.graph.node], group[self.graph.neighbour]
        apart: Mask = (one != other) & (one >= 0) & (other >= 0)
        return apart

    def shard(self, process: int) -> tuple[int, ...]:
        """Return the nodes of a process."""
        return _plain(self._topology.parts[process])


def _directed(
    link: tuple[int | str, int | str] | None, sender: int | str | None, to: int | str | None
) -> list[tuple[int | str, int | str]]:
    if link is not None:
        return [link, link[::-1]]
    assert sender is not None
    assert to is not None
    return [(sender, to)]


def _window(steps: tuple[int, int] | None) -> tuple[int, int]:
    return (0, FOREVER) if steps is None else steps


def _by_step(fault: int, kind: str, table: Mapping[int, Sequence[int]]) -> Effect:
    return Effect(fault, kind, (), min(table), max(table) + 1, table=dict(sorted(table.items())))


def _plain(found: Index) -> tuple[int, ...]:
    return tuple(found.tolist())
