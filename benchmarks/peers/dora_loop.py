"""dora: one node per process, messages through its daemon, which `dora run` starts; one more process than the others.

The plant is a node as well. An output reaches all of its subscribers: (x, u) goes to neighbours and plant at once, and
the plant has one output for each agent.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa
from dora import Node

from benchmarks.peers.network import MESSAGE, PLANT, Agent, Done, Lockstep, Network, Plant

SENT = "sent"
"""the output of an agent, and the input at its receivers, followed by the agent's number"""
STATE = "x"
"""the output of the plant, followed by the agent's number, and the input at the agent"""
QUEUE = 16
"""the queue length of one input: longer than needed, so that no message is dropped"""


def _send(node: Node, output: str, *message: float) -> None:
    node.send_output(output, pa.array(np.frombuffer(MESSAGE.pack(*message), np.uint8)))


def _message(event: dict[str, pa.Array]) -> tuple[int, int, float, float]:
    return MESSAGE.unpack(event["value"].to_numpy().tobytes())


def _agent(network: Network, me: int) -> None:
    node = Node()
    lockstep = Lockstep(Agent(network, me))
    while (event := node.next()) is not None:
        if event["type"] == "STOP" or (event["type"], event["id"]) == ("INPUT_CLOSED", STATE):  # the plant has ended
            return
        if event["type"] == "INPUT" and (answer := lockstep.take(*_message(event))) is not None:
            _send(node, SENT, me, *answer)


def _plant(network: Network, steps: int, folder: Path) -> None:
    node = Node()
    plant, n = Plant(network, steps), len(network)
    u, going = [0.0] * n, True
    while going:
        for i, x in enumerate(plant.x.tolist()):
            _send(node, f"{STATE}{i}", PLANT, plant.t, x, 0.0)
        for _ in range(n):
            while (event := node.next())["type"] != "INPUT":
                pass
            sender, _, _, value = _message(event)
            u[sender] = value
        going = plant.step(u)
    done = plant.done(root=int(os.environ["HEDGEROW_BENCHMARK_ROOT"]))
    np.savez(folder / "done.npz", rate=done.steps_per_s, first=done.first_step_s, pss=done.pss_mb, x=done.x, u=done.u)


def _dataflow(network: Network, steps: int, folder: str) -> dict[str, object]:
    def hears(source: str) -> dict[str, object]:
        return {"source": source, "queue_size": QUEUE}

    def node(name: str, outputs: list[str], inputs: Mapping[str, object], arguments: str) -> dict[str, object]:
        path = {"path": sys.executable, "args": f"-m {__spec__.name} {arguments}"}
        return {"id": name, **path, "outputs": outputs, "inputs": inputs}

    everybody = range(len(network))
    listening = {f"{SENT}{i}": hears(f"agent{i}/{SENT}") for i in everybody}
    nodes = [node("plant", [f"{STATE}{i}" for i in everybody], listening, f"plant {network.saved} {steps} {folder}")]
    for i in everybody:
        inputs = {STATE: hears(f"plant/{STATE}{i}")}
        inputs |= {f"{SENT}{j}": hears(f"agent{j}/{SENT}") for j in network.neighbours(i)}
        nodes.append(node(f"agent{i}", [SENT], inputs, f"agent {network.saved} {i}"))
    return {"nodes": nodes}


def run(network: Network, steps: int) -> Done:
    """Run a dataflow with a separate daemon."""
    with tempfile.TemporaryDirectory(prefix="hedgerow-") as folder:
        file = Path(folder) / "dataflow.yml"
        file.write_text(json.dumps(_dataflow(network, steps, folder)), encoding="utf-8")
        environment = os.environ | {"HEDGEROW_BENCHMARK_ROOT": str(os.getpid()), "RUST_LOG": "error"}
        dora = Path(sys.executable).parent / "dora"
        subprocess.run([dora, "run", file], cwd=folder, env=environment, check=True)
        with np.load(Path(folder) / "done.npz") as left:
            rate, first, pss = (float(left[name]) for name in ("rate", "first", "pss"))
            return Done(rate, first, pss, left["x"], left["u"])


if __name__ == "__main__":
    role, saved, *rest = sys.argv[1:]
    if role == "agent":
        _agent(Network.read(saved), int(rest[0]))
    else:
        _plant(Network.read(saved), int(rest[0]), Path(rest[1]))
