"""The H-infinity facts of a network whose a is known: condition (3), Q, gamma*, and the contraction rho.

With S = I - A and the graph Laplacian L, Q = S^2 + b^2 L. See docs/theory.md for what each number promises.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, cast

import numpy as np

from topologies.graph import Array, Graph

if TYPE_CHECKING:
    import scipy.sparse

_DENSE = 400
"""Up to this many nodes dense linear algebra is quicker than loading the sparse one."""


def allowed_interval(b: float, degree: int) -> tuple[float, float] | None:
    """The open interval of a that satisfies condition (3), a^2 + 2 b^2 d < a; None when there is none."""
    discriminant = 1 - 8 * b * b * degree
    if discriminant <= 0:
        return None
    s = math.sqrt(discriminant)
    return (1 - s) / 2, (1 + s) / 2


def satisfies_condition(a: float, b: float, degree: int) -> bool:
    """Condition (3) itself: a^2 + 2 b^2 d_i < a."""
    return 0 < a < 1 and a * a + 2 * b * b * degree < a


def contraction(a: Array, candidates: Array) -> float:
    """The rho = max_j max(a_j, max_m a_jm - a_j) of |x(t+1)|_1 <= rho |x(t)|_1 + |w(t)|_1, whatever is estimated.

    a: (n,); candidates: (M, n), NaN where a list has fewer.
    """
    return float(np.maximum(a, np.nanmax(candidates, axis=0) - a).max())


def _q(a: Array, b: float, graph: Graph) -> scipy.sparse.csc_array:
    import scipy.sparse  # noqa: PLC0415 (half a second, and only large networks need it)

    diagonal = (1 - a) ** 2 + b * b * graph.degree
    i, j = graph.node, graph.neighbour
    off = scipy.sparse.coo_array((np.full(len(i), -b * b), (i, j)), shape=(graph.n, graph.n))
    return cast("scipy.sparse.csc_array", (scipy.sparse.diags_array(diagonal) + off).tocsc())


def _q_dense(a: Array, b: float, graph: Graph) -> Array:
    q = np.diag((1 - a) ** 2 + b * b * graph.degree)
    q[graph.node, graph.neighbour] -= b * b
    return q


def smallest_eigenpair(a: Array, b: float, graph: Graph) -> tuple[float, Array]:
    """lambda_min(Q) and its unit eigenvector, signed so that its sum is not negative."""
    if graph.n <= _DENSE:
        values, vectors = np.linalg.eigh(_q_dense(a, b, graph))
        value, vector = float(values[0]), vectors[:, 0]
    else:
        from scipy.sparse.linalg import eigsh  # noqa: PLC0415

        values, vectors = eigsh(_q(a, b, graph), k=1, sigma=0, v0=np.ones(graph.n))
        value, vector = float(values[0]), vectors[:, 0]
    return value, -vector if vector.sum() < 0 else vector


def gamma_star(a: Array, b: float, graph: Graph) -> float:
    """gamma* = lambda_min(Q)^(-1/2), the optimal gain for the edge cost and known a; never the adaptive law's."""
    return 1 / math.sqrt(smallest_eigenpair(a, b, graph)[0])


def q_solver(a: Array, b: float, graph: Graph) -> Callable[[Array], Array]:
    """A function w -> Q^(-1) w, for w of shape (n,) or (n, k)."""
    if graph.n <= _DENSE:
        inverse = np.linalg.inv(_q_dense(a, b, graph))
        return lambda w: inverse @ w
    from scipy.sparse.linalg import splu  # noqa: PLC0415

    return cast("Callable[[Array], Array]", splu(_q(a, b, graph)).solve)
