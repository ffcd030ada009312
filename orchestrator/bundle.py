"""A folder to carry away: what each process of a network is told, and the commands that start them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from topologies.resolve import to_yaml
from topologies.schema import Topology
from wire import keys
from wire.config import Config

README = """# {name}, on your machines

Every file here but `topology.yaml` is what one process is told, and all that it is told. Carry each to its machine, and
no other: an agent must not know the plant's file, nor that of another agent.

On each machine, once:

```console
$ python3 -m venv .venv && .venv/bin/pip install 'hedgerow[agent]=={release}'
```

On the operator's, in this folder:

```console
$ orchestrator up topology.yaml --external all --listen tcp/0.0.0.0:7447 --namespace {namespace}
```

And wherever an agent is to live, with its file beside it (`--router` if it is not at `{router}`):

```console
{commands}
```

The order does not matter: each waits ten minutes for the others (`--wait`). `--external 3,5` has the operator start
the others itself; with `--external plant,all --router {router}` the plant runs elsewhere, too:
`plant --config plant.toml`, beside a Zenoh router of yours or as one (`--listen tcp/0.0.0.0:7447`).
"""


def write(folder: Path, topology: Topology, configs: Sequence[Config]) -> None:
    """Write the configs, the resolved topology and a README into `folder`; raises OSError."""
    for config in configs:
        (folder / f"{config.process}.toml").write_text(config.to_toml(), encoding="utf-8")
    (folder / "topology.yaml").write_text(to_yaml(topology), encoding="utf-8")
    agents = [f"$ agent --config {config.process}.toml" for config in configs if config.process != keys.PLANT]
    shown = agents[:20] + ([f"... and {len(agents) - 20} more"] if len(agents) > 20 else [])
    text = README.format(
        name=topology.name,
        release=release(),
        namespace=configs[0].namespace,
        router=configs[0].router,
        commands="\n".join(shown),
    )
    (folder / "README.md").write_text(text, encoding="utf-8")


def release() -> str:
    """Our own version."""
    from wire.handshake import introduction  # noqa: PLC0415

    return str(introduction("")["hedgerow"])
