"""A run read back from its folder, as arrays and tables: over, interrupted, killed, or as far as it has come.

What was recorded is read when it is first asked for. What was not is computed again by the observer that
computed it live, from the same telemetry, to the same bits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from hedgerow.orchestrator.metrics.certificate import storage
from hedgerow.orchestrator.metrics.fault_accounts import at_ends
from hedgerow.orchestrator.metrics.fault_schedule import Schedule
from hedgerow.orchestrator.metrics.gain_bound import Premise
from hedgerow.orchestrator.metrics.observer import Batch, Observer, gain
from hedgerow.orchestrator.metrics.replay import Finding, Replay
from hedgerow.orchestrator.runs.files import find_run, load_events, load_resolved, read_verdict
from hedgerow.orchestrator.runs.selection import Kept, kept
from hedgerow.orchestrator.runs.table import Table, there_is
from hedgerow.topologies import budget
from hedgerow.topologies.errors import Code, HedgerowError, UserError
from hedgerow.topologies.escape import command
from hedgerow.topologies.graph import Array, Gain, Index, Mask
from hedgerow.topologies.schema import Topology
from hedgerow.wire.codec import TAKEN, End, Telemetry

Value = TypeVar("Value", bound=np.generic)
TABLES = ("telemetry", "edges", "summary")
_REPLAY_ROWS = 1024


def load_run(run: str | Path = "runs/latest") -> RecordedRun:
    """What a run has left so far: `run` is its folder, its name in runs/, or a network's, for its youngest run there.

    Raises UserError where there is none, and where no step is recorded yet.
    """
    folder = find_run(run)
    tables = {name: Table(folder, name) for name in TABLES if name != "summary" or there_is(folder, name)}
    # The file of a run that goes on may gain faults: it is read after the steps that they strike.
    topology, verdict = load_resolved(folder), read_verdict(folder)
    if verdict and len(verdict["faults"]) != len(topology.faults):
        raise UserError(
            f"{folder / 'verdict.json'}: has {len(verdict['faults'])} faults, and topology.yaml {len(topology.faults)}."
            " The two files are of different runs: put back the right one.",
            code=Code.FILE_FORMAT,
        )
    return RecordedRun(folder, topology, verdict, load_events(folder), tables)


def _states(name: str) -> cached_property[Array]:
    """A column of telemetry, T included, (T + 1, n)."""
    return cached_property(lambda run: run._of_nodes(name, run.T + 1, np.nan))


def _actions(name: str) -> cached_property[Array]:
    """A column of telemetry at the steps at which something acts, (T, n)."""
    return cached_property(lambda run: run._of_nodes(name, run.T, np.nan))


def _flags(name: str) -> cached_property[Mask]:
    """A column of edges that says yes or no, (T, E)."""
    return cached_property(lambda run: run._of_edges(name, False))


def _observed(name: str) -> cached_property[Array]:
    """Return a property that recomputes a field of `metrics.observer.Batch`, (T,) or (T, n)."""
    return cached_property(lambda run: run._by_step(getattr(run._replayed[0], name)))


def _total(name: str) -> cached_property[Array]:
    """The same of the whole network, which the summary has where there is no row for every node and step, (T,)."""
    return cached_property(
        lambda run: run._by_step(getattr(run._replayed[0], name)) if run.whole else run._summed(name, run.T)
    )


@dataclass(frozen=True, eq=False, repr=False)
class RecordedRun:
    """A run of T steps, n nodes and E edges, none of which can be changed; of those that `record:` gives rows.

    Row t of every array is step t; where it has no rows, or its telemetry was lost, numbers are NaN, `index` and
    `right` -1, and flags False. Columns are nodes or edges in the order of the file. The formulas stand in
    docs/theory.md.
    """

    folder: Path
    topology: Topology
    """resolved, with all faults that there were"""
    verdict: Mapping[str, Any]
    """verdict.json; empty while the run goes on, and where `up` was killed"""
    events: Sequence[Mapping[str, Any]]
    """events.jsonl"""
    tables: Mapping[str, Table]
    """telemetry and edges, and the summary if there is one"""

    def __post_init__(self) -> None:
        if self.topology.steps < self.T:
            raise UserError(
                f"{self.folder}: {self.T} steps of a run of {self.topology.steps}: the files are of two runs"
            )
        if not (self._steps < self.T).any():
            raise UserError(f"{self.folder}: no whole step of the run is recorded yet")

    @cached_property
    def kept(self) -> Kept:
        """What has rows."""
        return kept(self.topology)

    @property
    def whole(self) -> bool:
        """Whether every step of every node has rows."""
        return self.kept.whole

    def need_all(self, what: str) -> None:
        """Raise UserError where not all has rows; `what` needs it."""
        if not self.whole:
            again = command(["orchestrator", "simulate", self.folder, "--set", "record={nodes: all}"])
            raise UserError(
                f"{self.folder}: {what} needs all rows, and the run kept {self.kept}; it can be run again with all of"
                f" them, to the same bits: {again}"
            )

    def __repr__(self) -> str:
        size = f"{self.T} steps of {len(self.ids)} nodes"
        if not self.whole:
            size = f"{self.T} steps, with rows for {self.kept}"
        return f"<RecordedRun {self.folder.name}: {size}, {self.verdict.get('verdict', 'no verdict')}>"

    @property
    def run(self) -> str:
        """The name of the folder."""
        return self.folder.name

    @property
    def law(self) -> str:
        return self.topology.law

    @cached_property
    def T(self) -> int:  # noqa: N802 (the paper's name)
        """How many steps are known with the state after them: the last of `x` is x(T)."""
        steps, edges = self._steps, len(self.edges)
        if not edges or not len(steps):
            return int(steps[-1]) if len(steps) else 0
        behind = self.tables["edges"].steps(edges)
        if self.whole:
            return min(int(steps[-1]), int(behind[-1]) + 1 if len(behind) else 0)
        # Edges are written right behind the nodes: of as many steps, and the state at the next one that has rows.
        return int(steps[min(len(behind), len(steps) - 1)]) if len(behind) else 0

    @property
    def b(self) -> Gain:
        """The gain b of (1): one number, or that of each node, (n,)."""
        b = self.topology.network.b
        return b if isinstance(b, float) else _frozen(b[self.kept.nodes])

    @cached_property
    def weights(self) -> Array:
        """The weight of each edge, (E,)."""
        weights = self.topology.graph.weights
        return _frozen(np.ones(len(self.kept.edges)) if weights is None else weights[self.kept.edges])

    @cached_property
    def ids(self) -> tuple[int | str, ...]:
        """Node ids in the order of the columns."""
        every = self.topology.ids
        return tuple(every) if self.kept.all_nodes else tuple(every[k] for k in self.kept.nodes.tolist())

    @cached_property
    def edges(self) -> Index:
        """Where in `ids` the ends of each edge (i, j) stand, -1 for one that has no rows, (E, 2)."""
        places = np.full(self.topology.graph.n, -1)
        places[self.kept.nodes] = np.arange(len(self.kept.nodes))
        return _frozen(places[self.topology.graph.edges[self.kept.edges]])

    @cached_property
    def candidates(self) -> Array:
        """The list of each node, NaN behind its end, (n, M)."""
        return _frozen(self.topology.network.candidates[:, self.kept.nodes].T.copy())

    @cached_property
    def nominal(self) -> Array:
        """What the nominal controller takes each a for, (n,)."""
        return _frozen(self.topology.network.nominal[self.kept.nodes])

    @cached_property
    def gamma_star(self) -> float:
        """The oracle's optimal gain, of the a at t = 0."""
        return self.topology.network.gamma_star

    @cached_property
    def steps(self) -> Index:
        """The steps up to T that have rows, ascending, (K,)."""
        return _frozen(self._steps[self._steps <= self.T].copy())

    @cached_property
    def lost(self) -> Index:
        """Steps before T whose telemetry never came; (0,) most often."""
        due = np.arange(self.T)
        if not self.whole and "summary" in self.tables:
            return _frozen(np.setdiff1d(due, self.tables["summary"].steps(1)))
        return _frozen(np.setdiff1d(due[self.kept.rows(due)], self._steps))

    x = _states("x")
    """states, (T + 1, n)"""
    x_oracle = _states("x_oracle")
    """those of the twin that knows every a, (T + 1, n)"""
    x_nominal = _states("x_nominal")
    """those of the twin that assumes `nominal`, (T + 1, n)"""
    u = _actions("u")
    """inputs, NaN where none came, (T, n)"""
    w = _actions("w")
    """disturbances, (T, n)"""
    ahat = _actions("ahat")
    """estimates, NaN where nobody was there, (T, n)"""

    margin = _actions("margin")
    """J_(2) - J_(1), by which ahat fits better than the next, NaN where there is none, (T, n)"""

    @cached_property
    def index(self) -> NDArray[np.int32]:
        """Which candidate ahat is, from 0; -1 where none is named, (T, n)."""
        return _frozen(np.nan_to_num(self._of_nodes("index", self.T, np.nan), nan=-1.0).astype(np.int32))

    @cached_property
    def wrong(self) -> NDArray[np.bool_]:
        """True where ahat is a candidate other than the truth, (T, n)."""
        return _frozen((self.index >= 0) & np.isfinite(self.ahat) & (self.ahat != self.a[: self.T]))

    @property
    def real_estimates(self) -> bool:
        """Return True if some estimate is no candidate: the law estimates real numbers."""
        return bool((np.isfinite(self.ahat) & (self.index < 0)).any())

    @cached_property
    def u_edge(self) -> Array:
        """u_j - u_i of each edge (i, j), 0 where it was closed, (T, E)."""
        return self._of_edges("u_edge", np.nan)

    open = _flags("open")
    """whether an edge carried flow, (T, E)"""
    i_hears = _flags("i_hears")
    """whether what j said of a step crossed to i in that step, (T, E)"""
    j_hears = _flags("j_hears")
    """the same from i to j, (T, E)"""

    @cached_property
    def regret(self) -> Array:
        """r_i = |x_i - x_i*|, the paper's figure 4, (T + 1, n)."""
        return _frozen(np.abs(self.x - self.x_oracle))

    @cached_property
    def nominal_gap(self) -> Array:
        """|x_i* - x_i^nom|, the paper's figure 5, (T + 1, n)."""
        return _frozen(np.abs(self.x_oracle - self.x_nominal))

    @cached_property
    def a(self) -> Array:
        """The truth, after the jumps so far, (T, n)."""
        if self.whole:
            return self._by_step(self._replayed[0].a)
        nodes = self.kept.nodes
        a = np.repeat(self.topology.network.a[None, nodes], self.T, axis=0)
        for jump in Schedule(self.topology).jumps(0):
            a[jump.start :, nodes == jump.targets[0]] = jump.a
        return _frozen(a)

    a_ls = _observed("a_ls")
    """the least-squares a of the steps before, whether the node took them in or not; NaN at first, (T, n)"""
    beta = _observed("beta")
    """its bias, a_LS - a, (T, n)"""

    @cached_property
    def identifiable(self) -> Mask:
        """Whether a_LS is nearest the truth among the candidates, of equally near ones the first, (T, n)."""
        nearest = np.broadcast_to(self.candidates[:, 0], self.a_ls.shape)
        for rival in self.candidates.T[1:]:
            nearest = np.where(np.abs(self.a_ls - rival) < np.abs(self.a_ls - nearest), rival, nearest)
        return _frozen((nearest == self.a) & np.isfinite(self.a_ls))

    @cached_property
    def faultless(self) -> bool:
        """Whether all edges were open and no a jumped at any step, as gamma* supposes."""
        return bool(self.open.all() and (self.a == self.a[:1]).all())

    cost = _total("cost")
    """c = |x|^2 + sum_e k_e u_e^2, (T,)"""
    cost_oracle = _total("cost_oracle")
    """that of the oracle's twin, (T,)"""
    cost_sum = _total("cost_sum")
    """C, the sum of c so far, (T,)"""
    cost_oracle_sum = _total("cost_oracle_sum")
    """C*, (T,)"""
    energy_sum = _total("energy_sum")
    """the sum of |w|^2 so far, (T,)"""

    @cached_property
    def cost_regret(self) -> Array:
        """R = C - C*, signed, (T,)."""
        return _frozen(self.cost_sum - self.cost_oracle_sum)

    @cached_property
    def right(self) -> NDArray[np.int64]:
        """How many ahat are the truth, (T,)."""
        if self.whole:
            return self._by_step(self._replayed[0].right)
        return _frozen(np.nan_to_num(self._summed("right", self.T), nan=-1.0).astype(np.int64))

    @cached_property
    def regret_sum(self) -> Array:
        """D(t), the sum of r_i^2 so far, the final state included, (T + 1,)."""
        if not self.whole:
            return self._summed("regret_sum", self.T + 1)
        batch, observer = self._replayed
        return _frozen(np.append(self._by_step(batch.regret_sum), observer.regret_sum))

    @cached_property
    def nominal_regret_sum(self) -> Array:
        """D(t) of the nominal twin, (T + 1,)."""
        if not self.whole:
            return self._summed("nominal_regret_sum", self.T + 1)
        batch, observer = self._replayed
        return _frozen(np.append(self._by_step(batch.nominal_regret_sum), observer.nominal_regret_sum))

    @cached_property
    def gain(self) -> Array:
        """sqrt(C / sum |w|^2), the empirical gain, NaN until w is not 0, (T,)."""
        return _frozen(gain(self.cost_sum, self.energy_sum))

    @cached_property
    def gain_less_x0(self) -> Array:
        """The same less V(x(0)), which is what x(0) may have cost the oracle, and not what it cost this law, (T,)."""
        network = self.topology.network
        return _frozen(gain(self.cost_sum, self.energy_sum, float(storage(network.x0[None], network.a)[0])))

    @cached_property
    def ceiling(self) -> Array:
        """The least bound on the law's gain that is claimed at each step, NaN where none is, (T,); docs/guarantee.md.

        It bounds the gain from x(0) = 0. It is NaN too if the verdict has no bounds.
        """
        least = np.full(self.T, np.nan)
        for premise in Premise:
            told = self._bound(premise)
            if isinstance(told.get("gain"), float) and isinstance(told.get("steps"), int):
                covered = least[: max(0, told["steps"])]
                np.fmin(covered, told["gain"], out=covered)
        return _frozen(least)

    def _bound(self, premise: str) -> Mapping[str, Any]:
        """Return what the verdict holds of one bound; empty if it holds none."""
        found: Any = self.verdict
        for key in ("gain_bounds", "bounds", premise):
            found = found.get(key) if isinstance(found, Mapping) else None
        return found if isinstance(found, Mapping) else {}

    def certificate_slack(self, premise: str) -> Array:
        """Return the slack of the law's certificate at each step, NaN where `premise` no longer holds, (T,).

        `premise` is "estimates", "edges" or "jumps". Raises UserError if the verdict has no bound for it.
        """
        told = self._bound(premise)
        self.need_all("the slack of a certificate")
        if not isinstance(told.get("p"), list) or len(told["p"]) != len(self.ids):
            raise UserError(f"{self.folder}: verdict.json has no bound under the premise {premise!r}")
        p, steps = np.array(told["p"]), told["steps"]
        end, start = (self.x[1:] ** 2 * p).sum(axis=1), float((self.x[0] ** 2 * p).sum())
        slack = told["g"] * self.energy_sum + start - end - self.cost_sum
        return _frozen(np.where(np.arange(self.T) < steps, slack, np.nan))

    @property
    def metrics(self) -> dict[str, float | int | None]:
        """The numbers at the end, as verdict.json has them."""
        if not self.whole and self.verdict.get("metrics"):
            return dict(self.verdict["metrics"])
        return self._replayed[1].summary()

    def first_difference(self) -> Finding | None:
        """Replay the tables by the file and the law, and return the first difference; None if there is none.

        It loads and runs the code of the law. The tables do not keep what the nodes took in, so that is not compared.
        Raises UserError if the law cannot be loaded, and HedgerowError if a row is lost or the law fails.
        """
        self.need_all("a replay")
        links = np.empty((self.T, 2 * len(self.edges)), dtype=np.uint8)
        ends = at_ends(self.topology.graph)
        links[:, ends[:, 0]], links[:, ends[:, 1]] = self.i_hears, self.j_hears
        report = np.stack([self.ahat, self.margin], axis=1)
        replay = Replay(self.topology, receipts=False)
        replay.take(
            [
                Telemetry(
                    t, self.x[t], self.u[t], self.w[t], report[t], self.open[t].view(np.uint8), links[t], links[t]
                )
                for t in self._steps[self._steps < self.T].tolist()
            ]
        )
        if replay.doubt:
            raise HedgerowError(f"{self.folder}: {replay.doubt}", code=Code.UNKNOWN)
        return replay.finding

    def telemetry(self, kind: str = "arrow") -> Any:
        """The table of steps and nodes, as recorded: a pyarrow.Table, or a frame of "pandas" or "polars"."""
        return self.tables["telemetry"].frame(kind)

    def edges_table(self, kind: str = "arrow") -> Any:
        """The table of steps and edges, likewise."""
        return self.tables["edges"].frame(kind)

    def summary(self, kind: str = "arrow") -> Any:
        """The table of steps, likewise; UserError where `record:` says that there is none."""
        return self._summary.frame(kind)

    @property
    def _summary(self) -> Table:
        if "summary" not in self.tables:
            raise UserError(f"{self.folder}: has no summary, by `record:` of its topology.yaml")
        return self.tables["summary"]

    def _summed(self, name: str, rows: int) -> Array:
        """A column of the summary, (rows,)."""
        return _spread(self._summary.column(name, 1)[:, 0].astype(np.float64), self._summary.steps(1), rows, np.nan)

    @cached_property
    def _steps(self) -> Index:
        """The step of each row of telemetry, (K,)."""
        return self.tables["telemetry"].steps(len(self.ids)) if self.ids else self._summary.steps(1)

    def _of_nodes(self, name: str, rows: int, missing: float) -> Array:
        if not self.ids:
            return _frozen(np.empty((rows, 0)))
        return _spread(self.tables["telemetry"].column(name, len(self.ids)), self._steps, rows, missing)

    def _of_edges(self, name: str, missing: Any) -> NDArray[Any]:
        table, width = self.tables["edges"], len(self.edges)
        if not width:
            return _frozen(np.empty((self.T, 0), type(missing)))
        return _spread(table.column(name, width), table.steps(width), self.T, missing)

    def _by_step(self, values: NDArray[Any]) -> NDArray[Any]:
        """A row a step from a row a recorded step."""
        missing = {"f": np.nan, "i": -1}[values.dtype.kind]
        return _spread(values, self._steps, self.T, missing)

    @cached_property
    def _replayed(self) -> tuple[Batch, Observer]:
        """What the observer makes of this telemetry."""
        self.need_all("what was computed of every node")
        observer = Observer(self.topology)
        steps = self._steps[self._steps < self.T]
        # Who heard whom decides none of the numbers that are asked for here.
        links = 2 * len(self.edges)
        heard, took = np.ones(links, dtype=np.uint8), np.full(links, TAKEN, dtype=np.uint8)
        report = np.stack([self.ahat, self.margin], axis=1)
        with np.errstate(over="ignore", invalid="ignore"):  # numbers that grew too large say so by being infinite
            batches = [
                observer.take(
                    [
                        Telemetry(int(t), self.x[t], self.u[t], self.w[t], report[t], self.open[t], heard, took)
                        for t in part
                    ]
                )
                for part in np.array_split(steps, -(-len(steps) // _REPLAY_ROWS))
            ]
            observer.finish(End(self.T, self.x[-1], 0.0))
        whole = {one.name: np.concatenate([getattr(batch, one.name) for batch in batches]) for one in fields(Batch)}
        batch = Batch(**whole)
        if not np.array_equal(batch.x_oracle, self.x_oracle[steps], equal_nan=True):
            raise UserError(f"{self.folder}: topology.yaml is not that of this telemetry")
        return batch, observer


def _spread(values: NDArray[Any], steps: Index, rows: int, missing: Any) -> NDArray[Any]:
    """Rows at some ascending steps as one a step, `rows` of them."""
    known = int(np.searchsorted(steps, rows))
    if known == rows:
        return _frozen(values[:rows])
    # The steps are those that the file names: one number can ask for any number of rows.
    budget.require(f"{rows} steps", rows * values[:1].nbytes)
    spread = np.full((rows, *values.shape[1:]), missing, values.dtype)
    spread[steps[:known]] = values[:known]
    return _frozen(spread)


def _frozen(values: NDArray[Value]) -> NDArray[Value]:
    values.flags.writeable = False
    return values
