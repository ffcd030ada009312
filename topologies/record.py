"""The part of a run that is recorded, as a topology file gives it."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, Field, StrictBool, StrictInt, Tag
from pydantic_core import PydanticCustomError

from hedgerow.topologies.base import Model, NodeId, Steps

EVERY_NODE = "all"
WHOLE = 10_000
"""Up to this number of nodes, all nodes have rows by default."""
SAMPLED = 1_000
"""The number of nodes with rows in a larger network."""


def _all_nodes(value: Any) -> Any:
    if isinstance(value, str) and value != EVERY_NODE:
        raise PydanticCustomError("recorded", "is neither `all`, nor how many, nor a list of node ids")
    return value


class Record(Model):
    """The nodes with rows in telemetry; metrics, checks and the verdict always cover all nodes and steps."""

    every: Steps = Field(1, description="N: nodes and edges have rows at every Nth step, and at the last")
    nodes: (
        Annotated[
            Annotated[Annotated[StrictInt, Field(ge=0)], Tag("number")]
            | Annotated[tuple[NodeId, ...], Tag("list")]
            | Annotated[Literal["all"], Tag("word")],
            Discriminator(
                lambda value: (
                    "word" if isinstance(value, str) else "list" if isinstance(value, list | tuple) else "number"
                )
            ),
            BeforeValidator(_all_nodes),
        ]
        | None
    ) = Field(
        None,
        description="the nodes that have rows, with their edges: a list of ids; a number, evenly spread over the order"
        " of the file; or `all`. If absent, all of up to 10,000 nodes, and 1000 of more",
    )
    summary: StrictBool = Field(True, description="one row per step with the facts of the whole network")
