"""A sweep over a Ray cluster: one task per chunk; Ray distributes them, and restarts those of a lost machine."""

from __future__ import annotations

from collections.abc import Generator, Iterable
from typing import Any

from hedgerow.orchestrator.experiments.sweep.plan import Chunk, Plan
from hedgerow.orchestrator.experiments.sweep.runs import Answer, answer
from hedgerow.orchestrator.experiments.sweep.workers import LOOK_EVERY_S
from hedgerow.orchestrator.launch.ray_cluster import joined
from hedgerow.topologies.errors import Code, HedgerowError


def over_ray(
    plan: Plan, chunks: Iterable[Chunk], address: str, jobs: int | None
) -> Generator[Answer | None, None, None]:
    """Yield answers as `over_processes` does; `address` is ray://HOST:PORT, or `ray`: our own cluster, or this
    machine.
    """
    with joined(address) as cluster:
        ray = cluster.ray
        try:
            task, shared_plan = ray.remote(answer), ray.put(plan)
            # Twice as many as run in parallel, so that no core waits for us.
            limit = jobs or 2 * max(1, int(ray.cluster_resources().get("CPU", 1)))
            waiting = iter(chunks)
            going: list[Any] = []
            while True:
                while len(going) < limit and (chunk := next(waiting, None)) is not None:
                    going.append(task.remote(shared_plan, chunk))
                if not going:
                    return
                ready, going = ray.wait(going, timeout=LOOK_EVERY_S)
                if not ready:
                    yield None
                yield from ray.get(ready)
        except ray.exceptions.RayError as error:
            raise HedgerowError(
                f"--on {address}: {str(error).strip().splitlines()[0]}; the same command continues",
                code=Code.WIRE,
            ) from None
