"""The words that a shell offers for an argument."""

from __future__ import annotations

from pathlib import Path


def networks(incomplete: str) -> list[str]:
    """Return the bundled networks and the topology files that begin with the incomplete word."""
    from hedgerow.topologies.load import bundled  # noqa: PLC0415 (it takes a while to load)

    folder = Path(incomplete if incomplete.endswith("/") else incomplete.rpartition("/")[0])
    near = [str(path) + "/" * path.is_dir() for path in folder.glob("*") if path.suffix == ".yaml" or path.is_dir()]
    return sorted(word for word in (*bundled(), *near) if word.startswith(incomplete))


def running(incomplete: str) -> list[str]:
    """Return the names of running networks that begin with the incomplete word."""
    from hedgerow.orchestrator.runs import registry  # noqa: PLC0415

    return [entry.run for entry in registry.running() if entry.run.startswith(incomplete)]


def runs(incomplete: str) -> list[str]:
    """Return the run folders in runs/ with names that begin with the incomplete word, newest first."""
    folders = (path for path in Path("runs").glob("*") if (path / "topology.yaml").exists())
    return sorted((path.name for path in folders if path.name.startswith(incomplete)), reverse=True)
