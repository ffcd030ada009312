"""A folder to carry away: what each process of a network is told, and the commands that start them."""

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

Every file here but `topology.yaml` is what one process is told, and all that it is told. Carry each to its machine, and
no other: an agent must not know the plant's file, nor that of another agent.

On each machine, once, with the wheel of this release beside it (`pip wheel --no-deps .` in the project makes it):

```console
$ python3 -m venv .venv && .venv/bin/pip install './hedgerow-{release}-py3-none-any.whl[agent]'
```

On the operator's, in this folder:

```console
$ orchestrator up topology.yaml --external all --listen tcp/0.0.0.0:{port} --namespace {quoted_namespace}
```

And wherever an agent is to live, with its file beside it (`--router` if it is not at `{router}`):

```console
{commands}
```

The order does not matter: each waits ten minutes for the others (`--wait`). `--external 3,5` has the operator start
the others itself; with `--external plant,all --router {quoted_router}` the plant runs elsewhere, too:
`hedgerow-plant --config plant.toml`, beside a Zenoh router of yours or as one (`--listen tcp/0.0.0.0:{port}`).
"""


README_SECURE = """# {name}, on your machines, secure

A folder here holds all that one process needs, with its keys. Carry each to its machine, and no other: the holder of
an agent's folder can speak for that agent. The keys hold for {days:g} days. `observer`, `operator`,
`router` and `plant` stay on the operator's machine, unless the router or the plant lives elsewhere.

On each machine, once, with the wheel of this release beside it (`pip wheel --no-deps .` in the project makes it):

```console
$ python3 -m venv .venv && .venv/bin/pip install './hedgerow-{release}-py3-none-any.whl[agent]'
```

On the operator's, `{host}`, in this folder:

```console
$ orchestrator up topology.yaml --external all --listen tls/0.0.0.0:{port} --keys .
```

And wherever an agent is to live, with its folder beside it (`--router` if it is not at `{router}`):

```console
{commands}
```

The order does not matter: each waits ten minutes for the others (`--wait`). `--external 3,5` has the operator start
the others itself. With `--external plant,all --router {quoted_router}` the plant runs elsewhere, too:
`hedgerow-plant --config plant` beside a Zenoh router (`zenohd -c zenohd.json5`, in the folder `router`); or as the
router, with that folder:
`hedgerow-plant --config plant --listen tls/0.0.0.0:{port} --credentials router`.
"""


LAW = """
The law is {name}. Carry its source ({files}) to every machine as well, and start each process in the folder that holds
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
    """Write the same with everybody's keys, a folder each; raises OSError, and UserError where no keys can be made."""
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
    """Our own version."""
    from hedgerow.wire.handshake import introduction  # noqa: PLC0415

    return str(introduction("")["hedgerow"])
