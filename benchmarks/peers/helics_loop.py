"""HELICS: one federate per process, values by publications; the broker is in the plant's process.

Time makes the lockstep: the plant is at whole steps, the agents half a step later. So at t + 1/2 an agent has x(t) and
the publications of its neighbours at t - 1/2. An agent publishes (x, u) once, for both neighbours and plant.
"""

from __future__ import annotations

import multiprocessing
import os
import socket
from multiprocessing.synchronize import Event

import helics as h

from benchmarks.peers.network import Agent, Done, Network, Plant

CORE = os.environ.get("HEDGEROW_BENCHMARK_HELICS", "zmq")
"""the core type: the default of HELICS; tcp and tcp_ss did not end in time with 20 nodes on a busy machine"""
PATIENT = "--networktimeout=60s --timeout=120s"
"""many processes start at once, on few cores"""
LATER = 0.5
"""the offset of the agents, in steps"""


def _free_port() -> int:
    with socket.socket() as end:
        end.bind(("127.0.0.1", 0))
        return int(end.getsockname()[1])


def _federate(name: str, port: int, offset: float) -> h.HelicsValueFederate:
    info = h.helicsCreateFederateInfo()
    h.helicsFederateInfoSetCoreTypeFromString(info, CORE)
    h.helicsFederateInfoSetCoreInitString(info, f"--federates=1 --brokerport={port} {PATIENT}")
    h.helicsFederateInfoSetTimeProperty(info, h.HELICS_PROPERTY_TIME_PERIOD, 1.0)
    h.helicsFederateInfoSetTimeProperty(info, h.HELICS_PROPERTY_TIME_OFFSET, offset)
    h.helicsFederateInfoSetFlagOption(info, h.HELICS_FLAG_UNINTERRUPTIBLE, True)
    h.helicsFederateInfoSetIntegerProperty(info, h.HELICS_PROPERTY_INT_LOG_LEVEL, h.HELICS_LOG_LEVEL_ERROR)
    return h.helicsCreateValueFederate(name, info)


def _agent(network: Network, me: int, steps: int, port: int, broker_up: Event) -> None:
    broker_up.wait()
    agent = Agent(network, me)
    federate = _federate(f"agent{me}", port, LATER)
    sent = h.helicsFederateRegisterGlobalPublication(federate, f"sent/{me}", h.HELICS_DATA_TYPE_COMPLEX, "")
    state = h.helicsFederateRegisterSubscription(federate, f"state/{me}", "")
    links = [h.helicsFederateRegisterSubscription(federate, f"sent/{j}", "") for j in agent.neighbours]
    h.helicsFederateEnterExecutingMode(federate)
    for t in range(steps):
        h.helicsFederateRequestTime(federate, t + LATER)
        x = h.helicsInputGetDouble(state)
        heard = [h.helicsInputGetComplex(link).imag for link in links] if t else []
        h.helicsPublicationPublishComplex(sent, x, agent.step(x, heard))
    h.helicsFederateRequestTime(federate, steps + LATER)
    h.helicsFederateDestroy(federate)


def run(network: Network, steps: int) -> Done:
    """Run with the plant and the broker in this process."""
    plant, n, port = Plant(network, steps), len(network), _free_port()
    fork = multiprocessing.get_context("fork")
    broker_up = fork.Event()
    agents = [fork.Process(target=_agent, args=(network, i, steps, port, broker_up), daemon=True) for i in range(n)]
    for agent in agents:
        agent.start()
    broker = h.helicsCreateBroker(CORE, "", f"-f {n + 1} --port={port} --loglevel=error {PATIENT}")
    broker_up.set()
    federate = _federate("plant", port, 0.0)
    states = [
        h.helicsFederateRegisterGlobalPublication(federate, f"state/{i}", h.HELICS_DATA_TYPE_DOUBLE, "")
        for i in range(n)
    ]
    inputs = [h.helicsFederateRegisterSubscription(federate, f"sent/{i}", "") for i in range(n)]
    h.helicsFederateEnterExecutingMode(federate)
    going = True
    while going:
        for state, x in zip(states, plant.x.tolist(), strict=True):
            h.helicsPublicationPublishDouble(state, x)
        h.helicsFederateRequestTime(federate, plant.t + 1)
        going = plant.step([h.helicsInputGetComplex(one).imag for one in inputs])
    done = plant.done()
    h.helicsFederateDestroy(federate)
    for agent in agents:
        agent.join()
    h.helicsBrokerDestroy(broker)
    return done
