"""The columns of the tables and the metrics of the verdict, compared with the observer's numbers for the telemetry."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from hedgerow.orchestrator.metrics.gain_bound import Premise
from hedgerow.orchestrator.metrics.observer import Batch, Observer
from hedgerow.orchestrator.metrics.replay import Finding
from hedgerow.orchestrator.metrics.verdict import VALID
from hedgerow.orchestrator.runs.guaranteed import bound_of, ceiling, computed_slack, slack
from hedgerow.orchestrator.runs.writer import CLAIMS, end_summary, id_column, summary
from hedgerow.topologies.graph import Index, Mask
from hedgerow.wire.message import End

if TYPE_CHECKING:
    from hedgerow.orchestrator.runs.recorded import NodeId
    from hedgerow.orchestrator.runs.run import Run

TABLES = "tables"
_CLOSE = 1e-9
"""The relative difference of numbers from a solver: their last digits depend on the machine."""


def first_other(run: Run, batch: Batch, observer: Observer) -> Finding | None:
    """Return the first number of a run that is not what the observer computes from its telemetry, None without one."""
    found = [*_labels(run), *_of_tables(run, batch, observer)]
    if "summary" in run.tables:
        found += _of_summary(run, batch, observer)
    found += _of_verdict(run, observer)
    return min(found, key=lambda one: one.step, default=None)


def _labels(run: Run) -> Iterator[Finding]:
    """Yield the first wrong step, node or end of an edge in each table."""
    ends = run.topology.graph.edges
    every = np.arange(run.topology.graph.n)
    for table, named in (("telemetry", {"node": every}), ("edges", {"i": ends[:, 0], "j": ends[:, 1]})):
        width = len(next(iter(named.values())))
        if not width:
            continue
        steps = run.tables[table].steps(width)
        yield from _first(run, f"{table}: step", steps[:, None], run.tables[table].column("step", width), steps)
        for name, nodes in named.items():
            yield from _first_label(run, table, name, id_column(run.topology, nodes), steps)


def _first_label(run: Run, table: str, name: str, ids: pa.Array, steps: Index) -> Iterator[Finding]:
    """Yield the first row with another id than that of its place, in parts that fit into memory."""
    at = 0
    for batch in run.tables[table].batches():
        seen = batch.column(batch.schema.get_field_index(name))
        places = np.arange(at, at + len(seen)) % len(ids)
        other = np.flatnonzero(~np.array(pc.fill_null(pc.equal(seen, ids.take(pa.array(places))), False)))
        if len(other):
            k = int(other[0])
            why = f"{table}: {name} is {seen[k]}, and should be {ids[int(places[k])]}"
            yield Finding(TABLES, int(steps[(at + k) // len(ids)]), None, [why])
            return
        at += len(seen)


def _of_tables(run: Run, batch: Batch, observer: Observer) -> Iterator[Finding]:
    """Yield the first wrong number of each column of telemetry and edges that telemetry determines."""
    steps, last = batch.t, np.array([run.T])
    yield from _first(run, "x_nominal", batch.x_nominal, run.x_nominal[steps], steps, run.ids)
    yield from _first(run, "index", batch.index, run.index[steps], steps, run.ids)
    yield from _first(run, "u_edge", batch.u_edge, run.u_edge[steps], steps, _edges(run))
    for name, end in (("x_oracle", observer.x_oracle_end), ("x_nominal", observer.x_nominal_end)):
        yield from _first(run, name, end[None], getattr(run, name)[last], last, run.ids)


def _of_summary(run: Run, batch: Batch, observer: Observer) -> Iterator[Finding]:
    """Yield the first wrong number of each column of the summary."""
    table = run.summary()
    columns = {name: table.column(name).to_numpy() for name in table.column_names}
    if len(columns.get("step", ())) < len(batch.t):  # it ended before the other tables
        return
    right: dict[str, NDArray[Any]] = summary(dataclasses.replace(batch, link_up=run.received[batch.t]))
    for name in set(columns) & set(right) - set(CLAIMS):
        yield from _first(run, name, right[name], columns[name][: len(batch.t)], batch.t)
    if len(columns["step"]) > len(batch.t):
        last = np.array([run.T])
        for name, value in end_summary(observer, End(run.T, run.x[-1], 0.0)).items():
            if name in columns:
                yield from _first(run, name, value, columns[name][len(batch.t) :][:1], last)
    yield from _of_claims(run, columns, batch.t)


def _of_claims(run: Run, columns: dict[str, NDArray[Any]], steps: Index) -> Iterator[Finding]:
    """Yield the first claimed bound that is not in the verdict, and the first slack that is not that of its bound."""
    if not set(CLAIMS) <= set(columns):  # an older version wrote the run
        return
    bound, claimed = (columns[name][: len(steps)] for name in CLAIMS)
    known, near = np.isnan(bound), np.isnan(claimed)
    for premise, gain in _gains(run):
        own = slack(run, premise)[steps]
        near |= np.isclose(own, claimed, rtol=_CLOSE, atol=_CLOSE * run.cost_sum[steps])
        # Of two bounds that are equal except for the tolerance of the solver, either can be the recorded one.
        known |= np.isclose(gain, bound, rtol=_CLOSE)
    yield from _first(run, CLAIMS[0], ceiling(run)[steps], bound, steps, missing=known)
    yield from _first(run, CLAIMS[1], computed_slack(run)[steps], claimed, steps, missing=near)


def _gains(run: Run) -> Iterator[tuple[Premise, float]]:
    """Yield every premise with a bound in the verdict, and the gain of the bound."""
    for premise in Premise:
        bound = bound_of(run, premise)
        if isinstance(bound.get("p"), list) and isinstance(bound.get("gain"), float):
            yield premise, bound["gain"]


def _of_verdict(run: Run, observer: Observer) -> Iterator[Finding]:
    """Yield the numbers of a valid verdict that are not those of the run."""
    content, topology = run.verdict.content, run.topology
    if content.get("verdict") != VALID:
        return
    own = {
        **{name: getattr(topology, name) for name in ("name", "law", "seed", "steps")},
        "nodes": topology.graph.n,
        "edges": len(topology.graph.edges),
    }
    pairs = [(name, content.get(name), right) for name, right in own.items()]
    metrics = content.get("metrics") or {}
    pairs += [(name, metrics.get(name), right) for name, right in observer.summary().items()]
    for name, seen, right in pairs:
        if not _same(name, seen, right):
            yield Finding(TABLES, run.T, None, [f"verdict.json: {name} is {seen!r}, and should be {right!r}"])


def _same(name: str, seen: object, right: object) -> bool:
    if name == "gamma_star" and isinstance(seen, float) and isinstance(right, float):
        return math.isclose(seen, right, rel_tol=_CLOSE)
    if isinstance(right, float) and not math.isfinite(right):
        return seen is None  # JSON has no such number
    return seen == right


def _edges(run: Run) -> list[str]:
    return [f"{run.ids[i]}-{run.ids[j]}" for i, j in run.edges.tolist()]


def _first(
    run: Run,
    name: str,
    right: NDArray[Any],
    seen: NDArray[Any],
    steps: Index,
    columns: list[str] | tuple[NodeId, ...] = (),
    missing: Mask | None = None,
) -> Iterator[Finding]:
    """Yield the first place with another value than the computed one; NaN equals NaN, and `missing` is not compared."""
    right = np.broadcast_to(right, seen.shape)
    other = (right != seen) & ~((right != right) & (seen != seen))  # noqa: PLR0124
    if missing is not None:
        other &= ~missing
    if not other.any():
        return
    k, *column = np.argwhere(other)[0].tolist()
    node = columns[column[0]] if columns else None
    place = "" if node is None else f"{'node' if node in run.ids else 'edge'} {node}: "
    why = f"{place}{name} is {seen[k, *column]!s}, and should be {right[k, *column]!s}"
    yield Finding(TABLES, int(steps[k]), node if node in run.ids else None, [why])
