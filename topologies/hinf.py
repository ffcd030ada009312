"""The H-infinity facts of a network with known a: condition (3), Q, gamma*, and the contraction rho.

With S = I - A, the gains b_i and the weighted graph Laplacian L, Q = S^2 + diag(b) L diag(b). If all gains are b and
all weights 1, Q is the paper's S^2 + b^2 L. See docs/theory.md for the meaning of each number.

In all functions `b` is one gain or the gain of each node, (n,). A degree is d_i, the sum of the weights of a node's
edges.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING, cast

import numpy as np

from hedgerow.topologies.errors import Code, HedgerowError, UserError
from hedgerow.topologies.graph import Array, Gain, Graph, Index, Mask

if TYPE_CHECKING:
    import scipy.sparse

_DENSE = 400
"""Up to this number of nodes, dense linear algebra is faster than loading the sparse one."""
FACTORED = 5_000
"""Up to this number of nodes, Q is factored, which is exact; the factors of a larger Q may exceed the memory."""
EIGENVALUE_RTOL = 1e-3
"""For a larger Q: the maximum relative error of lambda_min(Q), guaranteed by the residual; that of gamma* is half of
it.
"""
SUPPLY_RTOL = 1e-6
"""For a larger Q: the maximum relative error of w'Q^(-1)w."""
SUPPLY_PRODUCTS = 1_000
"""For a larger Q: the maximum number of products with Q for one value.

If they do not suffice, the reported error is larger.
"""


def allowed_interval(b: float, degree: float) -> tuple[float, float] | None:
    """Return the open interval of a that satisfies condition (3), a^2 + 2 b_i^2 d_i < a; None if it is empty."""
    discriminant = 1 - 8 * b * b * degree
    if discriminant <= 0:
        return None
    s = math.sqrt(discriminant)
    return (1 - s) / 2, (1 + s) / 2


def satisfies_condition(a: float, b: float, degree: float) -> bool:
    """Return True if condition (3) holds: a^2 + 2 b_i^2 d_i < a."""
    return 0 < a < 1 and a * a + 2 * b * b * degree < a


def allowed_intervals(b: Gain, degree: Index | Array) -> tuple[Array, Array]:
    """Return the low and high ends of the intervals of many nodes; NaN where an interval is empty."""
    with np.errstate(invalid="ignore"):
        s = np.sqrt(1 - 8 * b * b * degree)
    s[s <= 0] = np.nan
    return (1 - s) / 2, (1 + s) / 2


def condition_holds(a: Array, b: Gain, degree: Index | Array) -> Mask:
    """Return True for each node with condition (3) satisfied; a: (n,) or (M, n)."""
    return np.asarray((a > 0) & (a < 1) & (a * a + 2 * b * b * degree < a))


def contraction(a: Array, candidates: Array) -> float:
    """Return the rho = max_j max(a_j, max_m a_jm - a_j) of |x(t+1)| <= rho |x(t)| + |w(t)|, for any estimates.

    The norm is |x| = sum |x_i| / b_i. a: (n,); candidates: (M, n), padded with NaN.
    """
    return float(np.maximum(a, np.nanmax(candidates, axis=0) - a).max())


def _q(a: Array, b: Gain, graph: Graph) -> scipy.sparse.csc_array:
    import scipy.sparse  # noqa: PLC0415 (half a second, and only large networks need it)

    diagonal = (1 - a) ** 2 + b * b * graph.weighted_degree
    i, j = graph.node, graph.neighbour
    beside = np.broadcast_to(_beside(b, graph), len(i))
    off = scipy.sparse.coo_array((beside, (i, j)), shape=(graph.n, graph.n))
    return cast("scipy.sparse.csc_array", (scipy.sparse.diags_array(diagonal) + off).tocsc())


def _q_dense(a: Array, b: Gain, graph: Graph) -> Array:
    q = np.diag((1 - a) ** 2 + b * b * graph.weighted_degree)
    q[graph.node, graph.neighbour] += _beside(b, graph)
    return q


def _beside(b: Gain, graph: Graph) -> Gain:
    """Return Q_ij = -b_i k_ij b_j of each incidence, (2E,), or one number if all are equal."""
    beside = -b[graph.node] * b[graph.neighbour] if isinstance(b, np.ndarray) else -b * b
    return beside if graph.weight is None else beside * graph.weight


def smallest_eigenpair(a: Array, b: Gain, graph: Graph) -> tuple[float, Array]:
    """Return lambda_min(Q) and its unit eigenvector, with the sign that makes its sum nonnegative."""
    if graph.n <= _DENSE:
        try:
            values, vectors = np.linalg.eigh(_q_dense(a, b, graph))
        except np.linalg.LinAlgError as error:  # numbers outside the range of a topology file
            raise UserError(
                f"gamma*: Q has no eigenvalues that can be computed ({error}); correct a and b",
                code=Code.TOPOLOGY,
            ) from None
        value, vector = float(values[0]), vectors[:, 0]
    elif graph.n > FACTORED:
        value, vector = _lobpcg(a, b, graph)
    else:
        from scipy.sparse.linalg import eigsh  # noqa: PLC0415

        values, vectors = eigsh(_q(a, b, graph), k=1, sigma=0, v0=np.ones(graph.n))
        value, vector = float(values[0]), vectors[:, 0]
    return value, -vector if vector.sum() < 0 else vector


def _lobpcg(a: Array, b: Gain, graph: Graph) -> tuple[float, Array]:
    """Return the smallest eigenpair by products with Q alone, from a positive start vector: this eigenvector has one
    sign.
    """
    from scipy.sparse.linalg import LinearOperator, lobpcg  # noqa: PLC0415

    q = _q(a, b, graph).tocsr()
    diagonal = q.diagonal()
    divided = LinearOperator(q.shape, matvec=lambda x: x.ravel() / diagonal, matmat=lambda x: x / diagonal[:, None])
    # Q - (1 - a)^2 is positive semidefinite: no eigenvalue is below this one.
    residual = EIGENVALUE_RTOL * float(((1 - a) ** 2).min())
    with warnings.catch_warnings():
        # The warning that it did not converge; the residual is checked below.
        warnings.simplefilter("ignore", UserWarning)
        values, vectors = lobpcg(q, (1 / diagonal)[:, None], M=divided, tol=residual, maxiter=2000, largest=False)
    value, vector = float(values[0]), vectors[:, 0] / np.linalg.norm(vectors[:, 0])
    if (found := float(np.linalg.norm(q @ vector - value * vector))) > 10 * residual:
        raise HedgerowError(
            f"gamma*: lambda_min(Q) = {value:g} is known to {found:.1g} only; report this network", code=Code.CRASH
        )
    return value, vector


def gamma_star(a: Array, b: Gain, graph: Graph) -> float:
    """Return gamma* = lambda_min(Q)^(-1/2), the optimal gain for the edge cost and known a; not that of the adaptive
    law.
    """
    return 1 / math.sqrt(smallest_eigenpair(a, b, graph)[0])


def q_solver(a: Array, b: Gain, graph: Graph) -> Callable[[Array], Array]:
    """Return a function w -> Q^(-1) w, for w of shape (n,) or (n, k), by the factors of Q."""
    if graph.n <= _DENSE:
        inverse = np.linalg.inv(_q_dense(a, b, graph))
        return lambda w: inverse @ w
    from scipy.sparse.linalg import splu  # noqa: PLC0415

    return cast("Callable[[Array], Array]", splu(_q(a, b, graph)).solve)


def supply_rate(a: Array, b: Gain, graph: Graph) -> Callable[[Array], tuple[float, float]]:
    """Return a function w -> (lower, error) with lower <= w'Q^(-1)w <= lower + error, for w of shape (n,).

    Up to FACTORED nodes, the error is 0. For more nodes it is SUPPLY_RTOL of the lower bound, and it is proved, not
    estimated.
    """
    if graph.n > FACTORED:
        return _Supply(a, b, graph)
    solve = q_solver(a, b, graph)
    return lambda w: (float((w * solve(w)).sum()), 0.0)


class _Supply:
    """The supply rate by conjugate gradients, with Q's diagonal D as preconditioner, from the best multiple of the last
    solution.

    For every y, w'Q^(-1)w = 2 y'w - y'Qy + r'Q^(-1)r with r = w - Qy. Because Q - (1 - a)^2 is positive semidefinite, 0
    <= r'Q^(-1)r <= sum (r_i / (1 - a_i))^2. This is at most max_i (D_i / (1 - a_i)^2) r'D^(-1)r, which the method
    computes anyway.
    """

    def __init__(self, a: Array, b: Gain, graph: Graph) -> None:
        self._q = _q(a, b, graph).tocsr()
        self._over_d = 1 / self._q.diagonal()
        self._loose = float((1 / (self._over_d * (1 - a) ** 2)).max())
        self._y, self._qy = np.zeros(graph.n), np.zeros(graph.n)

    def __call__(self, w: Array) -> tuple[float, float]:
        y, qy = self._y, self._qy
        along = _dot(y, qy)
        if along > 0:
            share = _dot(y, w) / along
            y, qy, least = share * y, share * qy, share * _dot(y, w)
        else:
            y, qy, least = np.zeros_like(w), np.zeros_like(w), 0.0
        r = w - qy
        z = r * self._over_d
        p, rho = z, _dot(r, z)
        for _ in range(SUPPLY_PRODUCTS):
            if not self._loose * rho > SUPPLY_RTOL * least:
                break
            qp = self._q @ p
            step = rho / _dot(p, qp)
            least += step * rho
            y += step * p
            r -= step * qp
            z = r * self._over_d
            rho, before = _dot(r, z), rho
            p = z + (rho / before) * p
        self._y, self._qy = y, w - r
        return least, self._loose * rho


def _dot(one: Array, other: Array) -> float:
    """Return the inner product without BLAS, because the bits of BLAS depend on its number of threads."""
    return float((one * other).sum())
