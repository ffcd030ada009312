"""A run as arrays and tables, read from its folder: complete, interrupted, killed, or still in progress.

Each recorded array is read at its first use. The observer that computed the other arrays during the run computes them
again from the same telemetry, with the same bits.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hedgerow.orchestrator.metrics.certificate import storage
from hedgerow.orchestrator.metrics.fault_accounts import at_ends
from hedgerow.orchestrator.metrics.fault_schedule import Schedule
from hedgerow.orchestrator.metrics.observer import Batch, Observer, gain
from hedgerow.orchestrator.metrics.replay import Finding
from hedgerow.orchestrator.runs import guaranteed, replayed
from hedgerow.orchestrator.runs.difference import Estimates, equal, explain_estimates, lost_messages
from hedgerow.orchestrator.runs.properties import actions, flags, recomputed, states, total
from hedgerow.orchestrator.runs.recorded import NodeId, RecordedRows
from hedgerow.orchestrator.runs.rows import frozen
from hedgerow.topologies.describe import describe
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.graph import Array, Gain, Mask

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Pair = tuple[NodeId, NodeId]


@dataclass(frozen=True, eq=False, repr=False)
class Run(RecordedRows):
    """A run of T steps, n nodes and E edges, from a simulation, over Zenoh, from a test, or loaded from its folder.

    Row t of every array is step t. A row that was not recorded is NaN, -1 in `index` and `right`, and False in flags.
    Columns are nodes or edges in the order of the file; `record:` may select some of them. Arrays are read-only. Two
    runs are equal if all bits of their states, estimates, inputs and disturbances are equal. docs/theory.md has the
    formulas.
    """

    def __repr__(self) -> str:
        size = f"{self.T} steps of {len(self.ids)} nodes"
        if not self.whole:
            size = f"{self.T} steps, with rows for {self.selection}"
        return f"<Run {self.name}: {size}, {self.verdict.verdict or 'no verdict'}>"

    def __eq__(self, other: object) -> bool:
        return equal(self, other) if isinstance(other, Run) else NotImplemented

    __hash__ = None  # type: ignore[assignment]

    @property
    def law(self) -> str:
        """Return the name of the law, or `package.module:Class`."""
        return self.topology.law

    @property
    def b(self) -> Gain:
        """Return the gain b of equation (1): one number, or one per node, (n,)."""
        b = self.topology.network.b
        return b if isinstance(b, float) else frozen(b[self.selection.nodes])

    @cached_property
    def weights(self) -> Array:
        """Return the weight of each edge, (E,)."""
        weights = self.topology.graph.weights
        return frozen(np.ones(len(self.selection.edges)) if weights is None else weights[self.selection.edges])

    @cached_property
    def candidates(self) -> Array:
        """Return the candidates of each node, padded with NaN, (n, M)."""
        return frozen(self.topology.network.candidates[:, self.selection.nodes].T.copy())

    @cached_property
    def nominal(self) -> Array:
        """Return the a that the nominal controller assumes, (n,)."""
        return frozen(self.topology.network.nominal[self.selection.nodes])

    @cached_property
    def gamma_star(self) -> float:
        """Return the optimal gain of the oracle for the a of step 0."""
        return self.topology.network.gamma_star

    x = states("x")
    """States, (T + 1, n)."""
    x_oracle = states("x_oracle")
    """States of the oracle, the twin that knows every a, (T + 1, n)."""
    x_nominal = states("x_nominal")
    """States of the nominal twin, which assumes `nominal`, (T + 1, n)."""
    u = actions("u")
    """Inputs, NaN where the plant received none, (T, n)."""
    w = actions("w")
    """Disturbances, (T, n)."""
    ahat = actions("ahat")
    """Estimates, NaN where the agent was absent, (T, n)."""

    margin = actions("margin")
    """The margin J_(2) - J_(1) of the best candidate over the next, NaN where there is none, (T, n)."""

    @cached_property
    def index(self) -> NDArray[np.int32]:
        """Return the position of ahat among the candidates, from 0; -1 without an estimate, (T, n)."""
        return frozen(np.nan_to_num(self._of_nodes("index", self.T, np.nan), nan=-1.0).astype(np.int32))

    @cached_property
    def wrong(self) -> NDArray[np.bool_]:
        """Return True where ahat is a candidate other than the truth, (T, n)."""
        return frozen((self.index >= 0) & np.isfinite(self.ahat) & (self.ahat != self.a[: self.T]))

    @property
    def real_estimates(self) -> bool:
        """Return True if some estimate is not a candidate: the law estimates real numbers."""
        return bool((np.isfinite(self.ahat) & (self.index < 0)).any())

    @cached_property
    def u_edge(self) -> Array:
        """Return the input u_j - u_i of each edge (i, j), 0 where it was closed, (T, E)."""
        return self._of_edges("u_edge", np.nan)

    edge_open = flags("open")
    """True if an edge carried flow, (T, E)."""
    i_hears = flags("i_hears")
    """True if node i received the message of node j in the step in which j sent it, for each edge (i, j), (T, E)."""
    j_hears = flags("j_hears")
    """True if node j received the message of node i in the step in which i sent it, for each edge (i, j), (T, E)."""

    @cached_property
    def regret(self) -> Array:
        """Return the regret r_i = |x_i - x_i*| of each node, the paper's figure 4, (T + 1, n)."""
        return frozen(np.abs(self.x - self.x_oracle))

    @cached_property
    def nominal_gap(self) -> Array:
        """Return the distance |x_i* - x_i^nom| of the two twins, the paper's figure 5, (T + 1, n)."""
        return frozen(np.abs(self.x_oracle - self.x_nominal))

    @cached_property
    def a(self) -> Array:
        """Return the true a of each step, jumps included, (T, n)."""
        if self.whole:
            return self._by_step(self._observed[0].a)
        nodes = self.selection.nodes
        a = np.repeat(self.topology.network.a[None, nodes], self.T, axis=0)
        for jump in Schedule(self.topology).jumps(0):
            a[jump.start :, nodes == jump.targets[0]] = jump.a
        return frozen(a)

    a_ls = recomputed("a_ls")
    """The least-squares a of all earlier steps, received by the node or not; NaN at first, (T, n)."""
    beta = recomputed("beta")
    """The bias a_LS - a, (T, n)."""

    @cached_property
    def identifiable(self) -> Mask:
        """Return True where the candidate nearest to a_LS is the truth; the first of equally near ones counts, (T,
        n).
        """
        nearest = np.broadcast_to(self.candidates[:, 0], self.a_ls.shape)
        for rival in self.candidates.T[1:]:
            nearest = np.where(np.abs(self.a_ls - rival) < np.abs(self.a_ls - nearest), rival, nearest)
        return frozen((nearest == self.a) & np.isfinite(self.a_ls))

    @cached_property
    def faultless(self) -> bool:
        """Return True if all edges were open and no a jumped at any step, as gamma* assumes."""
        return bool(self.edge_open.all() and (self.a == self.a[:1]).all())

    cost = total("cost")
    """The cost c = |x|^2 + sum_e k_e u_e^2, (T,)."""
    cost_oracle = total("cost_oracle")
    """The cost c* of the oracle, (T,)."""
    cost_sum = total("cost_sum")
    """The cumulative cost C, (T,)."""
    cost_oracle_sum = total("cost_oracle_sum")
    """The cumulative cost C* of the oracle, (T,)."""
    energy_sum = total("energy_sum")
    """The cumulative sum of |w|^2, (T,)."""

    @cached_property
    def cost_regret(self) -> Array:
        """Return the cost regret R = C - C*, signed, (T,)."""
        return frozen(self.cost_sum - self.cost_oracle_sum)

    @cached_property
    def right(self) -> NDArray[np.int64]:
        """Return the number of right estimates, (T,)."""
        if self.whole:
            return self._by_step(self._observed[0].right)
        return frozen(np.nan_to_num(self._summed("right", self.T), nan=-1.0).astype(np.int64))

    @cached_property
    def regret_sum(self) -> Array:
        """Return the regret D(t), the cumulative sum of r_i^2 including the final state, (T + 1,)."""
        if not self.whole:
            return self._summed("regret_sum", self.T + 1)
        batch, observer = self._observed
        return frozen(np.append(self._by_step(batch.regret_sum), observer.regret_sum))

    @cached_property
    def nominal_regret_sum(self) -> Array:
        """Return the regret D(t) of the nominal twin, (T + 1,)."""
        if not self.whole:
            return self._summed("nominal_regret_sum", self.T + 1)
        batch, observer = self._observed
        return frozen(np.append(self._by_step(batch.nominal_regret_sum), observer.nominal_regret_sum))

    @cached_property
    def gain(self) -> Array:
        """Return the empirical gain sqrt(C / sum |w|^2), NaN until w is not 0, (T,)."""
        return frozen(gain(self.cost_sum, self.energy_sum))

    @cached_property
    def gain_less_x0(self) -> Array:
        """Return the empirical gain with V(x(0)), a bound on the oracle's cost of x(0), subtracted from C, (T,)."""
        network = self.topology.network
        return frozen(gain(self.cost_sum, self.energy_sum, float(storage(network.x0[None], network.a)[0])))

    @cached_property
    def ceiling(self) -> Array:
        """Return the smallest valid bound on the gain of the law at each step, NaN without one, (T,);
        docs/guarantee.md.

        It bounds the gain from x(0) = 0.
        """
        return frozen(guaranteed.ceiling(self))

    @cached_property
    def ceiling_slack(self) -> Array:
        """Return the slack of the bound in `ceiling` at each step, NaN where none is claimed, (T,)."""
        return frozen(guaranteed.ceiling_slack(self))

    def certificate_slack(self, premise: str) -> Array:
        """Return the slack of the certificate of the law at each step, NaN where `premise` fails, (T,).

        `premise` is "estimates", "edges" or "jumps". Raises UserError if the verdict has no bound for it.
        """
        return frozen(guaranteed.slack(self, premise))

    @property
    def metrics(self) -> dict[str, float | int | None]:
        """Return the final numbers, as in verdict.json."""
        if not self.whole and self.verdict.content.get("metrics"):
            return dict(self.verdict.content["metrics"])
        return self._observed[1].summary()

    def first_difference(self) -> Finding | None:
        """Replay the tables by the file, the law and the observer, and return the first difference, None without one.

        The number of steps must be that of the verdict. This loads and runs the code of the law. The tables do not hold
        the received messages, so those are not compared. Raises UserError if the law cannot be loaded, and
        HedgerowError if a row is lost or the law fails.
        """
        return replayed.first_difference(self)

    @cached_property
    def received(self) -> Mask:
        """Return True where the message of a step arrived in that step, by incidence of `topology.graph`, (T, 2E)."""
        self.need_all("the messages by incidence")
        received = np.empty((self.T, 2 * len(self.edges)), dtype=np.bool_)
        ends = at_ends(self.topology.graph)
        received[:, ends[:, 0]], received[:, ends[:, 1]] = self.i_hears, self.j_hears
        return frozen(received)

    @cached_property
    def truth(self) -> Array:
        """Return the true a before any jump, (n,)."""
        return frozen(self.topology.network.a[self.selection.nodes])

    def estimates_at(self, t: int) -> Estimates:
        """Return the estimate of every node at step t, from the samples of earlier steps, as a dict by node."""
        if not isinstance(t, int | np.integer) or not 0 <= t < self.T:
            raise UserError(
                f"t={t!r}: is no step of this run. Give a whole number from 0 to {self.T - 1}; "
                "for one node, write run.estimates_at(t)[node].",
                code=Code.OPTION,
            )
        return Estimates(self, t)

    def _edge(self, ends: Pair) -> tuple[int, bool]:
        """Return the column of an edge, and True if the file has its ends in the other order. Raises UserError."""
        if not isinstance(ends, tuple | list) or len(ends) != 2:
            raise UserError(f"{ends!r}: is no pair. Give both ends, such as {self._pair_of_nodes}.", code=Code.OPTION)
        pair = (self.column(ends[0]), self.column(ends[1]))
        for column, (i, j) in enumerate(self.edges.tolist()):
            if (i, j) in (pair, pair[::-1]):
                return column, (i, j) != pair
        raise UserError(f"{ends}: {ends[0]} and {ends[1]} are not neighbours", code=Code.OPTION)

    @property
    def _pair_of_nodes(self) -> Pair:
        i, j = self.edges[0].tolist() if len(self.edges) else (0, -1)
        return self.ids[i], self.ids[j]

    def missing(self, link: Pair) -> list[int]:
        """Return the steps with a lost or late message from the first node of `link` to the second."""
        column, turned = self._edge(link)
        arrived = self.i_hears if turned else self.j_hears
        return [int(t) for t in np.flatnonzero(~arrived[:, column])]

    def open(self, edge: Pair) -> list[int]:
        """Return the steps at which an edge carried flow."""
        return [int(t) for t in np.flatnonzero(self.edge_open[:, self._edge(edge)[0]])]

    def assert_same_estimates(self, other: Run, t: int | None = None) -> None:
        """Assert that all estimates of two runs are equal at step t, or at every step if t is None."""
        __tracebackhide__ = True  # pytest then shows the line of the test
        for step in range(min(self.T, other.T)) if t is None else [t]:
            mine, others = self.estimates_at(step), other.estimates_at(step)
            if mine != others:
                raise AssertionError("\n".join(explain_estimates(mine, others)))

    def describe(self) -> str:
        """Return the folder, the faults, the lost messages and the verdict, as lines of text."""
        faults = [f"fault {k}: {describe(fault)}" for k, fault in enumerate(self.topology.faults, start=1)]
        verdict = self.verdict.line() if self.verdict.content else "no verdict"
        return "\n  ".join([str(self.folder), *faults, lost_messages(self, self.T), verdict])

    def plot(self, *names: str) -> Figure:
        """Return a matplotlib figure with one panel per array, by default the states and the regret of each node.

        `names` are attributes with a row per step, such as "x", "ahat", "regret" or "gain". Raises UserError.
        """
        from hedgerow.orchestrator.runs.plot import plot  # noqa: PLC0415 (matplotlib takes a while to load)

        return plot(self, names or ("x", "regret"))

    def telemetry(self, kind: str = "arrow") -> Any:
        """Return the table of steps and nodes as a pyarrow.Table, or as a frame of "pandas" or "polars"."""
        return self.tables["telemetry"].frame(kind)

    def edges_table(self, kind: str = "arrow") -> Any:
        """Return the table of steps and edges; `kind` as for `telemetry`."""
        return self.tables["edges"].frame(kind)

    def summary(self, kind: str = "arrow") -> Any:
        """Return the table of steps; `kind` as for `telemetry`. Raises UserError if `record:` turned it off."""
        return self._summary.frame(kind)

    @cached_property
    def _observed(self) -> tuple[Batch, Observer]:
        """Return the result of the observer for this telemetry."""
        return replayed.observe(self)
