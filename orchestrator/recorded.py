"""A run read back from its folder, as arrays and tables: over, interrupted, killed, or as far as it has come.

What was recorded is read when it is first asked for. What was not is computed again by the observer that
computed it live, from the same telemetry, to the same bits.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from pydantic import BaseModel, ValidationError

from orchestrator.observe import Batch, Observer
from orchestrator.record import whole_batches
from topologies.errors import UserError
from topologies.graph import Array, Index, Mask
from topologies.hinf import gamma_star
from topologies.load import load
from topologies.resolve import truth
from topologies.schema import Topology
from wire.codec import TAKEN, End, Telemetry

Value = TypeVar("Value", bound=np.generic)
FRAMES = ("arrow", "pandas", "polars")
_REPLAY_ROWS = 1024


def load_run(run: str | Path = "runs/latest") -> RecordedRun:
    """What a run has left so far: `run` is its folder, its name in runs/, or a network's, for its youngest run there.

    Raises UserError where there is none, and where no step is recorded yet.
    """
    folder = find_run(run)
    tables = {name: Table(folder, name) for name in ("telemetry", "edges")}
    # The file of a run that goes on may gain faults: it is read after the steps that they strike.
    return RecordedRun(folder, load_resolved(folder), _verdict(folder), _events(folder), tables)


def load_resolved(folder: Path) -> Topology:
    """The topology in a run's folder; UserError if it is another than the resolved one that belongs there."""
    topology = load(str(folder))
    try:
        assert topology.network
    except (TypeError, ValueError, AttributeError, AssertionError):
        file = folder / "topology.yaml"
        raise UserError(f"{file}: leaves numbers to chance, so it is not the resolved file of this run") from None
    return topology


def find_run(run: str | Path) -> Path:
    """The folder of a run; raises UserError."""
    stamp = re.compile(re.escape(str(run)) + r"-\d{8}-\d{6}(-\d+)?")
    try:
        there = sorted(path for path in Path("runs").glob("*") if path.is_dir())
        named = [path for path in there if stamp.fullmatch(path.name)]
        for path in (Path(run), Path("runs") / run, *named[-1:]):
            if path.is_dir():
                if not (path / "topology.yaml").is_file():
                    raise UserError(f"{path}: is no folder of a run: there is no topology.yaml in it")
                return path.resolve()
    except OSError as error:
        raise UserError(f"{run}: {error.strerror}; check the path and its permissions") from None
    listed = f"; runs/ has {', '.join(path.name for path in there[-6:])}" if there else ""
    raise UserError(f"{run}: there is no such run; name its folder, or its name in runs/{listed}")


@contextlib.contextmanager
def reading(file: Path) -> Iterator[None]:
    """Say in words what is wrong with a file that came to harm, or that is another's; FileNotFoundError passes."""
    try:
        yield
    except FileNotFoundError:
        raise
    except (OSError, ValueError, LookupError, TypeError, RecursionError, MemoryError, pa.ArrowException) as error:
        said = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise UserError(f"{file}: cannot be read: {said}; it is damaged, or no file of a run") from None


class _Check(BaseModel):
    ok: bool
    claim: str
    steps: int | None = None
    step: int | None = None
    excess: float | None = None


class _Fault(BaseModel):
    what: str
    scheduled: int | None = None
    fired: int | None = None
    masked: int | None = None
    seen: int | None = None
    beyond: int | None = None


class _Verdict(BaseModel):
    """What readers of verdict.json go by."""

    verdict: str
    reasons: list[str]
    processes: int
    steps_per_s: float | None
    missing_inputs: int
    lost_messages: int
    forgotten_rows: int
    restarts: int
    faults: list[_Fault]
    checks: dict[str, _Check]
    metrics: dict[str, float | None]
    versions: dict[str, str]


def _verdict(folder: Path) -> dict[str, Any]:
    file = folder / "verdict.json"
    try:
        with reading(file):
            content: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
        _Verdict.model_validate(content)
    except FileNotFoundError:
        return {}
    except ValidationError as error:
        wrong = error.errors(include_url=False)[0]
        place = ".".join(map(str, wrong["loc"])) or "all of it"
        raise UserError(
            f"{file}: is no verdict of this version: {place}: {wrong['msg']}; the run can be read without the file"
        ) from None
    return content


def _events(folder: Path) -> list[dict[str, Any]]:
    file = folder / "events.jsonl"
    try:
        with reading(file):
            return read_events(file.read_bytes())
    except FileNotFoundError:
        return []


def read_events(text: bytes) -> list[dict[str, Any]]:
    """The events of whole lines, a killed writer leaves a piece of one; ValueError for what is none."""
    events = [json.loads(line) for line in text[: text.rfind(b"\n") + 1].split(b"\n")[:-1]]
    for number, event in enumerate(events, 1):
        if not isinstance(event, dict) or not isinstance(event.get("event"), str):
            raise ValueError(f"line {number} is no event")
    return events


class Table:
    """One table of a run: its Parquet file or, as long as there is none, the whole batches of its Arrow stream."""

    def __init__(self, folder: Path, name: str) -> None:
        self.parquet, stream = folder / f"{name}.parquet", folder / f"{name}.arrows"
        self._stream: Any = None
        with contextlib.suppress(FileNotFoundError), reading(stream):  # it has become the Parquet file just now
            if not self.parquet.exists() and stream.exists():
                self._stream = _so_far(stream)
        self.path = self.parquet if self._stream is None else stream
        try:
            with reading(self.parquet):
                self._file = pq.ParquetFile(self.parquet) if self._stream is None else None
        except FileNotFoundError:
            raise UserError(f"{folder}: no step of the run is recorded yet: there is no {name}.parquet") from None

    @property
    def over(self) -> bool:
        """Whether the Parquet file is there."""
        return self._file is not None

    @property
    def schema(self) -> Any:
        return self._stream.schema if self._file is None else self._file.schema_arrow

    def whole(self) -> Any:
        """A pyarrow.Table."""
        with reading(self.path):
            return self._stream if self._file is None else self._file.read()

    def batches(self) -> Iterator[Any]:
        """The same in parts that fit into memory."""
        with reading(self.path):
            yield from self._stream.to_batches() if self._file is None else self._file.iter_batches()

    def column(self, name: str, width: int) -> NDArray[Any]:
        """One column, a row a recorded step, (K, width); NaN where a number is null."""
        if name not in self.schema.names:
            raise UserError(f"{self.path}: has no column {name}: another version of hedgerow wrote it")
        with reading(self.path):
            table = self._stream if self._file is None else self._file.read(columns=[name])
            values: NDArray[Any] = table[name].to_numpy()
            if values.dtype.kind not in "fiub":
                raise ValueError(f"column {name} is of type {table[name].type}, or has gaps")
            return values.reshape(-1, width)

    def steps(self, width: int) -> Index:
        """The step of each row of `column`, (K,)."""
        rows = self._stream.num_rows if self._file is None else self._file.metadata.num_rows
        if rows % width:
            raise UserError(f"{self.path}: {rows} rows are no whole steps of {width}; topology.yaml is another's")
        if rows and rows == (self._last_step() + 1) * width:
            return np.arange(rows // width)
        steps: Index = self.column("step", width)[:, 0].astype(np.int64)
        if len(steps) and (steps[0] < 0 or (np.diff(steps) <= 0).any()):
            raise UserError(f"{self.path}: its steps do not ascend; it is damaged")
        return steps

    def _last_step(self) -> int:
        """Of a table with rows in it."""
        if "step" not in self.schema.names:
            return -1
        with reading(self.path):
            table = self._stream
            if self._file is not None:
                table = self._file.read_row_group(self._file.num_row_groups - 1, columns=["step"])
            last = table["step"][-1].as_py()
        return last if isinstance(last, int) else -1


def _so_far(stream: Path) -> Any:
    """An Arrow stream as a table that stays in the file, up to its last whole batch."""
    try:
        reader = pa.ipc.open_stream(pa.memory_map(str(stream)))
    except pa.ArrowInvalid:  # not even what the columns are
        raise UserError(f"{stream.parent}: no step of the run is recorded yet") from None
    return pa.Table.from_batches(whole_batches(reader), reader.schema)


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
    """What the observer computed live, computed again: a field of `orchestrator.observe.Batch`, (T,) or (T, n)."""
    return cached_property(lambda run: run._by_step(getattr(run._replayed[0], name)))


@dataclass(frozen=True, eq=False, repr=False)
class RecordedRun:
    """A run of T steps, n nodes and E edges, none of which can be changed.

    Row t of every array is step t; where its telemetry was lost, numbers are NaN, `index` and `right` -1, and flags
    False. Columns are nodes or edges in the order of the file. The formulas stand in docs/theory.md.
    """

    folder: Path
    topology: Topology
    """resolved, with all faults that there were"""
    verdict: Mapping[str, Any]
    """verdict.json; empty while the run goes on, and where `up` was killed"""
    events: Sequence[Mapping[str, Any]]
    """events.jsonl"""
    tables: Mapping[str, Table]
    """telemetry and edges"""

    def __post_init__(self) -> None:
        if self.topology.steps < self.T:
            raise UserError(
                f"{self.folder}: {self.T} steps of a run of {self.topology.steps}: the files are of two runs"
            )
        if not (self._steps < self.T).any():
            raise UserError(f"{self.folder}: no whole step of the run is recorded yet")

    def __repr__(self) -> str:
        size = f"{self.T} steps of {len(self.ids)} nodes"
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
        ends = [self._steps[-1:]]
        if len(self.edges):
            ends.append(self.tables["edges"].steps(len(self.edges))[-1:] + 1)
        return min(int(end[0]) if len(end) else 0 for end in ends)

    @property
    def b(self) -> float:
        return self.topology.b

    @property
    def ids(self) -> tuple[int | str, ...]:
        """Node ids in the order of the columns."""
        return tuple(self.topology.ids)

    @cached_property
    def edges(self) -> Index:
        """Where in `ids` the ends of each edge (i, j) stand, (E, 2)."""
        return _frozen(self.topology.graph.edges.copy())

    @cached_property
    def candidates(self) -> Array:
        """The list of each node, NaN behind its end, (n, M)."""
        return _frozen(self.topology.network.candidates.T.copy())

    @cached_property
    def nominal(self) -> Array:
        """What the nominal controller takes each a for, (n,)."""
        return _frozen(self.topology.network.nominal.copy())

    @cached_property
    def gamma_star(self) -> float:
        """The oracle's optimal gain, of the a at t = 0."""
        return gamma_star(truth(self.topology), self.b, self.topology.graph)

    @cached_property
    def lost(self) -> Index:
        """Steps before T whose telemetry never came; (0,) most often."""
        return _frozen(np.setdiff1d(np.arange(self.T), self._steps))

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

    a = _observed("a")
    """the truth, after the jumps so far, (T, n)"""
    a_ls = _observed("a_ls")
    """the least-squares a of the steps before, NaN at first, (T, n)"""
    cost = _observed("cost")
    """c = |x|^2 + |u_edge|^2, (T,)"""
    cost_oracle = _observed("cost_oracle")
    """that of the oracle's twin, (T,)"""
    cost_sum = _observed("cost_sum")
    """C, the sum of c so far, (T,)"""
    cost_oracle_sum = _observed("cost_oracle_sum")
    """C*, (T,)"""
    cost_regret = _observed("cost_regret")
    """R = C - C*, signed, (T,)"""
    energy_sum = _observed("energy_sum")
    """the sum of |w|^2 so far, (T,)"""

    @cached_property
    def right(self) -> NDArray[np.int64]:
        """How many ahat are the truth, (T,)."""
        return self._by_step(self._replayed[0].right)

    @cached_property
    def regret_sum(self) -> Array:
        """D(t), the sum of r_i^2 so far, the final state included, (T + 1,)."""
        batch, observer = self._replayed
        return _frozen(np.append(self._by_step(batch.regret_sum), observer.regret_sum))

    @cached_property
    def nominal_regret_sum(self) -> Array:
        """D(t) of the nominal twin, (T + 1,)."""
        batch, observer = self._replayed
        return _frozen(np.append(self._by_step(batch.nominal_regret_sum), observer.nominal_regret_sum))

    @cached_property
    def gain(self) -> Array:
        """sqrt(C / sum |w|^2), the empirical gain, NaN until w is not 0, (T,)."""
        return self._by_step(self._replayed[0].gain())

    @cached_property
    def gain_less_x0(self) -> Array:
        """The same without what x(0) may have cost, (T,)."""
        batch, observer = self._replayed
        return self._by_step(batch.gain(observer.v0))

    @property
    def metrics(self) -> dict[str, float | int | None]:
        """The numbers at the end, as verdict.json has them."""
        return self._replayed[1].summary()

    def telemetry(self, kind: str = "arrow") -> Any:
        """The table of steps and nodes, as recorded: a pyarrow.Table, or a frame of "pandas" or "polars"."""
        return _frame(self.tables["telemetry"], kind)

    def edges_table(self, kind: str = "arrow") -> Any:
        """The table of steps and edges, likewise."""
        return _frame(self.tables["edges"], kind)

    @cached_property
    def _steps(self) -> Index:
        """The step of each row of telemetry, (K,)."""
        return self.tables["telemetry"].steps(len(self.ids))

    def _of_nodes(self, name: str, rows: int, missing: float) -> Array:
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
        observer = Observer(self.topology)
        steps = self._steps[self._steps < self.T]
        # Who heard whom decides none of the numbers that are asked for here.
        links = 2 * len(self.edges)
        heard, took = np.ones(links, dtype=np.uint8), np.full(links, TAKEN, dtype=np.uint8)
        report = np.stack([self.ahat, self.index, self.margin], axis=2)
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
    spread = np.full((rows, *values.shape[1:]), missing, values.dtype)
    spread[steps[:known]] = values[:known]
    return _frozen(spread)


def _frozen(values: NDArray[Value]) -> NDArray[Value]:
    values.flags.writeable = False
    return values


def _frame(table: Table, kind: str) -> Any:
    if kind not in FRAMES:
        raise UserError(f"{kind!r} is no kind of table; there are {', '.join(FRAMES)}")
    if kind == "arrow":
        return table.whole()
    try:
        library = importlib.import_module(kind)
    except ModuleNotFoundError as error:
        if error.name != kind:
            raise
        raise UserError(f"{kind} is not installed; install it with: pip install {kind}") from None
    if kind == "polars":
        return library.from_arrow(table.whole())
    # With nulls in it, a column of whole numbers would become one of floats.
    return table.whole().to_pandas(types_mapper={pa.int32(): library.Int32Dtype()}.get)
