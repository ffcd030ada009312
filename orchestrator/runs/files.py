"""The files of a run folder except its tables: found, read, and refused with a clear message if damaged."""

from __future__ import annotations

import contextlib
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa
from pydantic import BaseModel, ValidationError

from hedgerow.topologies import budget, json_file
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.escape import shorten
from hedgerow.topologies.load import load
from hedgerow.topologies.paths import real_path
from hedgerow.topologies.regular_file import check_regular, read_regular
from hedgerow.topologies.schema import Topology
from hedgerow.topologies.wording import in_our_words


def find_run(run: str | Path) -> Path:
    """Return the folder of a run; raise UserError if there is none."""
    stamp = re.compile(re.escape(str(run)) + r"-\d{8}-\d{6}(-\d+)?")
    try:
        there = sorted(path for path in Path("runs").glob("*") if path.is_dir())
        named = [path for path in there if stamp.fullmatch(path.name)]
        own, listed_run = Path(str(run)), Path("runs") / str(run)
        both = (
            isinstance(run, str)
            and "/" not in run
            and all((path / "topology.yaml").is_file() for path in (own, listed_run))
        )
        if both and not own.samefile(listed_run):
            raise UserError(
                f"{run}: can be the run in {own} or the one in {listed_run}; write ./{own} or {listed_run}",
                code=Code.FILE_AMBIGUOUS,
            )
        for path in (own, listed_run, *named[-1:]):
            if path.is_dir():
                if not (path / "topology.yaml").is_file():
                    raise UserError(
                        f"{path}: is no folder of a run: there is no topology.yaml in it", code=Code.RUN_MISSING
                    )
                return real_path(path)
            if path.exists():
                raise UserError(f"{path}: is a file, and a run is a folder; name the folder", code=Code.RUN_MISSING)
    except OSError as error:
        raise UserError(
            f"{run}: {error.strerror}; check the path and its permissions", code=Code.FILE_UNREADABLE
        ) from None
    more = f", and {len(there) - 6} more" if len(there) > 6 else ""
    listed = f"; runs/ has {', '.join(path.name for path in there[-6:])}{more}" if there else ""
    raise UserError(
        f"{run}: there is no such run; name its folder, or its name in runs/{listed}", code=Code.RUN_MISSING
    )


def load_resolved(folder: Path) -> Topology:
    """Return the topology in a run folder; raise UserError if it is not the resolved one of that run."""
    file = folder / "topology.yaml"
    try:
        with reading(file):
            check_regular(file, inside=folder)
    except FileNotFoundError:
        raise UserError(f"{folder}: has no topology.yaml. Name the folder of a run.", code=Code.RUN_MISSING) from None
    topology = load(str(folder))
    try:
        network = topology.network  # this draws nothing, and raises an error if a number is random
    except (TypeError, ValueError, AttributeError):
        network = None
    if network is None:
        raise UserError(
            f"{file}: leaves numbers to chance, so it is not the resolved file of this run", code=Code.FILE_FORMAT
        ) from None
    return topology


@contextlib.contextmanager
def reading(file: Path) -> Iterator[None]:
    """Explain the error of a damaged or foreign file; FileNotFoundError passes."""
    try:
        yield
    except FileNotFoundError:
        raise
    except (OSError, ValueError, LookupError, TypeError, RecursionError, MemoryError, pa.ArrowException) as error:
        cause = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise UserError(
            f"{file}: cannot be read: {cause}; it is damaged, or no file of a run", code=Code.FILE_FORMAT
        ) from None


def read_file(file: Path, start: int = 0) -> bytes:
    """Return the content of a file of a run folder, from byte `start`; `json_file` bounds its parsed size.

    Raise UserError for a FIFO, a device, a link out of the folder, or more memory than allowed; FileNotFoundError
    passes.
    """
    with reading(file):
        return read_regular(file, file.parent, start=start)


def check_file(file: Path) -> int:
    """Return the size of a file of a run folder for a library that opens it by name; errors as in `read_file`."""
    with reading(file):
        return check_regular(file, file.parent).st_size


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
    """The keys of verdict.json that readers use."""

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


def read_verdict(folder: Path) -> dict[str, Any]:
    file = folder / "verdict.json"
    try:
        with reading(file):
            content: dict[str, Any] = json_file.loads(file, read_file(file))
        _Verdict.model_validate(content)
    except FileNotFoundError:
        return {}
    except ValidationError as error:
        wrong = error.errors(include_url=False)[0]
        place = ".".join(map(str, wrong["loc"])) or "all of it"
        raise UserError(
            f"{file}: is no verdict of this version: {shorten(place)}: {in_our_words(wrong)}; "
            "the run can be read without the file",
            code=Code.FILE_FORMAT,
        ) from None
    failed = [name for name, check in content["checks"].items() if not check["ok"]]
    if (content["verdict"] == "valid") != (not content["reasons"] and not failed):
        raise UserError(
            f"{file}: contradicts itself: the verdict is {shorten(content['verdict'])}, with "
            f"{len(content['reasons'])} reasons and {len(failed)} failed checks. Repeat the run with "
            "`orchestrator simulate`, or remove the file.",
            code=Code.FILE_FORMAT,
        )
    return content


def load_events(folder: Path) -> list[dict[str, Any]]:
    file = folder / "events.jsonl"
    try:
        with reading(file):
            return read_events(read_file(file), file)
    except FileNotFoundError:
        return []


def read_events(text: bytes, file: Path) -> list[dict[str, Any]]:
    """Return the events of complete lines; a killed writer may leave a partial one.

    Raise ValueError for an invalid line.
    """
    whole = text[: text.rfind(b"\n") + 1]
    budget.require(file, json_file.memory(whole))
    events = [json.loads(line) for line in whole.split(b"\n")[:-1]]
    for number, event in enumerate(events, 1):
        if not isinstance(event, dict) or not isinstance(event.get("event"), str):
            raise ValueError(f"line {number} is no event")
    return events
