"""A folder for other machines: the config of each process of a network, and the commands that start them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from hedgerow.orchestrator.ground.law_source import source_of
from hedgerow.orchestrator.launch.certificates import host_of, to_carry, write_private
from hedgerow.topologies.escape import command, escape
from hedgerow.topologies.resolve import to_yaml
from hedgerow.topologies.schema import Topology
from hedgerow.wire import keys
from hedgerow.wire.access import Place
from hedgerow.wire.config import FILE, Config

README = """# {name}, on your machines

Each file here, except `topology.yaml`, holds all the data of one process. Copy each file to the machine of its process,
and to no other: an agent must not have the file of the plant or of another agent.

On each machine, once, with the wheel of this release beside it (`pip wheel --no-deps .` in the project makes it):

```console
$ python3 -m venv .venv && .venv/bin/pip install './hedgerow-{release}-py3-none-any.whl[agent]'
```

On the operator's, in this folder:

```console
$ orchestrator up topology.yaml --external all --listen tcp/0.0.0.0:{port} --namespace {quoted_namespace}
```

On the machine of each agent, beside its file (`--router` if it is not at `{router}`):

```console
{commands}
```

The order does not matter: each waits ten minutes for the others (`--wait`). With `--external 3,5`, the operator
starts the others itself; with `--external plant,all --router {quoted_router}` the plant runs elsewhere too:
`hedgerow-plant --config plant.toml`, beside a Zenoh router of yours or as one (`--listen tcp/0.0.0.0:{port}`).
"""


README_SECURE = """# {name}, on your machines, secure

Each folder here holds all the data of one process, with its keys. Copy each folder to the machine of its process, and
to no other: its owner can act for that process. The keys are valid for {days:g} days. `observer`, `operator`,
`router` and `plant` stay on the operator's machine, unless the router or the plant runs elsewhere.

On each machine, once, with the wheel of this release beside it (`pip wheel --no-deps .` in the project makes it):

```console
$ python3 -m venv .venv && .venv/bin/pip install './hedgerow-{release}-py3-none-any.whl[agent]'
```

On the operator's, `{host}`, in this folder:

```console
$ orchestrator up topology.yaml --external all --listen tls/0.0.0.0:{port} --keys .
```

On the machine of each agent, beside its folder (`--router` if it is not at `{router}`):

```console
{commands}
```

The order does not matter: each waits ten minutes for the others (`--wait`). With `--external 3,5`, the operator
starts the others itself. With `--external plant,all --router {quoted_router}` the plant runs elsewhere too:
`hedgerow-plant --config plant` beside a Zenoh router (`zenohd -c zenohd.json5`, in the folder `router`); or as the
router, with that folder:
`hedgerow-plant --config plant --listen tls/0.0.0.0:{port} --credentials router`.
"""


LAW = """
The law is {name}. Copy its source ({files}) to every machine as well, and start each process in the folder that holds
it. An agent imports it from there.
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
    (folder / "topology.yaml").write_text(to_yaml(topology), encoding="utf-8")
    told = [f"{config.process}{ending}" for config in configs if config.process != keys.PLANT]
    agents = [f"$ {command(['hedgerow-agent', '--config', name])}" for name in told]
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
