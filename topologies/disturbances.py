"""The disturbances that a topology file can hold: one model per kind, written or resolved."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Discriminator, Field, StrictInt, Tag, model_validator
from pydantic_core import PydanticCustomError

from hedgerow.topologies.base import Model, NonNegative, Number, Positive, Uniform, kind_of, number
from hedgerow.topologies.effects import FOREVER
from hedgerow.topologies.header import Header
from hedgerow.topologies.reading import Reading, Times


class NonNegativeUniform(Uniform):
    """A random number of at least 0: drawn uniformly from [low, high)."""

    random: tuple[NonNegative, NonNegative] = Field(description="[low, high]")


def mapping_or(other: str) -> Discriminator:
    return Discriminator(lambda value: "random" if isinstance(value, dict | Model) else other)


Value = Annotated[
    Annotated[Number, Tag("number")] | Annotated[Uniform, Tag("random")],
    mapping_or("number"),
]


class Sinusoid(Model):
    """w(t) = amplitude * sin(omega * t + phase)."""

    kind: Literal["sinusoid"] = "sinusoid"
    amplitude: Value = Field(description="peak, in units of the state per step")
    omega: Value = Field(description="angular frequency [rad/step]")
    phase: Value = Field(0.0, description="phase at t = 0 [rad]")


class Constant(Model):
    """w(t) = value."""

    kind: Literal["constant"] = "constant"
    value: Value = Field(description="the disturbance at every step")


class White(Model):
    """Gaussian white noise, a function of (seed, node id, step)."""

    kind: Literal["white"] = "white"
    std: Annotated[
        Annotated[NonNegative, Tag("number")] | Annotated[NonNegativeUniform, Tag("random")],
        mapping_or("number"),
    ] = Field(description="standard deviation")


class AR1(Model):
    """Coloured Gaussian noise, w(t) = phi w(t - 1) + sqrt(1 - phi^2) std e(t) with e(t) white and w(0) = std e(0).

    A function of (seed, node id, step), stationary from t = 0.
    """

    kind: Literal["ar1"] = "ar1"
    phi: Annotated[float, Field(gt=-1, lt=1), BeforeValidator(number)] = Field(
        description="correlation of two successive steps"
    )
    std: Annotated[
        Annotated[NonNegative, Tag("number")] | Annotated[NonNegativeUniform, Tag("random")],
        mapping_or("number"),
    ] = Field(description="standard deviation of w(t)")


class Confuse(Model):
    """w_i(t) = (candidate - a_i) x_i(t): the node moves exactly as if `candidate` were its true a.

    It depends on the state, so w differs from law to law. From x(0) = 0 it is 0 forever, unless another disturbance
    moves x.
    """

    kind: Literal["confuse"] = "confuse"
    candidate: Annotated[
        Annotated[float, Field(gt=0, lt=1), BeforeValidator(number), Tag("number")]
        | Annotated[Literal["random"], Tag("word")],
        Discriminator(lambda value: "word" if isinstance(value, str) else "number"),
    ] = Field(description="the a that appears true; or `random`: a wrong candidate of the node, drawn")


class Impulse(Model):
    """w(at) = value, and 0 at every other step."""

    kind: Literal["impulse"] = "impulse"
    at: Annotated[StrictInt, Field(ge=0, le=FOREVER)] = Field(description="the step of the impulse")
    value: Value = Field(description="the disturbance at that step")


class Samples(Model):
    """w(t) = values[t], inline or a column of a CSV file."""

    kind: Literal["samples"] = "samples"
    values: tuple[Number, ...] | None = Field(None, description="one value per step")
    file: str | None = Field(
        None,
        description="a CSV or Parquet file beside the topology, one column per node: by node ids, or in CSV in their"
        " order",
    )
    header: Header | None = Field(
        None, description="the first row of `file`: `ids`, or `none` if it holds samples; for ambiguous files"
    )
    time: str | None = Field(None, description="the column of `file` that holds times, numbers or dates, which ascend")
    step: Positive | None = Field(
        None,
        description="the time of one step, in the unit of `time`, seconds for dates; the first difference if absent",
    )
    resample: Literal["hold", "linear", "mean"] | None = Field(
        None, description="the rule for steps between two times: `hold` (default), `linear` or `mean`"
    )

    @property
    def reading(self) -> Reading:
        """Return the settings that determine how the file is read."""
        times = None if self.time is None else Times(self.time, self.step, self.resample)
        return Reading(self.file or "", self.header, times)

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        if self.header is not None and self.file is None:
            raise PydanticCustomError("samples", "`header:` is about a `file:`; remove it, or give the file")
        if self.file is None and (self.time, self.step, self.resample) != (None, None, None):
            raise PydanticCustomError("samples", "`time:`, `step:` and `resample:` are about a `file:`; give the file")
        if self.time is None and (self.step is not None or self.resample is not None):
            raise PydanticCustomError("samples", "`step:` and `resample:` are about times; name their column, `time:`")
        if (self.values is None) == (self.file is None):
            raise PydanticCustomError("samples", "samples have either `values:` or `file:`; give exactly one of them")
        return self


class Nothing(Model):
    """w(t) = 0."""

    kind: Literal["none"] = "none"


def bare_kind(value: Any) -> Any:
    """Return `none` and `worst_case` with the braces that a file may omit."""
    return {"kind": value} if isinstance(value, str) else value


Component = Annotated[
    Annotated[Sinusoid, Tag("sinusoid")]
    | Annotated[Constant, Tag("constant")]
    | Annotated[White, Tag("white")]
    | Annotated[AR1, Tag("ar1")]
    | Annotated[Confuse, Tag("confuse")]
    | Annotated[Impulse, Tag("impulse")]
    | Annotated[Samples, Tag("samples")]
    | Annotated[Nothing, Tag("none")],
    Discriminator(
        kind_of,
        custom_error_type="kind",
        custom_error_message="a disturbance has `kind:` sinusoid, constant, white, ar1, confuse, impulse, samples"
        " or none",
    ),
    BeforeValidator(
        bare_kind,
        json_schema_input_type=Sinusoid
        | Constant
        | White
        | AR1
        | Confuse
        | Impulse
        | Samples
        | Nothing
        | Literal["none"],
    ),
]
COMPONENTS: dict[str, type[Sinusoid | Constant | White | AR1 | Confuse | Impulse | Samples | Nothing]] = {
    model.model_fields["kind"].default: model
    for model in (Sinusoid, Constant, White, AR1, Confuse, Impulse, Samples, Nothing)
}
Disturbance = Annotated[
    Annotated[Component, Tag("one")] | Annotated[tuple[Component, ...], Tag("sum")],
    Discriminator(lambda value: "sum" if isinstance(value, list | tuple) else "one"),
]


class WorstCase(Model):
    """The constant disturbance along Q's smallest eigenvector, with the highest cost for the optimal controller."""

    kind: Literal["worst_case"] = "worst_case"
    energy: NonNegative = Field(1.0, description="|w(t)|^2, summed over the nodes, at every step")
