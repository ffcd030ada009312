"""The folder of a sweep: its plan, one line per finished run, and one table at the end."""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from hedgerow.orchestrator.experiments.sweep.plan import Plan, typed
from hedgerow.orchestrator.experiments.sweep.runs import METRICS, Row
from hedgerow.orchestrator.ground.law_source import FOLDER as LAW
from hedgerow.orchestrator.ground.spelling import spelled
from hedgerow.orchestrator.runs.folder import write_json
from hedgerow.topologies import budget
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.json_file import read_json
from hedgerow.topologies.paths import beside, why_no_folder
from hedgerow.topologies.regular_file import check_regular


def default_out(plan: Plan) -> Path:
    """Return the default folder, which is the same for the same command and differs for others."""
    digest = hashlib.sha256(json.dumps(plan.identity).encode()).hexdigest()
    return Path("sweeps") / f"{plan.name}-{digest[:8]}"


class SweepFolder:
    """The rows of a sweep; while the block runs, no other process may write there.

    Raises UserError for another sweep.
    """

    def __init__(self, plan: Plan, path: Path, metrics: Sequence[str] = (*METRICS, "share_right")) -> None:
        """Prepare the folder; `metrics` are the numbers of a row."""
        self.plan, self.path = plan, path
        self._keys = _keys(metrics)
        self.table = path / "sweep.parquet"
        self._about, self._lines = path / "sweep.json", path / "runs.jsonl"
        self.rows: dict[tuple[int, int], Row] = {}
        """the rows by (place of the setting, seed)"""

    def __enter__(self) -> SweepFolder:
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            self._refuse_another()
            if self._lines.is_symlink() or self._lines.exists():
                budget.require(self._lines, _GROWTH * check_regular(self._lines, self.path).st_size)
            self._file = self._lines.open("a+b")
        except OSError as error:
            raise UserError(
                f"--out {self.path}: {why_no_folder(error)}; name another folder", code=Code.OUTPUT
            ) from None
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            self._file.close()
            raise UserError(
                f"--out {self.path}: another command is writing there; wait for it, or name another", code=Code.OUTPUT
            ) from None
        try:
            if not self._about.exists():
                write_json(self._about, self.plan.identity)
                for source in self.plan.sources:
                    source.write(self.path / LAW)
            self._read()
        except BaseException as error:
            self._file.close()
            if isinstance(error, OSError):
                raise UserError(
                    f"--out {self.path}: {error.strerror}; make room, or name another folder", code=Code.OUTPUT
                ) from None
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with contextlib.suppress(OSError):  # `append` has reported a full disk
            self._file.close()

    def _refuse_another(self) -> None:
        wanted = self.plan.identity
        if not self._about.exists():
            if strange := next((one.name for one in self.path.iterdir() if one != self._lines), None):
                raise UserError(
                    f"--out {self.path}: holds {strange} of something else. Name a new folder.",
                    code=Code.OUTPUT,
                )
            return
        there = read_json(self._about, self.path)
        if not (
            isinstance(there, dict)
            and isinstance(there.get("set"), dict)
            and all(isinstance(there.get(key), type(wanted[key])) for key in ("versions", "networks"))
        ):
            raise UserError(
                f"--out {self.path}: its sweep.json is not of this command. Name a new folder.", code=Code.FILE_FORMAT
            )
        if other := _difference(there, wanted):
            raise UserError(
                f"--out {self.path}: holds runs with other settings: {other}. Name another folder.", code=Code.OUTPUT
            )

    def _read(self) -> None:
        """Read the finished runs; remove an incomplete last line."""
        self._file.seek(0)
        whole = 0
        for line in self._file:
            if not line.endswith(b"\n"):
                break
            try:
                row = _row(json.loads(line), len(self.plan.settings), self._keys)
                self.rows[row["setting"], row["seed"]] = row
            except (ValueError, LookupError, TypeError, RecursionError):
                raise UserError(
                    f"{self._lines}: line {len(self.rows) + 1} is no run; name a new folder", code=Code.FILE_FORMAT
                ) from None
            whole += len(line)
        self._file.truncate(whole)

    def append(self, rows: Sequence[Row]) -> None:
        """Store some runs safely on the disk; raise UserError if it is full."""
        for row in rows:
            self.rows[row["setting"], row["seed"]] = row
        try:
            self._file.write("".join(json.dumps(row) + "\n" for row in rows).encode())
            self._file.flush()
        except OSError as error:
            raise UserError(
                f"{self._lines}: {error.strerror}; free space, then the same command continues", code=Code.OUTPUT
            ) from None

    @property
    def there(self) -> int:
        """Return the number of requested runs that are done."""
        seeds = self.plan.seeds
        return sum(seed in seeds for _, seed in self.rows)

    def asked(self, setting: int) -> list[Row]:
        """Return the requested runs of a setting, by seed; all must be done."""
        return [self.rows[setting, seed] for seed in self.plan.seeds]

    def write_table(self) -> None:
        """Write sweep.parquet, one row per run, by setting and then by seed: the same runs give the same bytes."""
        import pyarrow as pa  # noqa: PLC0415
        import pyarrow.parquet as pq  # noqa: PLC0415

        plan = self.plan
        rows = [row for k in range(len(plan.settings)) for row in self.asked(k)]
        columns: dict[str, Any] = {}
        for key, values in zip(plan.keys, zip(*(one.values for one in plan.settings), strict=True), strict=True):
            columns[key] = pa.array([value for value in typed(values) for _ in plan.seeds])
        columns["seed"] = pa.array([row["seed"] for row in rows], pa.int64())
        for name in (*METRICS, "share_right"):
            kind = pa.int64() if name == "nodes_right" else pa.float64()
            columns[name] = pa.array([row.get(name) for row in rows], kind)
        for name in ("verdict", "reasons"):
            columns[name] = pa.array([row[name] for row in rows], pa.string())
        part = beside(self.table)
        try:
            pq.write_table(pa.table(columns), spelled(part))
            part.replace(self.table)
        except OSError as error:
            raise UserError(
                f"{self.table}: {error.strerror}; free space, then the same command continues", code=Code.OUTPUT
            ) from None
        finally:
            part.unlink(missing_ok=True)


_GROWTH = 4
"""the memory per byte of runs.jsonl; its lines repeat the same few keys"""


def _keys(metrics: Sequence[str]) -> dict[str, Any]:
    """Return the keys of a row, each with the type of its value."""
    return {
        **dict.fromkeys(("setting", "seed"), int),
        **{name: int | None if name == "nodes_right" else int | float | None for name in metrics},
        **dict.fromkeys(("verdict", "reasons"), str),
    }


def _row(row: Any, settings: int, keys: Mapping[str, Any]) -> Row:
    """Return the run in a line, with its known keys; raise LookupError, TypeError or ValueError if it is invalid."""
    if not all(isinstance(row[key], kind) and not isinstance(row[key], bool) for key, kind in keys.items()):
        raise TypeError("a value is of another type")
    # A metric becomes a float64, which holds every whole number up to 2**53.
    most = {"seed": 2**63 - 1}
    if row["setting"] not in range(settings) or any(
        isinstance(row[key], int) and abs(row[key]) > most.get(key, 2**53) for key in keys
    ):
        raise ValueError("a number is out of range")
    return {key: row[key] for key in keys}


def _difference(there: dict[str, Any], wanted: dict[str, Any]) -> str:
    """Return the difference between a sweep and the requested one, in words; empty if there is none."""
    there, wanted = ({**about, **{f"`{key}`": own for key, own in about["set"].items()}} for about in (there, wanted))
    for key in dict.fromkeys((*wanted, *there)):
        one, other = there.get(key), wanted.get(key)
        if one != other and key not in ("set", "versions", "networks", "laws"):
            if None in (one, other):
                return f"only {'this command' if one is None else 'the other'} sets {key}"
            return f"{key} is {_said(one)} there, and {_said(other)} in this command"
    if there.get("laws") != wanted.get("laws"):
        return "the source of the law has changed since; the folder law keeps the old source"
    if there["versions"] != wanted["versions"]:
        return "other versions of Hedgerow or its packages made it"
    return "the topology file has changed since" if there["networks"] != wanted["networks"] else ""


def _said(value: Any) -> str:
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)
