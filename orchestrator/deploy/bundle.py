"""A folder for other machines: the config of each process of a network, and the commands that start them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from hedgerow.orchestrator.ground.law_source import source_of
from hedgerow.orchestrator.launch.certificates import host_of, to_carry, write_private
from hedgerow.topologies.escape import command, escape
from hedgerow.topologies.resolve import save
from hedgerow.topologies.schema import Topology
from hedgerow.wire import keys
from hedgerow.wire.access import Place
from hedgerow.wire.config import FILE, Config

INSTALL = """On each machine, install an agent once, with the wheel of this release beside it. `pip wheel --no-deps .`
in a clone of Hedgerow makes the wheel:

```console
$ python3 -m venv .venv && .venv/bin/pip install numpy eclipse-zenoh
$ .venv/bin/pip install --no-deps ./hedgerow-{release}-py3-none-any.whl
```
"""


README = (
    """# {name} on your machines

Each file except `topology.yaml` holds everything that one process may know. Carry to each machine only the files of its
own processes. An agent must not know the file of the plant or of another agent.

"""
    + INSTALL
    + """
Start the operator on its machine, in this folder:

```console
$ orchestrator up topology.yaml --external all --listen tcp/0.0.0.0:{port} --namespace {quoted_namespace}
```

Start each agent on its machine, beside its file. Use `--router` if the router is not at `{router}`:

```console
{commands}
```

You can start them in any order, because each waits ten minutes for the others (`--wait`). With `--external 3,5`, the
operator starts all agents except 3 and 5.

To run the plant on another machine, give the operator `--external plant,all --router {quoted_router}` and start
`hedgerow-plant --config plant.toml` there. A Zenoh router must run beside it. With `--listen tcp/0.0.0.0:{port}`, the
plant is the router itself.
"""
)


README_SECURE = (
    """# {name} on your machines, with certificates

Each folder holds everything that one process may know, and its keys. Carry to each machine only the folders of its own
processes. The holder of an agent's folder can act as that agent. The keys are valid for {days:g} days. `observer`,
`operator`, `router` and `plant` stay on the operator's machine, unless the router or the plant runs elsewhere.

"""
    + INSTALL
    + """
Start the operator on its machine, `{host}`, in this folder:

```console
$ orchestrator up topology.yaml --external all --listen tls/0.0.0.0:{port} --keys .
```

Start each agent on its machine, beside its folder. Use `--router` if the router is not at `{router}`:

```console
{commands}
```

You can start them in any order, because each waits ten minutes for the others (`--wait`). With `--external 3,5`, the
operator starts all agents except 3 and 5.

To run the plant on another machine, give the operator `--external plant,all --router {quoted_router}`. Then start the
plant in one of two ways:

- beside a Zenoh router (`zenohd -c zenohd.json5`, in the folder `router`): `hedgerow-plant --config plant`
- as the router, with that folder: `hedgerow-plant --config plant --listen tls/0.0.0.0:{port} --credentials router`
"""
)


LAW = """
The law is {name}. Carry its source ({files}) to every machine too. Start each process in the folder with the source,
because an agent imports it from there.
"""


def write(folder: Path, topology: Topology, configs: Sequence[Config]) -> None:
    """Write the configs, the resolved topology and a README into `folder`; raises OSError."""
    for config in configs:
        (folder / f"{config.process}.toml").write_text(config.to_toml(), encoding="utf-8")
    _write_rest(folder, topology, configs, README, ".toml")


def write_secure(
    folder: Path, topology: Topology, configs: Sequence[Config], places: Sequence[Place], days: float
) -> None:
    """Write the same with the keys of all processes, one folder each; raise OSError, or UserError if no keys can be
    made.
    """
    first = configs[0]

    def tell(part: Path) -> None:
        for config in configs:
            write_private(part / config.process / FILE, replace(config, credentials=".").to_toml().encode())
        _write_rest(part, topology, configs, README_SECURE, "", days=days, host=host_of(first.router))

    to_carry(folder, places, first.namespace, first.router, days, tell)


def _write_rest(
    folder: Path, topology: Topology, configs: Sequence[Config], readme: str, ending: str, **words: object
) -> None:
    source = source_of(topology.law)
    source.write(folder)
    save(topology, folder / "topology.yaml")
    agent_files = [f"{config.process}{ending}" for config in configs if config.process != keys.PLANT]
    agents = [f"$ {command(['hedgerow-agent', '--config', name])}" for name in agent_files]
    shown = agents[:20] + ([f"... and {len(agents) - 20} more"] if len(agents) > 20 else [])
    text = readme.format(
        name=topology.name,
        release=release(),
        quoted_namespace=command([configs[0].namespace]),
        router=escape(configs[0].router, keep=""),
        quoted_router=command([configs[0].router]),
        port=configs[0].router.rpartition(":")[2],
        commands="\n".join(shown),
        **words,
    )
    if source.files:
        text += LAW.format(name=escape(topology.law, keep=""), files=", ".join(f"`{one}`" for one in source.files))
    (folder / "README.md").write_text(text, encoding="utf-8")


def release() -> str:
    """Return our own version."""
    from hedgerow.wire.handshake import introduction  # noqa: PLC0415

    return str(introduction("")["hedgerow"])
