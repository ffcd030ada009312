"""The options of a run over Zenoh."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from hedgerow.orchestrator.launch.external_agents import External
from hedgerow.orchestrator.launch.ray_agents import OnRay
from hedgerow.orchestrator.launch.watching import Watching


@dataclass(frozen=True)
class Options:
    """The options of a run; none of them changes its trajectory, unless an agent misses the deadline."""

    rate: float = 0.0
    """steps per second, 0 for as fast as possible"""
    deadline_s: float = 10.0
    """the time that the plant waits for an input before it continues without that agent [s]"""
    router: str | None = None
    """the endpoint of an existing router; None for our own"""
    keys: Path | None = None
    """credentials for a secure run over an existing router"""
    external: External | None = None
    """the processes that start separately, if any"""
    ray: OnRay | None = None
    """the agents on Ray, if any"""
    watching: Watching = field(default_factory=Watching)
    verify: bool = False
    """compare with the in-process reference afterwards"""
