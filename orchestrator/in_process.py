"""The reference: the same plant and the same agents in one process, with no wire between them."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence

import numpy as np

from agents.shard import Shard
from agents.view import View
from plant.truth import Truth
from plant.world import World
from wire.codec import ALL_UP, REPORT_WIDTH, End, Telemetry


def run(truth: Truth, views: Sequence[View]) -> Iterator[Telemetry | End]:
    """The telemetry of every step, then the end; equal bit for bit to what the plant sends over the wire."""
    world, n = World(truth), len(truth.ids)
    shards = [Shard(view) for view in views]
    position = {node: k for k, node in enumerate(truth.ids)}
    nodes = [np.array(part, dtype=np.int64) for part in truth.shards]
    heard = [
        np.concatenate([own, [position[node] for peer in view.peers for node in peer.hear]]).astype(np.int64)
        for own, view in zip(nodes, views, strict=True)
    ]
    flags = [bytes([ALL_UP]) * shard.m for shard in shards]
    edge_open, link_up = (np.ones(k * len(truth.edges), dtype=np.uint8) for k in (1, 2))
    u, report = np.zeros(n), np.zeros((n, REPORT_WIDTH))
    began = time.monotonic()
    for t in range(truth.steps):
        x, before = world.x, u
        u, report = np.empty(n), np.empty((n, REPORT_WIDTH))
        for shard, own, others, up in zip(shards, nodes, heard, flags, strict=True):
            u[own] = shard.step(x[own], up, before[others]) if t else shard.start(x[own])
            report[own] = shard.report
        w = world.step(u)
        yield Telemetry(t, x, u, w, report, edge_open, link_up)
    yield End(world.t, world.x, time.monotonic() - began)
