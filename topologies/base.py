"""The base of all models of a topology file: a frozen model, numbers, names and node ids."""

from __future__ import annotations

import math
import re
from typing import Annotated, Any, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    StrictInt,
    Tag,
    WithJsonSchema,
    model_validator,
)
from pydantic_core import PydanticCustomError

from hedgerow.topologies.graph import LARGEST


class Model(BaseModel):
    """A frozen model that refuses unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def number(value: Any) -> Any:
    """Return an int or a float as it is; refuse text and booleans."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise PydanticCustomError("number", "expects a number")
    if math.inf > abs(value) > LARGEST:
        raise PydanticCustomError("huge", f"is beyond {LARGEST:g}")
    return value


_NAME = r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}"


def _one_line_name(value: str) -> str:
    if not re.fullmatch(_NAME, value):
        raise PydanticCustomError(
            "name",
            "a name has 1 to 64 letters, digits, '_', '-' or '.', and starts with no '-' or '.'",
        )
    return value


Number = Annotated[float, BeforeValidator(number)]
NonNegative = Annotated[float, Field(ge=0), BeforeValidator(number)]
Positive = Annotated[float, Field(gt=0, lt=LARGEST), BeforeValidator(number)]
Steps = Annotated[StrictInt, Field(ge=1, le=2**40)]
Seed = Annotated[StrictInt, Field(ge=0, lt=2**63)]


def _printable(value: str) -> str:
    if not value.isprintable():
        raise PydanticCustomError("label", "a label has printable characters only")
    return value


Label = Annotated[str, Field(min_length=1, max_length=200), AfterValidator(_printable)]
Name = Annotated[
    str, AfterValidator(_one_line_name), WithJsonSchema({"type": "string", "pattern": f"^{_NAME}$"}, mode="validation")
]


class Uniform(Model):
    """A random number: drawn uniformly from [low, high)."""

    random: tuple[Number, Number] = Field(description="[low, high]")

    @model_validator(mode="after")
    def _not_empty(self) -> Self:
        if self.low > self.high:
            raise PydanticCustomError("empty", "is empty")
        return self

    @property
    def low(self) -> float:
        return self.random[0]

    @property
    def high(self) -> float:
        return self.random[1]


class PositiveUniform(Uniform):
    """A random number above 0: drawn uniformly from [low, high)."""

    random: tuple[Positive, Positive] = Field(description="[low, high]")


_WHOLE = re.compile(r"0|-?[1-9][0-9]{0,3999}")


def node_id(value: Any) -> Any:
    """Return the node id in a text: an integer if the text is the shortest form of one, otherwise the text.

    Keys in JSON, headers of CSV files and arguments on the command line are always text. Only the shortest form becomes
    an integer, so every id has exactly one text: `7` is an integer, and `007` is a text.
    """
    return int(value) if isinstance(value, str) and _WHOLE.fullmatch(value) else value


NodeId = Annotated[
    Annotated[StrictInt, Tag("id")] | Annotated[Name, Tag("name")],
    Discriminator(lambda value: "name" if isinstance(value, str) else "id"),
    BeforeValidator(node_id),
]
TrueA = Annotated[
    Annotated[Number, Tag("number")] | Annotated[Literal["random"], Tag("word")],
    Discriminator(lambda value: "word" if isinstance(value, str) else "number"),
]


def kind_of(value: Any) -> str | None:
    """Return the `kind` of a member of a union, as written or as a model."""
    kind = value.get("kind") if isinstance(value, dict) else getattr(value, "kind", None)
    return kind if isinstance(kind, str) else None
