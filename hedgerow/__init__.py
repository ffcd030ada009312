"""Networks of independent controllers that talk only to their neighbours, each its own process, over Zenoh.

    import hedgerow as hg
    net = hg.load("paper7", steps=300)                   # a bundled name, path, YAML text, dictionary, or Topology
    run = hg.simulate(net, law="hinf")                   # in this process
    run = hg.run(net, processes=3)                       # real processes over Zenoh
    with hg.start(net, rate=200) as live:                # the same, controlled while it runs
        live.fault.drop((2, 4), steps=range(50))
        live.wait_for_step(100)
    run = hg.load_run("runs/latest")                     # any recorded run
    hg.report(run, "figures")                            # figures and a page
    hg.sweep(net, seeds=range(50), law=["minimax", "nominal"])

Agents import this package too, so every name is loaded when it is first used.
"""

from __future__ import annotations

TYPE_CHECKING = False  # the constant of `typing` costs an import
if TYPE_CHECKING:
    from hedgerow.agents.law import Law, Minimax
    from hedgerow.orchestrator import testing
    from hedgerow.orchestrator.facade import bound, compare, load, report, run, simulate, start, sweep, worst
    from hedgerow.orchestrator.launch.live import Live
    from hedgerow.orchestrator.network import Network, from_adjacency, from_edges, from_networkx
    from hedgerow.orchestrator.runs.reader import load_run
    from hedgerow.orchestrator.runs.run import Run
    from hedgerow.topologies.errors import Code, HedgerowError, TopologyError, UserError
    from hedgerow.topologies.schema import Topology

    __version__: str

_HOMES = {
    "Code": "topologies.errors",
    "HedgerowError": "topologies.errors",
    "Law": "agents.law",
    "Live": "orchestrator.launch.live",
    "Minimax": "agents.law",
    "Network": "orchestrator.network",
    "Run": "orchestrator.runs.run",
    "Topology": "topologies.schema",
    "TopologyError": "topologies.errors",
    "UserError": "topologies.errors",
    "bound": "orchestrator.facade",
    "compare": "orchestrator.facade",
    "from_adjacency": "orchestrator.network",
    "from_edges": "orchestrator.network",
    "from_networkx": "orchestrator.network",
    "load": "orchestrator.facade",
    "load_run": "orchestrator.runs.reader",
    "report": "orchestrator.facade",
    "run": "orchestrator.facade",
    "simulate": "orchestrator.facade",
    "start": "orchestrator.facade",
    "sweep": "orchestrator.facade",
    "worst": "orchestrator.facade",
}
__all__ = [
    "Code",
    "HedgerowError",
    "Law",
    "Live",
    "Minimax",
    "Network",
    "Run",
    "Topology",
    "TopologyError",
    "UserError",
    "bound",
    "compare",
    "from_adjacency",
    "from_edges",
    "from_networkx",
    "load",
    "load_run",
    "report",
    "run",
    "simulate",
    "start",
    "sweep",
    "testing",
    "worst",
]
NEEDED = frozenset(
    (
        *("clarabel", "cryptography", "matplotlib", "networkx", "psutil", "pyarrow", "pydantic", "pymetis", "rerun"),
        *("rich", "scipy", "tomlkit", "typer", "yaml"),
    )
)
"""Packages that every part except a lone agent or plant needs; pyproject.toml lists them with their versions."""


def missing(needed_by: str, package: str | None) -> str:
    """Return the message for a computer that has only the packages of an agent."""
    return (
        f"{needed_by} needs {package}, which is not installed. Install it with `pip install hedgerow`, or in a clone"
        " with `pip install .`; an agent or a plant needs only numpy and eclipse-zenoh."
    )


def __getattr__(name: str) -> object:
    """Load the module of a public name when it is first used."""
    if name == "__version__":
        from hedgerow.wire.release import release  # noqa: PLC0415

        return release("hedgerow")
    if name == "testing":
        from hedgerow.orchestrator import testing  # noqa: PLC0415

        return testing
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module  # noqa: PLC0415

    try:
        return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in NEEDED:
            raise
        raise ModuleNotFoundError(missing(f"hedgerow.{name}", error.name), name=error.name) from None


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
