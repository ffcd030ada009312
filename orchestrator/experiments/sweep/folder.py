"""The folder of a sweep: what it is of, a line a run as they come, and one table once all are there."""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from hedgerow.orchestrator.experiments.sweep.plan import Plan, typed
from hedgerow.orchestrator.experiments.sweep.runs import METRICS, Row
from hedgerow.orchestrator.ground.law_source import FOLDER as LAW
from hedgerow.orchestrator.ground.spelling import spelled
from hedgerow.orchestrator.runs.folder import write_json
from hedgerow.topologies.errors import UserError


def default_out(plan: Plan) -> Path:
    """The same command finds the same folder again, another one another."""
    digest = hashlib.sha256(json.dumps(plan.identity).encode()).hexdigest()
    return Path("sweeps") / f"{plan.name}-{digest[:8]}"


class SweepFolder:
    """Holds the rows of a sweep while the block runs, and lets no other write there; UserError for a wrong one."""

    def __init__(self, plan: Plan, path: Path) -> None:
        self.plan, self.path = plan, path
        self.table = path / "sweep.parquet"
        self._about, self._lines = path / "sweep.json", path / "runs.jsonl"
        self.rows: dict[tuple[int, int], Row] = {}
        """by (place of the setting, seed)"""

    def __enter__(self) -> SweepFolder:
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            self._refuse_another()
            self._file = self._lines.open("a+b")
        except OSError as error:
            raise UserError(f"--out {self.path}: {error.strerror}; name another folder") from None
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            self._file.close()
            raise UserError(f"--out {self.path}: a sweep is writing there; wait for it, or name another") from None
        try:
            if not self._about.exists():
                write_json(self._about, self.plan.identity)
                for source in self.plan.sources:
                    source.write(self.path / LAW)
            self._read()
        except BaseException as error:
            self._file.close()
            if isinstance(error, OSError):
                raise UserError(f"--out {self.path}: {error.strerror}; make room, or name another folder") from None
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with contextlib.suppress(OSError):  # of a full disk `append` has told
            self._file.close()

    def _refuse_another(self) -> None:
        wanted = self.plan.identity
        if not self._about.exists():
            if strange := next((one.name for one in self.path.iterdir() if one != self._lines), None):
                raise UserError(f"--out {self.path}: holds {strange}, and no sweep; name a new folder")
            return
        try:
            there = json.loads(self._about.read_text(encoding="utf-8"))
        except ValueError:
            raise UserError(f"--out {self.path}: sweep.json cannot be read; name a new folder") from None
        if other := _difference(there, wanted):
            raise UserError(f"--out {self.path}: holds another sweep: {other}; name another folder")

    def _read(self) -> None:
        """Take in the runs that are there; a line that was cut short is taken away."""
        self._file.seek(0)
        whole = 0
        for line in self._file:
            if not line.endswith(b"\n"):
                break
            try:
                row = json.loads(line)
                self.rows[row["setting"], row["seed"]] = row
            except (ValueError, LookupError, TypeError):
                raise UserError(f"{self._lines}: line {len(self.rows) + 1} is no run; name a new folder") from None
            whole += len(line)
        self._file.truncate(whole)

    def append(self, rows: Sequence[Row]) -> None:
        """Keep some runs, whatever becomes of us after this; UserError when the disk is full."""
        for row in rows:
            self.rows[row["setting"], row["seed"]] = row
        try:
            self._file.write("".join(json.dumps(row) + "\n" for row in rows).encode())
            self._file.flush()
        except OSError as error:
            raise UserError(f"{self._lines}: {error.strerror}; make room, then the same command goes on") from None

    @property
    def there(self) -> int:
        """How many of the runs that are asked for are there."""
        seeds = self.plan.seeds
        return sum(seed in seeds for _, seed in self.rows)

    def asked(self, setting: int) -> list[Row]:
        """The runs of a setting that are asked for, by seed; all must be there."""
        return [self.rows[setting, seed] for seed in self.plan.seeds]

    def write_table(self) -> None:
        """Write sweep.parquet, a row a run, by setting and then by seed: the same runs give the same bytes."""
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
        part = self.table.with_name(self.table.name + ".part")
        try:
            pq.write_table(pa.table(columns), spelled(part))
            part.replace(self.table)
        except OSError as error:
            part.unlink(missing_ok=True)
            raise UserError(f"{self.table}: {error.strerror}; make room, then the same command goes on") from None


def _difference(there: dict[str, Any], wanted: dict[str, Any]) -> str:
    """In what a sweep is not the one that is wanted, in words; nothing where it is."""
    there, wanted = ({**about, **{f"`{key}`": own for key, own in about["set"].items()}} for about in (there, wanted))
    for key in dict.fromkeys((*wanted, *there)):
        one, other = there.get(key), wanted.get(key)
        if one != other and key not in ("set", "versions", "networks", "laws"):
            apart = f"its {key} is {_said(one)}, not {_said(other)}"
            return f"only one of the two sets {key}" if None in (one, other) else apart
    if there.get("laws") != wanted.get("laws"):
        return "the source of its law was another, which it keeps in the folder law"
    if there["versions"] != wanted["versions"]:
        return "other versions made it"
    return "its topology file was another" if there["networks"] != wanted["networks"] else ""


def _said(value: Any) -> str:
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)
