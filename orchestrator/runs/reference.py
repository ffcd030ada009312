"""The reference: the same plant and the same agents in one process, without a network."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from hedgerow.agents.law import Law
from hedgerow.agents.loading import LawError
from hedgerow.agents.shard import Shard
from hedgerow.agents.view import View
from hedgerow.plant.truth import Truth
from hedgerow.plant.world import World
from hedgerow.topologies import fast
from hedgerow.topologies.effects import Effect
from hedgerow.topologies.graph import Array
from hedgerow.wire.codec import gather
from hedgerow.wire.message import REPORT_ROWS, End, Telemetry


def run(truth: Truth, views: Sequence[View], law: Law | None = None) -> Iterator[Telemetry | End]:
    """Yield the telemetry of every step, then the end; equal bit for bit to the messages of the plant.

    `law` replaces that of the view, if there is one view. Raise LawError after the end, at the step where the law
    failed.
    """
    if not any(Effect.from_dict(effect).lossy for effect in truth.effects):
        # No message can be missing, and a run in one process gets no more faults: no past row is ever read.
        truth, views = replace(truth, history=0), [replace(view, history=0) for view in views]
    fast.prepare(len(truth.ids), truth.steps)
    world, began = World(truth), time.monotonic()
    failure: LawError | None = None
    try:
        yield from _steps(world, views, truth.steps, law)
    except LawError as error:
        failure = error
    yield End(world.t, world.x, time.monotonic() - began, world.links.forgotten)
    if failure is not None:
        raise failure


def _steps(world: World, views: Sequence[View], steps: int, law: Law | None) -> Iterator[Telemetry]:
    shards = [Shard(view, law) for view in views]
    ends = {(view.shard, peer.shard): q for view in views for q, peer in enumerate(view.peers)}
    """By sender and receiver: the index of the receiver among the sender's peers."""
    while world.t < steps:
        world.begin()
        messages = world.states()
        inputs: list[Array] = []
        reports: list[Array] = []
        used: list[bytes] = []
        sent = []
        for view, shard, (state, record) in zip(views, shards, messages, strict=True):
            if state is None:
                nothing, no_report, taken = shard.silence
                inputs.append(gather([nothing]))
                reports.append(gather([no_report]).reshape(REPORT_ROWS, -1))
                used.append(taken)
            else:
                if record is not None:
                    shard.recall(record)
                # As the states of a message: a law that changes its argument would change the plant.
                state.x.flags.writeable = False
                inputs.append(shard.answer(state))
                reports.append(shard.report)
                used.append(shard.used)
                sent += [(view, peer, link) for peers, link in shard.send(state) for peer in peers]
        for view, peer, link in sent:
            receiver = view.peers[peer].shard
            shards[receiver].receive(ends[receiver, view.shard], link)
        if len(views) == 1:  # the law may reuse the array of its report, and the reader keeps this one
            yield world.step(inputs[0], reports[0].copy(), used)
        else:
            yield world.step(np.concatenate(inputs), np.concatenate(reports, axis=1), used)
