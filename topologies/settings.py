"""The settings of a node, the defaults of all nodes, and random candidates."""

from __future__ import annotations

from typing import Annotated, ClassVar

from pydantic import Field, StrictInt, Tag

from hedgerow.topologies.base import Label, Model, Number, TrueA
from hedgerow.topologies.disturbances import Disturbance, Nothing, Value, mapping_or
from hedgerow.topologies.edges import PositiveValue


class Drawn(Model):
    """Random candidates: this many, drawn uniformly from the interval that condition (3) allows."""

    random: Annotated[StrictInt, Field(ge=1, le=1000)] = Field(description="the number of candidates, the paper's M")


Candidates = Annotated[
    Annotated[Annotated[tuple[Number, ...], Field(min_length=1)], Tag("list")] | Annotated[Drawn, Tag("random")],
    mapping_or("list"),
]


class Settings(Model):
    """The settings of a node."""

    b: PositiveValue | None = Field(
        None, description="the input gain b_i of (1), the network's `b` if absent; or `{random: [low, high]}`"
    )
    a: TrueA | None = Field(
        None,
        description="the true a_i of (1), one of the candidates; or `random`: one of them, drawn",
    )
    candidates: Candidates | None = Field(
        None,
        description="the finite set A_i of (4), in the order that breaks ties; or `{random: M}`",
    )
    x0: Value | None = Field(None, description="the state at t = 0")
    nominal: Number | None = Field(None, description="the a that the nominal controller assumes")
    disturbance: Disturbance | None = Field(None, description="w_i; a list is summed")


class Node(Settings):
    """The settings of one node that override the defaults; in a resolved file, all of its settings."""

    label: Label | None = Field(None, description="a text that is shown beside the id")
    position: tuple[Number, Number] | None = Field(None, description="[x, y]: the place of the node in pictures")


class Defaults(Settings):
    """The settings of every node without its own value."""

    FALLBACK: ClassVar[Settings] = Settings(
        a="random", candidates=Drawn(random=5), x0=0.0, nominal=0.5, disturbance=Nothing()
    )
