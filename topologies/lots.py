"""Lots: random numbers that are a function of (seed, field, id, step) alone.

A lot is a counter-based hash, so it does not depend on any other lot. The order of nodes in a file, an added node,
earlier steps, and the number of seeds in one call do not change it. With `mix` the finalizer of SplitMix64 and ^ the
exclusive or of 64-bit words,

    key = mix(mix(mix(seed) ^ field) ^ id),    lot(t) = mix(key ^ mix(t)).

Every function takes arrays of words and broadcasts them: seeds of shape (S, 1) and ids of shape (n,) give (S, n).

The numbers come from integer operations and the + - * / sqrt of IEEE 754, each as a separate NumPy call. These round
equally on every machine. NumPy's `log` and `cos` do not: their last bits differ between SIMD instruction sets. So
`normals` computes the logarithm itself.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hedgerow.topologies.graph import Array

Words = NDArray[np.uint64]

BLOCK = 2**14
"""the number of values that fit the cache"""

_GAMMA, _FIRST, _SECOND = (np.uint64(word) for word in (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB))
_TEXT = np.uint64(0x746578742D696473)
"""the start value of the hash of a text, different from that of a whole number"""
_WHOLE = re.compile("0|-?[1-9][0-9]{0,18}")


def mix(words: Words) -> Words:
    """Return the SplitMix64 hash of 64-bit words, an array of one dimension or more; a bijection."""
    words = words + _GAMMA
    words ^= words >> np.uint64(30)
    words *= _FIRST
    words ^= words >> np.uint64(27)
    words *= _SECOND
    words ^= words >> np.uint64(31)
    return words


def words_of(ids: Sequence[int | str] | NDArray[Any]) -> Words:
    """Return the word of each id, (n,).

    A whole number of 64 bits and its decimal text have the same word: 7 and "7" do, "007" and "+7" do not. Files that
    name one node in different formats then give it the same lots. A larger number has the word of its decimal digits as
    a text. The word of a text is the mix of its code points one after the other.
    """
    if isinstance(ids, range):
        return mix(np.arange(ids.start, ids.stop, ids.step, dtype=np.int64).astype(np.uint64))
    if isinstance(ids, np.ndarray) and ids.dtype.kind in "iu":
        return mix(ids.astype(np.uint64))
    spelled: list[int | str] = [_canonical(node) for node in ids]
    found = np.empty(len(spelled), dtype=np.uint64)
    texts = [k for k, node in enumerate(spelled) if isinstance(node, str)]
    whole = [k for k, node in enumerate(spelled) if isinstance(node, int)]
    found[whole] = mix(np.array([spelled[k] for k in whole], dtype=np.int64).astype(np.uint64))
    found[texts] = _of_texts([str(spelled[k]) for k in texts])
    return found


def _canonical(node: int | str) -> int | str:
    """Return a whole number of 64 bits, or its decimal text, as an integer, and any other id as text."""
    if isinstance(node, str):
        if not _WHOLE.fullmatch(node):
            return str(node)
        node = int(node)
    return int(node) if -(2**63) <= node < 2**63 else str(node)


def _of_texts(texts: Sequence[str]) -> Words:
    found = np.full(len(texts), _TEXT)
    if not len(texts):
        return found
    # The code points, with zeros after the end of a shorter text: no id contains a zero.
    points = np.array(texts, dtype=np.str_)[:, None].view(np.uint32)
    for column in points.T:
        found = np.where(column != 0, mix(found ^ column.astype(np.uint64)), found)
    return found


@cache
def _field(name: str) -> np.uint64:
    word: np.uint64 = _of_texts([name])[0]
    return word


def pairs_of(one: Words, other: Words) -> Words:
    """Return the word of each ordered pair, such as a link from one node to another."""
    return mix(mix(one) ^ other)


def edges_of(one: Words, other: Words) -> Words:
    """Return the word of each edge, whichever of its ends is named first."""
    return pairs_of(np.minimum(one, other), np.maximum(one, other))


def keys(seed: int | Words, field: str, ids: Words) -> Words:
    """Return the key of a lot for all steps; `seed` is one number, or an array that broadcasts with `ids`."""
    seeds = np.array([seed], dtype=np.uint64) if isinstance(seed, int) else seed
    return mix(mix(mix(seeds) ^ _field(field)) ^ ids)


def at(keys: Words, steps: Words | NDArray[np.int64]) -> Words:
    """Return the lots of `keys` at `steps`, which broadcast, as 64-bit words."""
    return mix(keys ^ mix(np.asarray(steps).astype(np.uint64)))


def uniforms(words: Words) -> Array:
    """Return lots as numbers in [0, 1): multiples of 2^-53."""
    return np.asarray((words >> np.uint64(11)) * 2.0**-53)


def normals(words: Words) -> Array:
    """Return lots as standard normal numbers, of any shape; the largest is 8.21.

    This is the quantile function at an odd multiple of 2^-53, by Wichura's rational functions (AS 241, PPND16), which
    are exact to about 1e-15.
    """
    flat = words.ravel()
    found = np.empty(len(flat))
    for start in range(0, len(flat), BLOCK):
        some = slice(start, start + BLOCK)
        found[some] = _quantiles(flat[some])
    return found.reshape(words.shape)


def _quantiles(words: Words) -> Array:
    q = (words >> np.uint64(12)).astype(np.float64)
    q += 0.5
    q *= 2.0**-52
    q -= 0.5  # an odd multiple of 2^-53 in (-1/2, 1/2)
    found = q * _ratio(0.180625 - q * q, _CENTRE)
    tail = np.flatnonzero(np.abs(q) > 0.425)
    if len(tail):
        low = q[tail]
        far = np.sqrt(-_log(0.5 - np.abs(low)))
        size = _ratio(far - 1.6, _TAIL)
        if len(end := np.flatnonzero(far > 5)):
            size[end] = _ratio(far[end] - 5.0, _END)
        found[tail] = np.copysign(size, low)
    return found


def _log(p: Array) -> Array:
    """Return the natural logarithm of positive numbers, to a relative error of 1e-16: 2 artanh((m - 1)/(m + 1)) + e log
    2.
    """
    m, e = np.frexp(p)
    low = m < _ROOT
    m[low] *= 2.0
    e[low] -= 1
    s = (m - 1.0) / (m + 1.0)
    return 2.0 * s * _horner(s * s, _ARTANH) + e * _LOG_2


def _ratio(r: Array, of: tuple[Sequence[float], Sequence[float]]) -> Array:
    ratio = _horner(r, of[0])
    ratio /= _horner(r, of[1])
    return ratio


def _horner(r: Array, coefficients: Iterable[float]) -> Array:
    first, second, *rest = coefficients
    total = first * r
    total += second
    for coefficient in rest:
        total *= r
        total += coefficient
    return total


_ROOT, _LOG_2 = 0.7071067811865476, 0.6931471805599453
_ARTANH = tuple(1 / k for k in range(23, 0, -2))
"""the coefficients in s^2, for |s| < 0.172, where the next term is below 1e-17 of the sum"""
_CENTRE = (
    (
        *(2.5090809287301226727e3, 3.3430575583588128105e4, 6.7265770927008700853e4, 4.5921953931549871457e4),
        *(1.3731693765509461125e4, 1.9715909503065514427e3, 1.3314166789178437745e2, 3.3871328727963666080),
    ),
    (
        *(5.2264952788528545610e3, 2.8729085735721942674e4, 3.9307895800092710610e4, 2.1213794301586595867e4),
        *(5.3941960214247511077e3, 6.8718700749205790830e2, 4.2313330701600911252e1, 1.0),
    ),
)
_TAIL = (
    (
        *(7.74545014278341407640e-4, 2.27238449892691845833e-2, 2.41780725177450611770e-1, 1.27045825245236838258),
        *(3.64784832476320460504, 5.76949722146069140550, 4.63033784615654529590, 1.42343711074968357734),
    ),
    (
        *(1.05075007164441684324e-9, 5.47593808499534494600e-4, 1.51986665636164571966e-2, 1.48103976427480074590e-1),
        *(6.89767334985100004550e-1, 1.67638483018380384940, 2.05319162663775882187, 1.0),
    ),
)
_END = (
    (
        *(2.01033439929228813265e-7, 2.71155556874348757815e-5, 1.24266094738807843860e-3, 2.65321895265761230930e-2),
        *(2.96560571828504891230e-1, 1.78482653991729133580, 5.46378491116411436990, 6.65790464350110377720),
    ),
    (
        *(2.04426310338993978564e-15, 1.42151175831644588870e-7, 1.84631831751005468180e-5, 7.86869131145613259100e-4),
        *(1.48753612908506148525e-2, 1.36929880922735805310e-1, 5.99832206555887937690e-1, 1.0),
    ),
)
