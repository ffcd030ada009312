"""The contract test of a law: a trial of a few milliseconds before every run.

A separate small network, with missing flows and a missing reading, gives the law a list of calls. The test compares the
law with itself: with two calls in a row, in another layout, restored from its memory, and restored for one node alone.
With a law that fails, a run would depend on the layout, or back-filling and restarts would make it wrong.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, NoReturn, cast

import numpy as np
from numpy.typing import NDArray

from hedgerow.agents.law import Array, Law
from hedgerow.agents.law_lines import line_of, place_of
from hedgerow.agents.loading import LawError, arguments, reals
from hedgerow.agents.local import Local, Received, asks
from hedgerow.topologies.archive import id_array
from hedgerow.topologies.graph import Gain, Index
from hedgerow.wire import crash
from hedgerow.wire.message import REPORT_ROWS

STEPS = 14
NODES = 5
_EDGES = ((0, 1), (1, 2), (1, 3), (3, 4))
_QUIET = 2
"""first steps at which all states are 0"""
_RESTORED = 8
"""the step after which the test saves the memory"""


class Trial(NamedTuple):
    """The network of a trial: ids (n,), the gain b, candidates (M, n) padded with NaN, and whether weights differ."""

    ids: Sequence[int | str]
    b: Gain
    candidates: Array
    weighted: bool = False

    @classmethod
    def default(cls) -> Trial:
        """Return a network with candidate lists of five lengths."""
        candidates = np.full((9, NODES), np.nan)
        for column, count in enumerate((9, 5, 2, 1, 9)):
            candidates[:count, column] = np.linspace(0.55, 0.95, count) if count > 1 else 0.8
        return cls(range(1, NODES + 1), 0.1, candidates)

    @classmethod
    def of(cls, ids: Sequence[int | str], b: Gain, candidates: Array, weighted: bool = False) -> Trial:
        """Return a network of NODES nodes of a larger one; a smaller one gets copies of its nodes."""
        chosen = np.linspace(0, len(ids) - 1, NODES).round().astype(int)
        if len(ids) < NODES:
            chosen = np.arange(NODES) % len(ids)
        known = [ids[k] for k in dict.fromkeys(chosen.tolist())]
        more = (number for number in range(1, 2 * NODES + 1) if number not in known)
        names = known + [next(more) for _ in range(NODES - len(known))]
        return cls(names, b if isinstance(b, float) else b[chosen], candidates[:, chosen], weighted)


class _Call(NamedTuple):
    """A call of `learn` (t, x, flow, x_next) or of `act` (t, x), with the record for a law that asks."""

    t: int
    x: Array
    flow: Array | None
    x_next: Array | None
    received: Received

    @property
    def method(self) -> str:
        return "act" if self.flow is None else "learn"

    def of(self, nodes: Index, incidences: Index) -> _Call:
        """Return the call for some of the nodes."""
        h = self.received
        return _Call(
            self.t,
            self.x[nodes],
            None if self.flow is None else self.flow[nodes],
            None if self.x_next is None else self.x_next[nodes],
            Received(h.t, h.nodes[nodes], h.x[incidences], h.u[incidences], h.step[incidences]),
        )

    def only(self, node: int) -> _Call:
        """Return the call of `learn` for one node, as for a sample that is learned again."""
        chosen = np.arange(len(self.x)) == node
        flow = None if self.flow is None else np.where(chosen, self.flow, np.nan)
        return self._replace(flow=flow, received=self.received._replace(nodes=chosen))


class _After(NamedTuple):
    """The law after a call: its memory, and after `act` the inputs and the report as well."""

    memory: NDArray[Any]
    u: Array | None
    report: Array | None


def check_law(
    law: type[Any],
    trial: Trial | None = None,
    parameters: Mapping[str, Any] | None = None,
    name: str | None = None,
    seed: int = 0,
    on_call: Callable[[], None] = lambda: None,
) -> None:
    """Raise LawError with the line, the method, the node and a fix if a law breaks the contract.

    `trial` is the network of the test, by default one of five nodes. `parameters` are those of the law. `name` is the
    name of the law in messages. `on_call` is called before every call of the law.
    """
    known = name or f"{law.__module__}:{law.__qualname__}"
    test = _Test(law, trial or Trial.default(), parameters or {}, known, seed, on_call)
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        test.run()


class _Test:
    def __init__(
        self,
        law: type[Any],
        trial: Trial,
        parameters: Mapping[str, Any],
        name: str,
        seed: int,
        on_call: Callable[[], None],
    ) -> None:
        self._on_call = on_call
        self._law, self._trial, self._parameters, self._name, self._seed = law, trial, parameters, name, seed
        ends = sorted([*_EDGES, *((j, i) for i, j in _EDGES)])
        self._row, self._other = np.array(ends, dtype=np.int64).T
        self._weight = np.ones(len(ends))
        if self._trial.weighted:
            self._weight += 0.25 * ((self._row + self._other) % 5)  # both ends of an edge have the same
        self._all = np.arange(NODES)
        asked = {"act": "now", "learn": "sample"}
        self._asks = {method: asks(getattr(law, method, None), name) for method, name in asked.items()}
        self._calls: list[_Call] = []
        self._after: list[_After] = []

    def run(self) -> None:
        law = self._new(self._all)
        blank = self._memory(law, NODES)
        self._record(law)
        self._compare(self._new(self._all), self._calls, self._all, "another object of the class", _UNREPEATABLE)
        for nodes in ([0], [1], [4], [0, 2, 3]):
            self._compare(self._new(np.array(nodes)), self._calls, np.array(nodes), "another layout", _MIXES)
        for nodes in ([1], [2], [3]):
            if np.isnan(self._trial.candidates[:, nodes]).all(axis=1).any():
                other = self._new(np.array(nodes), padded=False)
                self._compare(other, self._calls, np.array(nodes), _SHORTER, _PADDING, remembered=False)
        self._restore(law, blank)

    # The law.

    def _new(self, nodes: Index, padded: bool = True) -> Law:
        """Return a law of some nodes; with `padded`, it has the rows of candidates in which only other nodes have one.

        In a run, a process does not have these rows.
        """
        trial = self._trial
        b = trial.b if isinstance(trial.b, float) else trial.b[nodes]
        listed = trial.candidates[:, nodes]
        if not padded:
            listed = listed[~np.isnan(listed).all(axis=1)]
        listed = np.ascontiguousarray(listed)
        candidates = listed.copy()
        self._on_call()
        try:
            more = arguments(self._law, self._parameters)
            if asks(self._law.__init__, "local"):
                more["local"] = self._local(nodes, b, candidates)
            law: Law = self._law(b, candidates, **more)
        except (Exception, SystemExit) as error:
            self._raised("__init__", error)
        if (node := _differ(candidates, listed, nodes)) is not None:
            self._broken("__init__", node, "changes its argument candidates", _copy("candidates"))
        return law

    def _local(self, nodes: Index, b: Gain, candidates: Array) -> Local:
        incidences = self._of(nodes)
        place = {node: k for k, node in enumerate(nodes.tolist())}
        ids = id_array(list(self._trial.ids))
        return Local(
            ids=ids[nodes],
            b=b,
            candidates=candidates,
            node=np.array([place[i] for i in self._row[incidences].tolist()], dtype=np.int64),
            neighbour=ids[self._other[incidences]],
            weight=self._weight[incidences],
            parameters=self._parameters,
            seeds=self._seed,
        )

    def _of(self, nodes: Index) -> Index:
        return np.flatnonzero(np.isin(self._row, nodes))

    def _memory(self, law: Law, k: int, method: str = "memory") -> NDArray[Any]:
        """Return a copy of the memory."""
        try:
            memory: Any = law.memory
        except (Exception, SystemExit) as error:
            self._raised("memory", error)
        problem = ""
        if not isinstance(memory, np.ndarray):
            problem = f"the type {type(memory).__name__}"
        elif memory.dtype.kind not in "biufc":
            problem = f"elements of the type {memory.dtype}"
        elif memory.shape[-1:] != (k,):
            problem = f"the shape {memory.shape}"
        if problem:
            problem = f"has {problem}" if method == "memory" else f"leaves a memory that has {problem}"
            cure = f"Make it an array of numbers with a last axis of the {k} nodes, (…, {k})."
            self._broken(method, None, problem, cure)
        return cast(NDArray[Any], memory.copy())

    # The calls.

    def _record(self, law: Law) -> None:
        """Run the law on the network of the test, check every call, and keep all calls and answers."""
        rng = np.random.default_rng(1)
        listed = self._trial.candidates
        a = np.array([column[~np.isnan(column)][0] for column in listed.T])
        x, u = np.zeros(NODES), np.zeros(NODES)
        heard_x, heard_u = np.full(len(self._row), np.nan), np.full(len(self._row), np.nan)
        step = np.full(len(self._row), -1)
        everybody = np.ones(NODES, dtype=bool)
        truth = x
        for t in range(STEPS):
            if t:
                flow: Array = np.bincount(self._row, self._weight * (u[self._row] - u[self._other]), NODES)  # type: ignore[assignment]
                w = rng.normal(0.0, 2.0, NODES) if t >= _QUIET else np.zeros(NODES)
                past, truth = truth, a * truth + self._trial.b * flow + w
                lost = _lost(t, self._row)
                flow[np.unique(self._row[lost])] = np.nan
                x, x_next = _read(past, t - 1), _read(truth, t)
                flow[np.isnan(x + x_next)] = np.nan
                lost |= np.isnan(x[self._other])  # a neighbour without a reading has no state and no input
                got_x, got_u = (np.where(lost, np.nan, values[self._other]) for values in (x, u))
                sample = Received(t - 1, everybody.copy(), got_x, got_u, np.where(lost, -1, t - 1))
                heard_x, heard_u = np.where(lost, heard_x, got_x), np.where(lost, heard_u, got_u)
                step = np.where(lost, step, t - 1)
                self._learn(law, _Call(t - 1, x, flow, x_next, sample))
                x = x_next
            u = self._act(law, _Call(t, x, None, None, Received(t, everybody.copy(), heard_x, heard_u, step)))

    def _learn(self, law: Law, call: _Call) -> None:
        before = self._memory(law, NODES)
        self._call(law, call)
        after = self._memory(law, NODES, "learn")
        if (after.shape, after.dtype) != (before.shape, before.dtype):
            grown = f"{before.dtype} {before.shape} to {after.dtype} {after.shape}"
            self._broken("learn", None, f"changes the memory from {grown}", _FIXED)
        missing = np.isnan(cast(Array, call.flow))
        if (node := _differ(before[..., missing], after[..., missing], np.flatnonzero(missing))) is not None:
            self._broken(
                "learn",
                node,
                "changes the memory of a node without a flow (NaN)",
                "Leave that column as it is, for example with np.where(np.isfinite(flow), new, self.memory).",
            )
        self._calls.append(call)
        self._after.append(_After(after, None, None))

    def _act(self, law: Law, call: _Call) -> Array:
        before = self._memory(law, NODES)
        u = self._call(law, call)
        self._unchanged(law, "act", before)
        report = self._report(law, NODES)
        self._unchanged(law, "report", before)
        again, report_again = self._call(law, call), self._report(law, NODES)
        if (node := _differ(u, again, self._all)) is not None:
            self._broken("act", node, "returns another input when it is called again", _UNREPEATABLE)
        if (node := _differ(report, report_again, self._all)) is not None:
            self._broken("report", node, "returns another report when it is called again", _UNREPEATABLE)
        self._calls.append(call)
        self._after.append(_After(before, u, report))
        return np.nan_to_num(u)

    def _unchanged(self, law: Law, method: str, before: NDArray[Any]) -> None:
        if (node := _differ(before, self._memory(law, NODES, method), self._all)) is not None:
            self._broken(method, node, "changes the memory", "Change the memory in learn() alone.")

    def _call(self, law: Law, call: _Call) -> Array:
        """Make one call; return a copy of the inputs of `act`."""
        self._on_call()
        k = len(call.x)
        given = [one.copy() for one in (call.x, call.flow, call.x_next) if one is not None]
        method = getattr(law, call.method)
        record = [call.received.at(call.t)] if self._asks[call.method] else []
        try:
            answer = method(*given, *record)
            u = np.zeros(k) if call.flow is not None else reals(answer)
        except (Exception, SystemExit) as error:
            self._raised(call.method, error)
        for name, one, kept in zip(("x", "flow", "x_next"), given, (call.x, call.flow, call.x_next), strict=False):
            if (node := _differ(one, cast(Array, kept), self._all)) is not None:
                self._broken(call.method, node, f"changes its argument {name}", _copy(name))
        if u.shape != (k,):
            self._broken("act", None, f"returns the shape {u.shape}", f"Return one input per node, ({k},).")
        bad = ~np.isfinite(u) & np.isfinite(call.x)
        if bad.any():
            node = int(np.flatnonzero(bad)[0])
            problem = f"returns {u[node]} for the state {call.x[node]:g} at step {call.t}"
            more = ", and neighbours without a value (NaN, step -1)" if record else ""
            self._broken(
                "act", node if k == NODES else None, problem, f"Return a finite input; mind divisions by 0{more}."
            )
        return u

    def _report(self, law: Law, k: int) -> Array:
        try:
            report = reals(law.report())
        except (Exception, SystemExit) as error:
            self._raised("report", error)
        if report.shape != (REPORT_ROWS, k):
            cure = f"Return the estimate and the margin of every node, {(REPORT_ROWS, k)}, NaN where there is none."
            self._broken("report", None, f"returns the shape {report.shape}", cure)
        return report

    # The law compared with itself.

    def _compare(
        self,
        law: Law,
        calls: Sequence[_Call],
        nodes: Index,
        what: str,
        cure: str,
        begin: int = 0,
        remembered: bool = True,
    ) -> None:
        """Make calls to a law of some nodes and compare it with the recorded answers after each.

        Without `remembered`, the memory may have another shape and is not compared.
        """
        incidences = self._of(nodes)
        for call, after in zip(calls, self._after[begin:], strict=True):
            u = self._call(law, call.of(nodes, incidences))
            memory = self._memory(law, len(nodes), call.method)
            if remembered and (node := _differ(memory, after.memory[..., nodes], nodes)) is not None:
                self._broken(call.method, node, f"learns something else in {what}", cure)
            if after.u is None or after.report is None:
                continue
            if (node := _differ(u, after.u[nodes], nodes)) is not None:
                self._broken("act", node, f"returns another input in {what}", cure)
            if (node := _differ(self._report(law, len(nodes)), after.report[:, nodes], nodes)) is not None:
                self._broken("report", node, f"returns another report in {what}", cure)

    def _restore(self, law: Law, blank: NDArray[Any]) -> None:
        """Restore the memory of the middle of the trial, then that of one node alone from the beginning."""
        begin = next(k for k, call in enumerate(self._calls) if call.t == _RESTORED and call.method == "act")
        self._assign(law, self._after[begin].memory.copy())
        what = "a law with a restored memory"
        self._compare(law, self._calls[begin:], self._all, what, _HIDDEN, begin)
        last, node = self._after[-1].memory, 1
        partly = self._memory(law, NODES)
        partly[..., node] = blank[..., node]
        self._assign(law, partly)
        for call in self._calls:
            if call.method == "learn":
                self._call(law, call.only(node))
        if (wrong := _differ(self._memory(law, NODES), last, self._all)) is not None:
            problem = "learns something else when one node learns its past again"
            self._broken("learn", wrong, problem, _HIDDEN)

    def _assign(self, law: Law, memory: NDArray[Any]) -> None:
        kept = memory.copy()
        try:
            law.memory = memory
        except (Exception, SystemExit) as error:
            self._raised("memory", error)
        if (node := _differ(self._memory(law, NODES), kept, self._all)) is not None:
            cure = "Keep all of the array that is assigned, and return it unchanged."
            self._broken("memory", node, "is not what was assigned to it", cure)

    # Errors.

    def _broken(self, method: str, node: int | None, what: str, cure: str) -> NoReturn:
        of = "" if node is None else f" of node {self._trial.ids[node]}"
        called = "memory" if method == "memory" else f"{method}()"
        where = line_of(self._law, method)
        text = f"{where}law {self._name} breaks the contract of laws: {called}{of} {what}. {cure}{self._lists(node)}"
        raise LawError(text, method=method, node=None if node is None else self._trial.ids[node])

    def _raised(self, method: str, error: BaseException) -> NoReturn:
        if isinstance(error, SystemExit) and type(error) is not SystemExit:
            raise error  # of a signal handler of ours, and not of the law
        called = "memory" if method == "memory" else f"{method}()"
        problem = f"{called} raised {crash.summary(error)}. Correct that line.{self._lists(None)}"
        where = place_of(error, self._law) or line_of(self._law, method)
        raise LawError(f"{where}law {self._name}: {problem}", method=method) from error

    def _lists(self, node: int | None) -> str:
        """Return a sentence about the candidates of a node, or of all, if a law can fail at their number."""
        counts: list[int] = (~np.isnan(self._trial.candidates)).sum(axis=0).tolist()
        most = max(counts)
        if node is not None:
            ends = f", and {most - counts[node]} NaN behind them" if counts[node] < most else ""
            return f" Its list has {counts[node]} of {most} candidates{ends}." if ends or most == 1 else ""
        if min(counts) == most > 1:
            return ""
        return f" The nodes have lists of {', '.join(map(str, counts))} candidates; shorter ones end with NaN."


def _copy(name: str) -> str:
    return f"Copy it first: {name} = {name}.copy()."


_UNREPEATABLE = "Let it depend on its arguments and on the memory alone: not on a clock, a counter or random numbers."
_MIXES = (
    "Let each column depend on its own node alone. Sum over candidates in the same order for one node as for several."
)
_SHORTER = "a layout without the longer lists of other nodes"
_PADDING = "Do not count the rows of candidates: behind the end of a list they are NaN, and other processes lack them."
_FIXED = "Give the memory its last shape and type in the constructor: old copies of it are assigned again."
_HIDDEN = "Keep everything that learn() changes in memory, in the column of its node."


_LOST = {4: (1,), 6: (3, 4), 8: tuple(range(NODES))}
"""by step: the nodes that receive no message of the step before"""


def _lost(t: int, row: Index) -> NDArray[np.bool_]:
    """Return the incidences that lose their message of step t - 1."""
    return np.isin(row, _LOST.get(t, ()))


def _read(x: Array, t: int) -> Array:
    """Return the readings of the states: node 2 has none at one step."""
    read = x.copy()
    if t == 10:
        read[2] = np.nan
    return read


def _differ(one: NDArray[Any], other: NDArray[Any], nodes: Index) -> int | None:
    """Return the first node with different columns, None if there is none; NaN equals NaN."""
    if one.shape != other.shape:
        return int(nodes[0]) if len(nodes) else None
    if one.dtype == other.dtype and one.tobytes() == other.tobytes():
        return None
    apart = ~((one == other) | (np.isnan(one) & np.isnan(other)))
    columns = np.flatnonzero(apart.reshape(-1, one.shape[-1]).any(axis=0)) if apart.size else np.empty(0, int)
    return int(nodes[columns[0]]) if len(columns) else None
