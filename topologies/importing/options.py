"""Options of an import, which the command line and Python share."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Integral, Real

from hedgerow.topologies.errors import Code, UserError


@dataclass(frozen=True)
class Options:
    """The rules to make a topology from a source; None leaves the choice to the reader, which reports it."""

    name: str | None = None
    """the name of the run"""
    weight: str | None = None
    """an edge attribute, or a number for all edges"""
    storage: str | float | None = None
    """a node attribute, or a number for all nodes: b_i = b/sqrt(storage)"""
    junction_storage: float | None = None
    """the storage of nodes without a value, such as the junctions of a water network [m^2]"""
    directed: bool = False
    """an edge from i to j and one from j to i are one edge, also in a source without directions"""
    largest_component: bool = False
    max_degree: int | None = None
    b: float | None = None
    steps: int | None = None
    seed: int = 1
    time_step: float | None = None
    """[s], for sources with physical units"""
    leak: float | None = None
    """the rate [1/h] at which a node loses its content: a = exp(-leak * time step)"""
    reservoirs: float | None = None
    """the storage [m^2] of reservoirs; they are dropped if it is None"""

    def __post_init__(self) -> None:
        """Raise UserError for an invalid number."""
        storage = self.storage
        if isinstance(storage, str):
            try:
                storage = float(storage)
            except ValueError:
                storage = None  # an attribute
        for option, value in (
            ("--storage", storage),
            ("--junction-storage", self.junction_storage),
            ("--b", self.b),
            ("--time-step", self.time_step),
            ("--leak", self.leak),
            ("--reservoir-storage", self.reservoirs),
        ):
            # In Python, a value may have any type.
            if value is not None and not (isinstance(value, Real) and 0 < value < 1e100):
                raise UserError(f"{option} {value}: is no number above 0. Give a number above 0.", code=Code.OPTION)
        for option, whole in (("--max-degree", self.max_degree), ("--steps", self.steps)):
            if whole is not None and not (isinstance(whole, Integral) and whole >= 1):
                raise UserError(f"{option} {whole}: is no whole number from 1. Give one.", code=Code.OPTION)
