"""A network of unequal gains and weights over Zenoh: the numbers of the vector, and the bits of the reference."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hedgerow.orchestrator.testing.scenario import Scenario
from hedgerow.topologies.named import Given
from tests.tools.networks import VECTORS, from_vector, vector_file

(W1,) = (path for path in VECTORS if path.stem == "w1_path3")
FAULTS = (
    "faults=[{kind: cut, edge: [0, 1], steps: [2, 5]}, {kind: drop, link: [1, 2], steps: [3, 7]},"
    " {kind: delay, link: [0, 1], by: 2, steps: [5, 9]}, {kind: sensor, node: 2, steps: [4, 6]},"
    " {kind: actuator, node: 0, steps: [11, 13]}, {kind: crash, node: 1, at: 8, restart_after: 3},"
    " {kind: partition, groups: [[0], [1, 2]], steps: [14, 16]}, {kind: jump, node: 2, at: 15, a: 0.2}]"
)


def scenario(folder: Path, *settings: str) -> Scenario:
    text, _ = vector_file(W1)
    folders = iter(folder / str(k) for k in range(9))

    def new_folder(_: str) -> Path:
        made = next(folders)
        made.mkdir()
        return made

    return Scenario(Given(text.encode(), "w1", folder, settings), new_folder)


def test_the_vector_over_zenoh(tmp_path: Path) -> None:
    """One process per node; x, u and the choice at every step to 1e-12, and all checks hold."""
    _, expected = vector_file(W1)
    ran = scenario(tmp_path).run(engine="zenoh")
    assert ran.verdict.verdict == "valid", ran.verdict.content["reasons"]
    np.testing.assert_allclose(ran.x, expected["x"], rtol=0, atol=1e-12)
    np.testing.assert_allclose(ran.u, expected["u"], rtol=0, atol=1e-12)
    candidates = from_vector(W1)[0].network.candidates
    np.testing.assert_array_equal(ran.ahat, candidates[np.array(expected["index"]), np.arange(3)])
    metrics = ran.verdict.content["metrics"]
    assert abs(metrics["cost"] - expected["cost_minimax"]) < 1e-12
    assert abs(metrics["cost_oracle"] - expected["cost_oracle"]) < 1e-12
    assert abs(metrics["gamma_star"] - expected["gamma_star"]) < 1e-12
    assert abs(metrics["rho"] - expected["rho"]) < 1e-12


def test_every_kind_of_fault_gives_the_bits_of_the_reference(tmp_path: Path) -> None:
    """Two processes over Zenoh, under every kind of fault, against the network in one process."""
    faulty = scenario(tmp_path, FAULTS)
    over_zenoh, here = faulty.run(engine="zenoh", processes=2), faulty.run()
    assert over_zenoh.verdict.verdict == "valid", over_zenoh.verdict.content["reasons"]
    for name in ("x", "u", "w", "ahat"):
        assert getattr(over_zenoh, name).tobytes() == getattr(here, name).tobytes()
