"""The run folders of a directory, with the verdict of each."""

from __future__ import annotations

import shutil
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from hedgerow.orchestrator.runs.files import read_verdict
from hedgerow.topologies.errors import Code, HedgerowError, UserError


@dataclass(frozen=True)
class Listed:
    """One run folder."""

    run: str
    """The name of the folder."""
    folder: Path
    began: float
    """Seconds since 1970 at which the folder was made."""
    verdict: str
    """valid, INVALID or unknown; `running`; `none` without a verdict; `unreadable` if verdict.json is damaged."""
    network: str
    """The name of the network; empty without a verdict."""
    law: str
    steps_done: int | None
    steps: int | None
    regret: float | None
    """The regret D at the end."""
    size: int
    """Bytes on disk."""


def listed(directory: Path, running: Collection[str]) -> list[Listed]:
    """Return the run folders of `directory`, newest first. `running` holds the folders of the running networks."""
    try:
        folders = [path for path in directory.iterdir() if not path.is_symlink() and (path / "topology.yaml").is_file()]
    except FileNotFoundError:
        return []
    except OSError as error:
        raise UserError(f"{directory}: {error.strerror}. Name another folder.", code=Code.FILE_MISSING) from None
    found = [_listed(path, str(path.resolve()) in running) for path in folders]
    return sorted(found, key=lambda one: (one.began, one.run), reverse=True)


def _listed(path: Path, runs: bool) -> Listed:
    files = [one.stat() for one in path.rglob("*") if one.is_file() and not one.is_symlink()]
    try:
        content = read_verdict(path)
        word = content.get("verdict", "none")
    except HedgerowError:
        content, word = {}, "unreadable"
    return Listed(
        run=path.name,
        folder=path,
        began=min((one.st_mtime for one in files), default=path.stat().st_mtime),
        verdict="running" if runs else word,
        network=content.get("name", ""),
        law=content.get("law", ""),
        steps_done=content.get("steps_done"),
        steps=content.get("steps"),
        regret=content.get("metrics", {}).get("regret"),
        size=sum(one.st_size for one in files),
    )


def removable(runs: Sequence[Listed], keep: int) -> list[Listed]:
    """Return the runs after the newest `keep`, except those that are running."""
    return [one for one in runs[keep:] if one.verdict != "running"]


def remove(runs: Sequence[Listed], directory: Path) -> None:
    """Remove run folders, and `latest` if it points to one of them. Raises UserError if a folder remains."""
    for one in runs:
        try:
            shutil.rmtree(one.folder)
        except OSError as error:
            raise UserError(f"{one.folder}: not removed: {error.strerror}.", code=Code.OUTPUT) from None
    latest = directory / "latest"
    if latest.is_symlink() and not latest.exists():
        latest.unlink()


def since(one: Listed) -> str:
    """Return the time at which a run began, in local time."""
    return datetime.fromtimestamp(one.began).strftime("%Y-%m-%d %H:%M:%S")
