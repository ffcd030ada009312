"""What a run left, as arrays; and in what, and from which step on, two runs differ."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hedgerow.orchestrator.metrics.fault_accounts import at_ends
from hedgerow.orchestrator.metrics.verdict import Verdict
from hedgerow.orchestrator.runs.selection import kept
from hedgerow.topologies.describe import describe
from hedgerow.topologies.errors import Code, HedgerowError, UserError
from hedgerow.topologies.graph import Array, Mask
from hedgerow.topologies.json_file import loads
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import truth
from hedgerow.topologies.schema import Topology

NodeId = int | str
Pair = tuple[NodeId, NodeId]


class Estimates(dict[NodeId, float | None]):
    """What each node takes its a for at one step, by node; None where its agent is not there."""

    def __init__(self, result: Result, t: int) -> None:
        values = result.ahat[t].tolist()
        super().__init__(
            (node, None if math.isnan(value) else value) for node, value in zip(result.ids, values, strict=True)
        )
        self.result, self.t = result, t


@dataclass(frozen=True, eq=False)
class Result:
    """A run that is over: T steps, n nodes, E edges. Two are equal if every bit of their trajectories is."""

    folder: Path
    """docs/run-folder.md says what is in it"""
    topology: Topology
    """resolved, with every fault that there was"""
    x: Array
    """states, (T + 1, n); the last row is NaN where the final state never came, as of a plant that was killed"""
    u: Array
    """inputs, (T, n); NaN where none came"""
    w: Array
    """disturbances, (T, n)"""
    ahat: Array
    """estimates, (T, n); NaN where an agent is not there"""
    index: NDArray[np.int32]
    """which candidate ahat is, from 0 in list order, (T, n); -1 for none"""
    regret: Array
    """r_i = |x_i - x_i*|, (T + 1, n), against the twin that knows every a"""
    edge_open: Mask = field(repr=False)
    """edges that carried flow, (T, E)"""
    heard: Mask = field(repr=False)
    """by incidence of `topology.graph`: whether the message of the step itself came, (T, 2E)"""
    events: Sequence[Mapping[str, Any]] = field(repr=False)
    """what happened, a mapping each, as events.jsonl has it"""
    verdict: Verdict = field(repr=False)

    @classmethod
    def read(cls, folder: str | Path) -> Result:
        """The run in a folder, of `orchestrator up`, of `simulate` or of a test; raises UserError if it is not over."""
        # Arrow takes a while to load, and a project that does not use the plugin would wait for it.
        from hedgerow.orchestrator.runs.files import check_file, read_events, read_file, reading  # noqa: PLC0415
        from hedgerow.orchestrator.runs.table import Table  # noqa: PLC0415

        folder = Path(folder)
        try:
            with reading(folder / "verdict.json"):
                content = loads(folder / "verdict.json", read_file(folder / "verdict.json"))
                if type(content["steps_done"]) is not int or not isinstance(content["verdict"], str):
                    raise ValueError("it is no verdict")
            for name in ("telemetry", "edges"):
                check_file(folder / f"{name}.parquet")
            table, edges = (Table(folder, name).whole() for name in ("telemetry", "edges"))
        except FileNotFoundError as error:
            raise UserError(
                f"{folder}: holds no run that is over: there is no {Path(error.filename).name}", code=Code.RUN_MISSING
            ) from None
        topology = load(str(folder))
        if not (what := kept(topology)).whole:
            raise UserError(
                f"{folder}: kept {what}, and a Result has all; `hedgerow.orchestrator.load_run` reads what is there",
                code=Code.NOT_RECORDED,
            )
        steps, n, e = content["steps_done"], len(topology.ids), len(topology.edges)
        ended = len(table) != steps * n
        if ended and len(table) != (steps + 1) * n:
            raise HedgerowError(f"{folder}: {len(table)} rows of telemetry, not {(steps + 1) * n}: some were lost")

        def column(name: str) -> Array:
            values: Array = table[name].to_numpy().reshape(-1, n)
            if not ended:
                values = np.vstack([values, np.full((1, n), np.nan)])
            values.flags.writeable = False
            return values

        def of_edges(name: str) -> Mask:
            values: Mask = edges[name].to_numpy().reshape(steps, e)
            return values

        x = column("x")
        heard = np.empty((steps, 2 * e), dtype=np.bool_)
        heard[:, at_ends(topology.graph).T.ravel()] = np.hstack([of_edges("i_hears"), of_edges("j_hears")])
        with reading(folder / "events.jsonl"):
            events = read_events(read_file(folder / "events.jsonl"), folder / "events.jsonl")
        return cls(
            folder=folder,
            topology=topology,
            x=x,
            u=column("u")[:-1],
            w=column("w")[:-1],
            ahat=column("ahat")[:-1],
            index=np.nan_to_num(column("index")[:-1], nan=-1).astype(np.int32),
            regret=np.abs(x - column("x_oracle")),
            edge_open=of_edges("open"),
            heard=heard,
            events=events,
            verdict=Verdict(content["verdict"], content),
        )

    @property
    def ids(self) -> tuple[NodeId, ...]:
        """Node ids in the order of the columns."""
        return tuple(self.topology.ids)

    @property
    def steps(self) -> int:
        """T, the steps that were made."""
        return len(self.u)

    @property
    def truth(self) -> Array:
        """The true a, (n,), before any jump."""
        return truth(self.topology)

    def column(self, node: NodeId) -> int:
        """Where a node stands in the arrays: `run.x[:, run.column(4)]`; raises UserError."""
        try:
            return self.ids.index(node)
        except ValueError:
            raise UserError(
                f"{node!r} is no node; the nodes are {', '.join(map(str, self.ids[:12]))}", code=Code.OPTION
            ) from None

    def estimates_at(self, t: int) -> Estimates:
        """What each node takes its a for at step t, from what it knows of steps before; a dict by node."""
        if not 0 <= t < self.steps:
            raise UserError(f"estimates_at({t}): the run has steps 0 to {self.steps - 1}", code=Code.OPTION)
        return Estimates(self, t)

    def missing(self, link: Pair) -> list[int]:
        """Steps whose message from the first node of `link` to the second did not come in time."""
        sender, to = map(self.column, link)
        graph = self.topology.graph
        incidence = np.flatnonzero((graph.node == to) & (graph.neighbour == sender))
        if not len(incidence):
            raise UserError(f"missing({link}): {link[0]} and {link[1]} are not neighbours", code=Code.OPTION)
        return [int(t) for t in np.flatnonzero(~self.heard[:, incidence[0]])]

    def open(self, edge: Pair) -> list[int]:
        """Steps at which an edge carried flow."""
        ends = {*map(self.column, edge)}
        found = [k for k, pair in enumerate(self.topology.graph.edges) if {*pair.tolist()} == ends]
        if not found:
            raise UserError(f"open({edge}): {edge[0]} and {edge[1]} are not neighbours", code=Code.OPTION)
        return [int(t) for t in np.flatnonzero(self.edge_open[:, found[0]])]

    def summary(self) -> str:
        """What went wrong, how the run ended, and where it can be looked at."""
        faults = [f"fault {k}: {describe(fault)}" for k, fault in enumerate(self.topology.faults, start=1)]
        return "\n  ".join([str(self.folder), *faults, _lost(self, self.steps), self.verdict.line()])

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Result):
            return NotImplemented
        return self.ids == other.ids and all(
            np.array_equal(getattr(self, name), getattr(other, name), equal_nan=True) for name in _COMPARED
        )

    __hash__ = None  # type: ignore[assignment]

    def assert_same_estimates(self, other: Result, t: int | None = None) -> None:
        """Assert that all estimates of two runs are equal, at step t or, left out, at every step of both."""
        steps = range(min(self.steps, other.steps)) if t is None else [t]
        for step in steps:
            mine, others = self.estimates_at(step), other.estimates_at(step)
            if mine != others:
                raise AssertionError("\n".join(explain(mine, others) or ()))


_COMPARED = ("x", "ahat", "index", "u", "w")
"""In the order in which one leads to the next within a step."""


def explain(left: Any, right: Any) -> list[str] | None:
    """Why two results, or the estimates of two, are not equal: a few lines; None for anything else."""
    if isinstance(left, Estimates) and isinstance(right, Estimates):
        if left.result.ids != right.result.ids:
            return [f"the nodes differ: {list(left)} and {list(right)}"]
        said = f"estimates at step {left.t}" + (f" and {right.t}" if left.t != right.t else "")
        differ = [f"node {node}: {left[node]} != {right[node]}" for node in left if left[node] != right[node]]
        return [
            f"{said} differ: {'; '.join(differ[:4])}{_more(differ, 4)}",
            *_first(left.result, right.result, ["ahat"]),
        ]
    if isinstance(left, Result) and isinstance(right, Result):
        if left.ids != right.ids:
            return [f"the nodes differ: {list(left.ids)} and {list(right.ids)}"]
        said = f"runs of {left.steps} and {right.steps} steps" if left.steps != right.steps else "runs"
        return [f"{said} differ", *_first(left, right, _COMPARED)]
    return None


def _first(left: Result, right: Result, names: Sequence[str]) -> list[str]:
    """The first step at which the runs differ in one of these arrays, and what was not heard before it."""
    steps = min(left.steps, right.steps)
    found = [(t, name) for name in names if (t := _differs(left, right, name)) is not None]
    if not found:
        return [f"up to step {steps} they are equal"]
    t, name = min(found, key=lambda pair: (pair[0], names.index(pair[1])))
    one, other = getattr(left, name)[t], getattr(right, name)[t]
    return [
        f"first at step {t}: {'; '.join(_cells(left, name, one, other))}",
        f"until then, left:  {_lost(left, t + 1)}",
        f"until then, right: {_lost(right, t + 1)}",
        f"folders: {left.folder} and {right.folder}",
    ]


def _differs(left: Result, right: Result, name: str) -> int | None:
    one, other = getattr(left, name), getattr(right, name)
    rows = min(len(one), len(other))
    found = np.flatnonzero(_unequal(one[:rows], other[:rows]).any(axis=1))
    return int(found[0]) if len(found) else None


def _unequal(one: NDArray[Any], other: NDArray[Any]) -> Mask:
    unequal: Mask = one != other
    return unequal & ~(np.isnan(one) & np.isnan(other)) if one.dtype.kind == "f" else unequal


def _cells(result: Result, name: str, one: Any, other: Any) -> list[str]:
    """What differs in one row of an array."""
    unequal = np.flatnonzero(_unequal(one, other))
    cells = [f"{name} of node {result.ids[k]} {one[k]} != {other[k]}" for k in unequal[:4]]
    return [*cells, f"and {len(unequal) - 4} more"] if len(unequal) > 4 else cells


def _lost(result: Result, until: int) -> str:
    """Link messages that did not come in time before step `until`."""
    graph, ids = result.topology.graph, result.ids
    lost = ~result.heard[:until]
    said = [
        f"{ids[graph.neighbour[c]]}->{ids[graph.node[c]]} at {_ranges(np.flatnonzero(lost[:, c]).tolist())}"
        for c in np.flatnonzero(lost.any(axis=0))
    ]
    if not said:
        return "no message lost or late"
    return f"messages lost or late: {', '.join(said[:6])}{_more(said, 6)}"


def _ranges(steps: list[int]) -> str:
    """Steps as a person says them: 3, 10-19."""
    runs: list[list[int]] = []
    for t in steps:
        if runs and runs[-1][1] == t - 1:
            runs[-1][1] = t
        else:
            runs.append([t, t])
    said = [f"{a}" if a == b else f"{a}-{b}" for a, b in runs]
    return " ".join(said[:6]) + _more(said, 6)


def _more(said: Sequence[str], shown: int) -> str:
    return f", and {len(said) - shown} more" if len(said) > shown else ""
