"""The topology from the arguments of a command."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hedgerow.topologies.escape import echo

# Loading a topology takes most of a second: each function imports what it needs.
if TYPE_CHECKING:
    from hedgerow.topologies.schema import Topology


def read(file: str, sets: list[str] | None, **replace: object) -> Topology:
    """Return the resolved topology of `file` with some values replaced; a value of None replaces nothing."""
    from hedgerow.topologies.load import find  # noqa: PLC0415
    from hedgerow.topologies.resolve import resolve  # noqa: PLC0415

    return resolve(undrawn(file, sets, **replace), find(file).parent)


def undrawn(file: str, sets: list[str] | None, **replace: object) -> Topology:
    """Return the topology of `read` before its numbers are drawn."""
    from hedgerow.topologies.load import load  # noqa: PLC0415
    from hedgerow.topologies.override import Override  # noqa: PLC0415

    options = [Override.of_option(key, value) for key, value in replace.items() if value is not None]
    return load(file, [*options, *(sets or [])])


def importable(topology: Topology, file: str = "", kept: bool = False) -> Topology:
    """Return the topology with a checked law: a law that cannot be loaded ends the command before a run.

    `file` is the name of the topology. Print a line if it is the folder of a run that kept another source of the law.
    If `kept`, load the law from that folder, here and in every process of the run.
    """
    from hedgerow.orchestrator.ground.law_source import FOLDER, differs, use_kept  # noqa: PLC0415
    from hedgerow.orchestrator.ground.laws import checked  # noqa: PLC0415
    from hedgerow.topologies.load import find  # noqa: PLC0415

    if kept:
        use_kept(find(file).parent / FOLDER)
    elif file and ":" in topology.law and (difference := differs(topology.law, find(file).parent / FOLDER)):
        echo(difference, error=True)
    return checked(topology)
