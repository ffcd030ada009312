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
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self, cast

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
from hedgerow.topologies.fault_kinds import FAULT_KINDS, Pair, Places

if TYPE_CHECKING:
    from hedgerow.topologies.schema import Topology

Shard = Annotated[StrictInt, Field(ge=0, lt=2**31)]
Step = Annotated[StrictInt, Field(ge=0, le=FOREVER)]
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
    if forms := model.forms():
        schema["oneOf"] = [{"required": list(form)} for form in forms]


class FaultModel(Model):
    """The base of all fault models."""

    model_config = ConfigDict(json_schema_extra=cast("Any", _closed))

    LOSSY: ClassVar[bool] = True
    """True if a reading, a message, an input or a flow can be missing."""

    @property
    def window(self) -> tuple[int, int]:
        """Return the first step of the fault, and the first step after it."""
        if isinstance(table := getattr(self, "at", None), Mapping):
            return min(table), max(table) + 1
        steps: tuple[int, int] | None = getattr(self, "steps", None)
        return steps or (0, FOREVER)

    @property
    def struck(self) -> str:
        """Return the targets in words."""
        if isinstance(table := getattr(self, "at", None), Mapping):
            return f"of {sum(map(len, table.values()))} by a table"
        pair = getattr(self, "link", None) or getattr(self, "edge", None)
        return f"{pair[0]}-{pair[1]}" if pair else str(getattr(self, "node", ""))

    @classmethod
    def forms(cls) -> tuple[tuple[str, ...], ...]:
        """Return the alternative sets of keys for the target, of which exactly one is given; empty for a single set."""
        forms = FAULT_KINDS[cls.model_fields["kind"].default].forms
        return forms if len(forms) > 1 else ()

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        given = self.written().keys()
        forms = self.forms()
        keys = {key for form in forms for key in form}
        if forms and not any(keys & given == set(form) for form in forms):
            shown = ", or ".join(" with ".join(f"`{key}:`" for key in form) for form in forms)
            raise PydanticCustomError("form", "takes {forms}; give exactly one of them", {"forms": shown})
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
        kind = type(self).model_fields["kind"].default
        return FAULT_KINDS[kind].effects(kind, dict(self), fault, at)


class Drop(FaultModel):
    """Messages of a link are lost."""

    kind: Literal["drop"] = "drop"
    link: Link = None
    from_: Sender = None
    to: Receiver = None
    at: Table | None = Field(
        None, description="by step, the pairs [from, to] that lose their message; the only key then"
    )
    steps: Window = None
    probability: Probability = 1.0

    @property
    def struck(self) -> str:
        return f"{self.from_}->{self.to}" if self.from_ is not None else super().struck


class Delay(FaultModel):
    """Messages of a link arrive late."""

    kind: Literal["delay"] = "delay"
    link: Link = None
    from_: Sender = None
    to: Receiver = None
    by: Annotated[StrictInt, Field(ge=1, le=10**6)] = Field(description="the delay, in steps")
    steps: Window = None
    probability: Probability = 1.0

    @property
    def struck(self) -> str:
        link = f"{self.from_}->{self.to}" if self.from_ is not None else super().struck
        return f"{link} by {self.by}"


class Cut(FaultModel):
    """An edge carries no flow, at both its ends."""

    kind: Literal["cut"] = "cut"
    edge: Annotated[Pair | None, Field(description="two neighbours")] = None
    at: Table | None = Field(None, description="by step, the edges that are cut; the only key then")
    steps: Window = None
    probability: Probability = 1.0


class Partition(FaultModel):
    """All links between nodes of different groups are dropped."""

    kind: Literal["partition"] = "partition"
    groups: Annotated[
        tuple[Annotated[tuple[NodeId, ...], Field(min_length=1)], ...], Field(min_length=2), AfterValidator(_disjoint)
    ] = Field(description="two lists of nodes or more, without a node in common; other nodes are not affected")
    steps: Window = None
    cut: StrictBool = Field(False, description="true: the edges between the groups are cut too")

    @property
    def struck(self) -> str:
        return "/".join(",".join(map(str, group)) for group in self.groups) + (" with its edges" if self.cut else "")


class Sensor(FaultModel):
    """The reading of a node's state is lost, and the node sends no input."""

    kind: Literal["sensor"] = "sensor"
    node: Struck
    steps: Window = None
    probability: Probability = 1.0


class Actuator(FaultModel):
    """A node's input is lost on its way to the plant."""

    kind: Literal["actuator"] = "actuator"
    node: Struck
    steps: Window = None
    probability: Probability = 1.0


class Crash(FaultModel):
    """A node's agent, or a process with all its agents, dies and forgets everything."""

    kind: Literal["crash"] = "crash"
    node: Annotated[NodeId | None, Field(description="the node; only its agent crashes")] = None
    process: Shard | None = Field(None, description="the process to kill, from 0")
    at: Step = Field(description="the first step that it misses")
    restart_after: Annotated[StrictInt, Field(ge=1, le=FOREVER)] | None = Field(
        None, description="the number of steps that it misses; all of them if absent"
    )

    @property
    def window(self) -> tuple[int, int]:
        return self.at, FOREVER if self.restart_after is None else self.at + self.restart_after

    @property
    def struck(self) -> str:
        return super().struck if self.process is None else f"process {self.process}"


class Jump(FaultModel):
    """A node's true a becomes another of its candidates."""

    LOSSY = False

    kind: Literal["jump"] = "jump"
    node: Struck
    at: Step = Field(description="the first step of the new truth")
    a: TrueA = Field(description="the new truth, one of the candidates; or `random`: another candidate, drawn")

    @property
    def window(self) -> tuple[int, int]:
        return self.at, FOREVER

    @property
    def struck(self) -> str:
        return f"{self.node} to {self.a}"


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
    places = Places(topology.graph, topology.position, lambda: topology.parts)
    return [effect for k, fault in enumerate(faults) for effect in fault.effects(k, places)]
