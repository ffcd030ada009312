"""The laws of the project for one node in Python's floats, for the quiet steps of small shards (agents.float_law).

A rule learns one sample and acts: the same operations in the same order as the law in `agents/laws`, so that both give
the same bits. The law itself stays the definition: it makes all other steps, and a test compares the two.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import floor, inf, ldexp, nan
from typing import Any

from hedgerow.agents.float_rule import Act, Memory, Rule, Sample
from hedgerow.agents.laws.bayes import Bayes
from hedgerow.agents.laws.centred import Centred
from hedgerow.agents.laws.either import Either
from hedgerow.agents.laws.exponential import LEAST, LOG_2_HIGH, LOG_2_LOW, PER_LOG_2, SERIES
from hedgerow.agents.laws.forgetting import Forgetting
from hedgerow.agents.laws.hysteresis import Hysteresis
from hedgerow.agents.laws.notch import TINY, Notch
from hedgerow.agents.laws.rls import RLS
from hedgerow.agents.laws.robust import Robust
from hedgerow.agents.laws.set_membership import TIE, SetMembership
from hedgerow.agents.laws.thompson import Thompson
from hedgerow.topologies import lots


def rule_of(law: Any, node: int) -> Rule | None:
    """Return the rule of a law for one of its nodes; None if its class has none, or the lists are not of one length."""
    make = _RULES.get(type(law))
    return None if make is None else make(law, node)


def _first_least(scores: Memory, candidates: Sequence[float], memory: Memory, bx: float) -> Act:
    ordered = sorted(scores)
    ahat = candidates[scores.index(ordered[0])]
    return memory, bx / (ahat - 1.0), ahat, ordered[1] - ordered[0] if len(ordered) > 1 else inf


def _candidates(law: Any, node: int) -> list[float]:
    found: list[float] = law.candidates[:, node].tolist()
    return found


def _forgetting(law: Forgetting, node: int) -> Rule:
    candidates, decay = _candidates(law, node), law.decay

    def rule(memory: Memory, sample: Sample) -> Act:
        _, x, y, bx = sample
        J = [j * decay + (r := a * x - y) * r for j, a in zip(memory, candidates, strict=True)]
        return _first_least(J, candidates, J, bx)

    return rule


def _set_membership(law: SetMembership, node: int) -> Rule:
    candidates = _candidates(law, node)

    def rule(memory: Memory, sample: Sample) -> Act:
        _, x, y, bx = sample
        J = [max(j, abs(a * x - y)) for j, a in zip(memory, candidates, strict=True)]
        ordered = sorted(J)
        limit = TIE * ordered[0]
        ahat = next((a for j, a in zip(J, candidates, strict=True) if j <= limit), nan)
        return J, bx / (ahat - 1.0), ahat, ordered[1] - ordered[0] if len(J) > 1 else inf

    return rule


def _hysteresis(law: Hysteresis, node: int) -> Rule:
    candidates, factor = _candidates(law, node), 1.0 + law.h

    def rule(memory: Memory, sample: Sample) -> Act:
        _, x, y, bx = sample
        J = [j + (r := a * x - y) * r for j, a in zip(memory, candidates, strict=False)]
        kept, least = int(memory[-1]), min(J)
        if factor * least <= J[kept]:
            kept = J.index(least)
        others = min(J[:kept] + J[kept + 1 :], default=nan)
        ahat = candidates[kept]
        margin = others - J[kept] if len(J) > 1 else inf
        return [*J, float(kept)], bx / (ahat - 1.0), ahat, margin

    return rule


def _centred(law: Centred, node: int) -> Rule:
    candidates = _candidates(law, node)
    m = len(candidates)

    def rule(memory: Memory, sample: Sample) -> Act:
        _, x, y, bx = sample
        n = memory[-1] + 1.0
        share = (n - 1.0) / n
        J, means = [], []
        for j, mean, a in zip(memory[:m], memory[m:-1], candidates, strict=True):
            apart = a * x - y - mean
            means.append(mean + apart / n)
            J.append(j + apart * apart * share)
        return _first_least(J, candidates, [*J, *means, n], bx)

    return rule


def _notched(memory: Memory, candidates: Sequence[float], sample: Sample) -> Memory:
    """Return the memory of the notch after a sample; agents.laws.notch.notched."""
    t, x, y, _ = sample
    m = len(candidates)
    x_1, y_1, x_2, y_2, step, run = memory[3 * m :]
    if step != t - 1:
        run = 0.0
    body = memory[: 3 * m]
    if run >= 2:
        J, cs, sums = [], [], []
        for j, c, s, a in zip(memory[:m], memory[m : 2 * m], memory[2 * m : 3 * m], candidates, strict=True):
            v, z = a * x - y + (a * x_2 - y_2), a * x_1 - y_1
            squared = z * z
            if squared < TINY:
                z = squared = 0.0
            whole = s + squared
            some = whole > 0
            by = whole if some else 1.0
            v -= c * z
            J.append(j + v * v * (s / by if some else 1.0))
            cs.append(c + v * (z / by))
            sums.append(whole)
        body = J + cs + sums
    return [*body, x, y, x_1, y_1, float(t), run + 1.0]


def _notch(law: Notch, node: int) -> Rule:
    candidates = _candidates(law, node)

    def rule(memory: Memory, sample: Sample) -> Act:
        learned = _notched(memory, candidates, sample)
        return _first_least(learned[: len(candidates)], candidates, learned, sample.bx)

    return rule


def _either(law: Either, node: int) -> Rule:
    candidates, ratio = _candidates(law, node), law.ratio
    m = len(candidates)

    def rule(memory: Memory, sample: Sample) -> Act:
        _, x, y, bx = sample
        J = [j + (r := a * x - y) * r for j, a in zip(memory[:m], candidates, strict=True)]
        rest = _notched(memory[m:], candidates, sample)
        scores = rest[:m] if min(rest[:m]) < ratio * min(J) else J
        return _first_least(scores, candidates, J + rest, bx)

    return rule


def _rls(law: RLS, node: int) -> Rule:
    low, high = float(law.low[node]), float(law.high[node])

    def rule(memory: Memory, sample: Sample) -> Act:
        _, x, y, bx = sample
        R, a = memory
        R += x * x
        a += (y - a * x) * x / R
        ahat = min(max(a, low), high)
        return [R, a], bx / (ahat - 1.0), ahat, nan

    return rule


def _robust(law: Robust, node: int) -> Rule:
    theta = float(law.report()[0, node])

    def rule(memory: Memory, sample: Sample) -> Act:
        return memory, sample.bx / (theta - 1.0), theta, nan

    return rule


def _exp(x: float) -> float:
    """Return e^x of x <= 0; agents.laws.exponential.exp."""
    if x < LEAST:
        return 0.0
    k = floor(x * PER_LOG_2 + 0.5)
    r = x - k * LOG_2_HIGH
    r -= k * LOG_2_LOW
    total = SERIES[0]
    for coefficient in SERIES[1:]:
        total = total * r + coefficient
    return ldexp(total, k)


def _weights(J: Memory, sigma: float) -> Memory:
    least, scale = min(J), 2.0 * sigma * sigma
    return [_exp((least - j) / scale) for j in J]


def _bayes(law: Bayes, node: int) -> Rule:
    candidates, sigma = _candidates(law, node), law.sigma

    def rule(memory: Memory, sample: Sample) -> Act:
        _, x, y, bx = sample
        J = [j + (r := a * x - y) * r for j, a in zip(memory, candidates, strict=True)]
        whole = gain = mean = 0.0
        for weight, a in zip(_weights(J, sigma), candidates, strict=True):
            whole += weight
            gain += weight / (a - 1.0)
            mean += weight * a
        return J, bx * (gain / whole), mean / whole, nan

    return rule


_WORD = 2**64 - 1


def _mix(word: int) -> int:
    """Return the hash of a word; topologies.lots.mix."""
    word = (word + 0x9E3779B97F4A7C15) & _WORD
    word = ((word ^ (word >> 30)) * 0xBF58476D1CE4E5B9) & _WORD
    word = ((word ^ (word >> 27)) * 0x94D049BB133111EB) & _WORD
    return word ^ (word >> 31)


def _thompson(law: Thompson, node: int) -> Rule:
    candidates, sigma = _candidates(law, node), law.sigma
    local = law.local
    key = int(lots.keys(local.seeds, "thompson", lots.words_of(local.ids))[node])

    def rule(memory: Memory, sample: Sample) -> Act:
        t, x, y, bx = sample
        J = [j + (r := a * x - y) * r for j, a in zip(memory, candidates, strict=True)]
        sums, total = [], 0.0
        for weight in _weights(J, sigma):
            total += weight
            sums.append(total)
        drawn = (_mix(key ^ _mix(t + 1)) >> 11) * 2.0**-53 * total
        place = min(sum(one <= drawn for one in sums), len(J) - 1)
        ahat = candidates[place]
        return J, bx / (ahat - 1.0), ahat, nan

    return rule


_RULES: dict[type[Any], Callable[[Any, int], Rule]] = {
    Forgetting: _forgetting,
    SetMembership: _set_membership,
    Hysteresis: _hysteresis,
    Centred: _centred,
    Notch: _notch,
    Either: _either,
    RLS: _rls,
    Robust: _robust,
    Bayes: _bayes,
    Thompson: _thompson,
}
