"""A plant and its agents with memory for states and inputs, if both ends open it, one of them, or none."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from hedgerow.agents.process import Agent, Begin, Joined
from hedgerow.orchestrator.ground.assignment import layout, truth_of, views_of
from hedgerow.orchestrator.runs import reference
from hedgerow.plant.process import Plant
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from hedgerow.wire import keys
from hedgerow.wire.codec import encode_seen, kind_of
from hedgerow.wire.message import Kind
from hedgerow.wire.session import close, open_client, open_router, subscriber
from hedgerow.wire.shared_rows import close as close_shared
from hedgerow.wire.shared_steps import create_steps
from hedgerow.wire.stream import Inbox

NAMESPACE = "hedgerow/steps"
WAIT_S = 60.0
TEXT = (
    "{name: ring, b: 0.1, steps: 12, graph: {kind: ring, nodes: 1500}, defaults: {x0: 10, candidates: {random: 3},"
    " disturbance: {kind: white, std: 0.1}}}"
)


@pytest.fixture
def paths() -> Iterator[list[str]]:
    made: list[str] = []
    yield made
    for path in made:
        close_shared(path)


@pytest.mark.parametrize("agent_has", [True, False])
@pytest.mark.parametrize("plant_has", [True, False])
def test_the_run_is_the_same_whoever_opens_the_memory(
    tmp_path: Path, paths: list[str], plant_has: bool, agent_has: bool
) -> None:
    (tmp_path / "ring.yaml").write_text(TEXT)
    network = resolve(load(str(tmp_path / "ring.yaml")), tmp_path)
    parts = layout(network, 2)
    truth, views = truth_of(network, parts), views_of(network, parts)
    *_, end = reference.run(truth, views)
    paths += [create_steps(view.k, len(view.row)) for view in views]
    endpoint = f"unixsock-stream/{tmp_path / 'router.sock'}"
    places = list[bool]()
    with contextlib.ExitStack() as stack:
        router = open_router(endpoint, NAMESPACE)
        memories = dict(enumerate(paths)) if plant_has else {}
        plant = Plant(truth, router, 0.0, WAIT_S, memories=memories)
        stack.callback(plant.close)
        observer = open_client(endpoint, NAMESPACE)
        stack.callback(close, observer)
        inbox = Inbox()

        def observe(whole: bytes) -> None:
            if inbox.put(whole):
                observer.put(keys.SEEN, encode_seen(inbox.last))

        heard = [
            subscriber(observer, keys.TELEMETRY, observe),
            subscriber(observer, keys.input_(0), lambda message: places.append(kind_of(message) == Kind.PLACE)),
            subscriber(observer, keys.state(1), lambda message: places.append(kind_of(message) == Kind.PLACE)),
        ]

        def live(shard: int) -> None:
            memory = (paths[shard], 0) if agent_has else None
            Agent(views[shard], NAMESPACE, endpoint, Begin(lambda _: Joined(0), WAIT_S), memory=memory).live()

        agents = [threading.Thread(target=live, args=(p,)) for p in range(2)]
        for agent in agents:
            agent.start()
        plant.run()
        for agent in agents:
            agent.join(WAIT_S)
            assert not agent.is_alive()
        assert len(heard) == 3
    assert plant.world.x.tobytes() == end.x.tobytes()
    assert np.sum(places) == (2 * network.steps if plant_has and agent_has else 0)
