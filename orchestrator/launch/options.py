"""The options of a run over Zenoh."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from hedgerow.orchestrator.launch.external_agents import External
from hedgerow.orchestrator.launch.ray_agents import OnRay
from hedgerow.orchestrator.launch.recording import Watching


@dataclass(frozen=True)
class Options:
    """How a network is run; nothing here changes its trajectory, unless an agent is late by more than the deadline."""

    rate: float = 0.0
    """steps per second, 0 for as fast as possible"""
    deadline_s: float = 10.0
    """how long the plant waits for an input before it goes on without that agent"""
    router: str | None = None
    """an existing router's endpoint; None for one of our own"""
    keys: Path | None = None
    """credentials made beforehand, for a secure run over a router that is there"""
    external: External | None = None
    """who is started elsewhere, if anybody"""
    ray: OnRay | None = None
    """where Ray starts them"""
    watching: Watching = field(default_factory=Watching)
    verify: bool = False
    """compare with the in-process reference afterwards"""
