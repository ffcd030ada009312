"""What a process that nobody forked is told: one TOML text, in a file or in an environment variable."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from hedgerow.topologies import toml
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.regular_file import read_regular

FILE = "told.toml"
"""Its name in a folder of the process's own."""
VARIABLE = "HEDGEROW_CONFIG"
"""The environment variable that holds the text itself, for containers."""


@dataclass(frozen=True)
class Config:
    """Where a process belongs, and what it is told."""

    process: str
    """`plant`, `agent-3` or `shard-0`"""
    namespace: str
    """the Zenoh namespace of the run"""
    router: str
    """a Zenoh endpoint"""
    network: str
    """the fingerprint of the network, the same in all its processes"""
    told: dict[str, Any]
    """hedgerow.agents.view.View or plant.truth.Truth, as its `to_dict` writes it"""
    credentials: str = ""
    """the folder of its keys, from that of the text, where the network is secure"""

    def to_toml(self) -> str:
        """The text that `parse` reads."""
        head = {key: value for key, value in asdict(self).items() if key != "told" and value}
        return toml.dumps(head | self.told)

    @classmethod
    def parse(cls, text: str, source: str) -> Config:
        """The config in a text; UserError, which names its `source`, where something is missing."""
        told = toml.loads(text, source)
        head = {key: told.pop(key, None) for key in ("process", "namespace", "router", "network")}
        missing = [key for key, value in head.items() if not isinstance(value, str)]
        if missing:
            raise UserError(
                f"{source}: does not say {', '.join(missing)}; take what `orchestrator bundle` wrote",
                code=Code.FILE_FORMAT,
            )
        return cls(**head, credentials=str(told.pop("credentials", "")), told=told)


def find(path: Path | None, otherwise: str) -> Config:
    """The config in a file, else in the environment, else in the file `otherwise`; UserError if there is none."""
    if path is None and (text := os.environ.get(VARIABLE)):
        return Config.parse(text, VARIABLE)
    path = _file(path or Path(otherwise))
    try:
        config = Config.parse(read_regular(path).decode(), str(path))
    except (OSError, UnicodeDecodeError) as error:
        why = getattr(error, "strerror", None) or "is not a text"
        raise UserError(
            f"{path}: {why}; `orchestrator bundle` writes it, --config says where it is", code=Code.FILE_UNREADABLE
        ) from None
    return replace(config, credentials=config.credentials and str(path.parent / config.credentials))


def _file(path: Path) -> Path:
    """In a secure network each has a folder, with its keys: NAME and NAME.toml stand for NAME/told.toml."""
    folder = path.with_suffix("") if path.suffix == ".toml" and not path.exists() else path
    return folder / FILE if folder.is_dir() else path
