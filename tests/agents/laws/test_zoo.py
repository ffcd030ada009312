"""The laws of the project: the contract of every one, and the formula of each."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hedgerow.agents.law import Array, Law
from hedgerow.agents.laws import LAWS, law_of_name
from hedgerow.agents.laws.exponential import exp
from hedgerow.agents.loading import new_law
from hedgerow.agents.local import Received, asks
from hedgerow.agents.view import View
from hedgerow.orchestrator.ground import laws
from hedgerow.orchestrator.ground.assignment import layout
from hedgerow.topologies.archive import id_array
from hedgerow.topologies.errors import UserError
from hedgerow.topologies.law_choice import LISTED, NAMES
from hedgerow.topologies.network import padded
from hedgerow.topologies.schema import Topology
from tests.test_faults import faulty
from tests.tools.networks import floats, partitions, read, simulate

B = 0.1
ZOO = [name for name in NAMES if name not in ("hinf", "nominal")]
CHOICES = [f"{name}(theta=0.6)" if name == "robust" else name for name in ZOO]
MODELS = [[0.3, 0.6, 0.9], [0.5], [0.2, 0.8, 0.4, 0.7, 0.1]]


def law(choice: str, models: Sequence[Sequence[float]] = MODELS, ids: Sequence[int] | None = None) -> Law:
    """Return a law of these nodes, which have no neighbours."""
    k = len(models)
    none = np.empty(0, dtype=np.int64)
    return new_law(
        View(
            shard=0,
            b=B,
            law=choice,
            ids=id_array(list(ids if ids is not None else range(k))),
            candidates=padded(models),
            row=none,
            column=none,
            peers=[],
            outside=id_array([]),
            history=0,
            seed=5,
        )
    )


def received(t: int, k: int, nodes: Any = None) -> Received:
    everybody = np.ones(k, dtype=bool) if nodes is None else np.asarray(nodes)
    return Received(t, everybody, np.empty(0), np.empty(0), np.empty(0, dtype=np.int64))


def learn(one: Any, t: int, x: Array, flow: Array, x_next: Array) -> None:
    one.learn(x, flow, x_next, *([received(t, len(x))] if asks(one.learn, "sample") else []))


def act(one: Any, t: int, x: Array) -> Array:
    given: Array = one.act(x, *([received(t, len(x))] if asks(one.act, "now") else []))
    return given.copy()


def history(steps: int, k: int, seed: int = 1, lost: float = 0.2) -> tuple[Array, Array]:
    """x (steps + 1, k) and flow (steps, k), NaN where a sample is lost."""
    draw = np.random.default_rng(seed)
    flow = draw.normal(size=(steps, k))
    return draw.normal(size=(steps + 1, k)), np.where(draw.random((steps, k)) < lost, np.nan, flow)


def taught(choice: str, x: Array, flow: Array, models: Sequence[Sequence[float]] = MODELS, **more: Any) -> Law:
    one = law(choice, models, **more)
    for t in range(len(flow)):
        learn(one, t, x[t], flow[t], x[t + 1])
    return one


def test_the_names_of_the_schema_are_the_laws() -> None:
    assert tuple(LAWS) == NAMES
    assert set(LISTED) <= set(NAMES)
    for name in NAMES:
        one = law_of_name(name)
        assert one.__doc__
        assert one.equation  # type: ignore[attr-defined]


# The contract.


@pytest.mark.parametrize("choice", CHOICES)
def test_a_lost_sample_leaves_its_column_alone(choice: str) -> None:
    x, flow = history(12, 3)
    one, other = taught(choice, x, flow), taught(choice, x, flow)
    before = one.memory.copy()
    now, f = x[0] + 0.5, np.array([0.3, np.nan, -0.2])
    learn(one, 12, now, f, x[1])
    assert one.memory[..., 1].tobytes() == before[..., 1].tobytes()
    learn(other, 12, now, np.array([0.3, 0.1, -0.2]), x[1])
    assert one.memory[..., [0, 2]].tobytes() == other.memory[..., [0, 2]].tobytes()
    before = one.memory.copy()
    learn(one, 13, now, np.full(3, np.nan), x[1])
    assert one.memory.tobytes() == before.tobytes()


@pytest.mark.parametrize("choice", CHOICES)
def test_any_split_of_the_nodes_gives_the_same_bits(choice: str) -> None:
    """Also without the rows of candidates that no node of a part has."""
    x, flow = history(30, 3)
    whole = taught(choice, x, flow)
    u, report = act(whole, 30, x[-1]), whole.report().copy()
    for part in ([0], [1], [2], [0, 1], [1, 2], [0, 2]):
        own = taught(choice, x[:, part], flow[:, part], [MODELS[i] for i in part], ids=part)
        assert act(own, 30, x[-1, part]).tobytes() == u[part].tobytes()
        assert own.report().tobytes() == np.ascontiguousarray(report[:, part]).tobytes()


@pytest.mark.parametrize("choice", CHOICES)
def test_act_and_report_change_nothing_and_memory_restores(choice: str) -> None:
    x, flow = history(40, 3)
    one = taught(choice, x[:21], flow[:20])
    saved = one.memory.copy()
    first = act(one, 20, x[20]), one.report().copy()
    again = act(one, 20, x[20]), one.report().copy()
    assert all(a.tobytes() == b.tobytes() for a, b in zip(first, again, strict=True))
    assert one.memory.tobytes() == saved.tobytes()
    for t in range(20, 40):
        learn(one, t, x[t], flow[t], x[t + 1])
    last = one.memory.copy()
    one.memory = saved.copy()
    assert act(one, 20, x[20]).tobytes() == first[0].tobytes()
    for t in range(20, 40):
        learn(one, t, x[t], flow[t], x[t + 1])
    assert one.memory.tobytes() == last.tobytes()
    fresh = law(choice)
    fresh.memory = last.copy()
    assert act(fresh, 40, x[40]).tobytes() == act(one, 40, x[40]).tobytes()


@pytest.mark.parametrize("choice", CHOICES)
def test_before_any_sample_every_law_acts(choice: str) -> None:
    """n = 0, and states and flows that are all 0: finite inputs, and ties go to the first candidate."""
    one = law(choice)
    for t in range(4):
        assert np.isfinite(act(one, t, np.ones(3))).all()
        learn(one, t, np.zeros(3), np.zeros(3), np.zeros(3))
    act(one, 4, np.ones(3))
    ahat = one.report()[0]
    assert np.isfinite(ahat).all()
    if choice in LISTED and choice != "thompson":
        assert ahat.tolist() == [0.3, 0.5, 0.2]


@pytest.mark.parametrize("choice", [*CHOICES, "forgetting(decay=0.9)", "hysteresis(h=0.1)"])
@given(topology=faulty(), kept=st.sampled_from([1, 3, 100_000]), data=st.data())
@settings(max_examples=6)
def test_every_layout_under_any_fault_gives_the_same_bits(
    choice: str, topology: Topology, kept: int, data: st.DataObject
) -> None:
    topology = laws.checked(topology.model_copy(update={"law": choice, "history": kept}))
    assert simulate(topology, data.draw(partitions(len(topology.ids)))).same_bits(simulate(topology))


@pytest.mark.parametrize("choice", CHOICES)
def test_a_back_filled_memory_is_the_memory_without_the_gap(choice: str) -> None:
    """Samples of steps 5 to 12 arrive late: the law returns to the memory of step 5 and learns them again."""
    x, flow = history(30, 3, lost=0.0)
    whole = taught(choice, x, flow)
    late = law(choice)
    for t in range(20):
        if t == 5:
            saved = late.memory.copy()
        learn(late, t, x[t], np.where([t < 5 or t > 12, True, True], flow[t], np.nan), x[t + 1])
    partly = late.memory.copy()
    partly[..., 0] = saved[..., 0]
    late.memory = partly
    for t in range(5, 20):
        learn(late, t, x[t], np.where([True, False, False], flow[t], np.nan), x[t + 1])
    for t in range(20, 30):
        learn(late, t, x[t], flow[t], x[t + 1])
    assert late.memory.tobytes() == whole.memory.tobytes()


def test_a_parameter_out_of_range_is_refused() -> None:
    for choice in ("forgetting(decay=0)", "hysteresis(h=-1)", "rls(eps=0)", "bayes(sigma=0)", "robust(theta=1.0)"):
        with pytest.raises(UserError):
            law(choice)


# The formulas, against sums in exact arithmetic.


def residuals(x: Array, flow: Array, a: float) -> list[Fraction | None]:
    """r of one node, None where the sample is lost."""
    found: list[Fraction | None] = []
    for t in range(len(flow)):
        if math.isnan(flow[t]):
            found.append(None)
        else:
            y = Fraction(float(x[t + 1] - B * flow[t]))
            found.append(Fraction(a) * Fraction(float(x[t])) - y)
    return found


@given(st.integers(0, 10**6), st.sampled_from([0.0, 0.3]), st.sampled_from([0.0, 1e4]))
@settings(max_examples=15)
def test_the_scores_are_the_formulas(seed: int, lost: float, mean: float) -> None:
    """Also where the naive sums would cancel: with a mean of 10^4 they lose eight digits."""
    x, flow = history(25, 1, seed, lost)
    flow = flow + mean
    models = [0.3, 0.6]
    for m, a in enumerate(models):
        r = residuals(x[:, 0], flow[:, 0], a)
        known = [one for one in r if one is not None]
        n = len(known)
        centred = sum(one * one for one in known) - (sum(known) ** 2 / n if n else 0)
        triples = [(r[t], r[t - 1], r[t - 2]) for t in range(2, 25) if None not in (r[t], r[t - 1], r[t - 2])]
        s0 = sum((q * q for _, q, _ in triples), Fraction(0))  # type: ignore[operator]
        s1 = sum(((p + s) * q for p, q, s in triples), Fraction(0))  # type: ignore[operator]
        s2 = sum(((p + s) ** 2 for p, _, s in triples), Fraction(0))  # type: ignore[operator]
        notch = s2 - (s1 * s1 / s0 if s0 else 0)
        decayed = Fraction(0)
        for one in known:
            decayed = Fraction(0.98) * decayed + one * one
        for choice, expected in (
            ("minimax", sum(one * one for one in known)),
            ("forgetting", decayed),
            ("set-membership", max(map(abs, known), default=Fraction(0))),
            ("centred", centred),
            ("notch", notch),
        ):
            score = float(taught(choice, x, flow, [models]).memory[m, 0])
            assert score >= 0
            scale = float(sum(abs(one) for one in known)) / max(n, 1)
            assert score == pytest.approx(float(expected), rel=1e-9, abs=1e-9 * (1 + scale)), choice


def test_a_sinusoid_leaves_the_notch_of_the_truth_nothing() -> None:
    """After 2000 samples its score is not below 0, and far below that of the wrong model."""
    x, w = np.zeros((2001, 1)), np.sin(0.4 * np.arange(2000) + 1)
    for t in range(2000):
        x[t + 1] = 0.6 * x[t] + w[t]
    scores = taught("notch", x, np.zeros((2000, 1)), [[0.3, 0.6]]).memory[:2, 0]
    assert 0 <= scores[1] < 1e-20
    assert scores[0] > 1e10 * scores[1]


def test_rls_is_its_closed_form() -> None:
    x, flow = history(50, 1, lost=0.3)
    heard_of = ~np.isnan(flow[:, 0])
    z, y = x[:-1, 0][heard_of], (x[1:, 0] - B * flow[:, 0])[heard_of]
    expected = (z @ y + 0.001 * 0.5) / (z @ z + 0.001)
    assert taught("rls", x, flow, [[0.01, 0.99]]).memory[1, 0] == pytest.approx(expected, rel=1e-9)


def test_hysteresis_switches_less_and_not_at_all_by_less_than_its_factor() -> None:
    one = law("hysteresis(h=1.0)", [[0.2, 0.6]])
    learn(one, 0, np.ones(1), np.zeros(1), np.array([0.1]))  # residuals 0.1 and 0.5
    assert one.report()[0] == [0.2]
    learn(one, 1, np.ones(1), np.zeros(1), np.array([0.5]))  # J 0.10 and 0.26
    learn(one, 2, np.ones(1), np.zeros(1), np.array([0.75]))  # J 0.4025 and 0.2825: less than twice
    assert one.report()[0] == [0.2]
    learn(one, 3, np.ones(1), np.zeros(1), np.array([0.75]))  # J 0.705 and 0.305
    assert one.report()[0] == [0.6]


def test_the_weights_of_bayes_are_those_of_the_formula() -> None:
    x, flow = history(5, 1, lost=0.0)
    one = taught("bayes(sigma=2.0)", x, flow, [[0.3, 0.6, 0.9]])
    pi = np.exp(-one.memory[:, 0] / 8)
    pi /= pi.sum()
    a = np.array([0.3, 0.6, 0.9])
    assert one.report()[0, 0] == pytest.approx(pi @ a, rel=1e-12)
    assert act(one, 5, np.array([2.0]))[0] == pytest.approx(2 * B * (pi / (a - 1)).sum(), rel=1e-12)


def test_thompson_draws_by_the_posterior_and_by_the_step() -> None:
    """4000 steps at one memory: frequencies within five standard errors, and the same again."""
    x, flow = history(3, 1, lost=0.0)
    one = taught("thompson(sigma=2.0)", x, flow, [[0.3, 0.6, 0.9]])
    pi = np.exp(-one.memory[:, 0] / 8)
    pi /= pi.sum()
    drawn = []
    for t in range(4000):
        act(one, t, np.ones(1))
        drawn.append(one.report()[0, 0])
    for a, p in zip((0.3, 0.6, 0.9), pi, strict=True):
        assert abs(np.mean(np.array(drawn) == a) - p) < 5 * math.sqrt(p * (1 - p) / 4000)
    act(one, 17, np.ones(1))
    assert one.report()[0, 0] == drawn[17]


@given(st.lists(floats(-720, 0) | floats(-2, 0), min_size=1, max_size=40))
def test_exp_is_the_exponential_function(numbers: list[float]) -> None:
    found = exp(np.array(numbers))
    for x, y in zip(numbers, found.tolist(), strict=True):
        assert y == pytest.approx(math.exp(x), rel=4e-16) if x >= -708 else y == 0.0
    assert exp(np.array([-np.inf, 0.0])).tolist() == [0.0, 1.0]


def test_robust_gets_its_theta_from_the_operator() -> None:
    """Theta is within the range of the candidates, and its worst gain is at most that of other numbers."""
    from hedgerow.orchestrator.ground.robust import _coupling, theta_of, worst_gain  # noqa: PLC0415

    topology = read("{name: r, b: 0.1, steps: 3, seed: 4, nodes: [1, 2, 3], edges: [[1, 2], [2, 3]], law: robust}")
    network = topology.network
    theta = theta_of(network)
    assert laws.checked(topology).law == f"robust(theta={theta})"
    low, high = np.nanmin(network.candidates, axis=0), np.nanmax(network.candidates, axis=0)
    assert low.min() - 1e-4 <= theta <= high.max() + 1e-4
    best = worst_gain(theta, low, high, _coupling(network))
    assert all(
        worst_gain(other, low, high, _coupling(network)) >= best * (1 - 1e-3)
        for other in np.linspace(low.min(), high.max(), 30)
    )
    assert simulate(laws.checked(topology), layout(topology, 1)).same_bits(simulate(laws.checked(topology)))
