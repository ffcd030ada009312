"""The config of a process that is started separately: one TOML text, in a file or in an environment variable."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from hedgerow.topologies import toml
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.regular_file import read_regular

FILE = "config.toml"
"""The name of the file in the folder of the process."""
VARIABLE = "HEDGEROW_CONFIG"
"""The environment variable that holds the text itself, for containers."""


@dataclass(frozen=True)
class Config:
    """The place of one process in a run, and its part of the network."""

    process: str
    """`plant`, `agent-3` or `shard-0`"""
    namespace: str
    """the Zenoh namespace of the run"""
    router: str
    """a Zenoh endpoint"""
    network: str
    """the fingerprint of the network, the same in all its processes"""
    part: dict[str, Any]
    """hedgerow.agents.view.View or plant.truth.Truth, as its `to_dict` writes it"""
    credentials: str = ""
    """the folder of its keys, relative to the text, if the network is secure"""

    def to_toml(self) -> str:
        """Return the text that `parse` reads."""
        head = {key: value for key, value in asdict(self).items() if key != "part" and value}
        return toml.dumps(head | self.part)

    @classmethod
    def parse(cls, text: str, source: str) -> Config:
        """Return the config in a text; raise UserError, which names `source`, if something is missing."""
        part = toml.loads(text, source)
        head = {key: part.pop(key, None) for key in ("process", "namespace", "router", "network")}
        missing = [key for key, value in head.items() if not isinstance(value, str)]
        if missing:
            raise UserError(
                f"{source}: lacks {', '.join(missing)}; use the file that `orchestrator bundle` wrote",
                code=Code.FILE_FORMAT,
            )
        return cls(**head, credentials=str(part.pop("credentials", "")), part=part)


def find(path: Path | None, otherwise: str) -> Config:
    """Return the config from a file, the environment, or the file `otherwise`; raise UserError if there is none."""
    if path is None and (text := os.environ.get(VARIABLE)):
        return Config.parse(text, VARIABLE)
    path = _file(path or Path(otherwise))
    try:
        config = Config.parse(read_regular(path).decode(), str(path))
    except (OSError, UnicodeDecodeError) as error:
        why = getattr(error, "strerror", None) or "is not a text"
        raise UserError(
            f"{path}: {why}; `orchestrator bundle` writes it, and --config gives its path", code=Code.FILE_UNREADABLE
        ) from None
    return replace(config, credentials=config.credentials and str(path.parent / config.credentials))


def _file(path: Path) -> Path:
    """Return the file of a config.

    In a secure network each process has a folder with its keys, where NAME and NAME.toml are NAME/`FILE`.
    """
    folder = path.with_suffix("") if path.suffix == ".toml" and not path.exists() else path
    return folder / FILE if folder.is_dir() else path
