"""The H-infinity facts of a network whose a is known: condition (3), Q, gamma*, and the contraction rho.

With S = I - A, the gains b_i and the weighted graph Laplacian L, Q = S^2 + diag(b) L diag(b). If all gains are b and
all weights 1, that is the paper's S^2 + b^2 L. See docs/theory.md for what each number promises.

In all functions `b` is one gain or that of each node, (n,), and a degree is d_i, the sum of the node's edge weights.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING, cast

import numpy as np

from hedgerow.topologies.errors import HedgerowError
from hedgerow.topologies.graph import Array, Gain, Graph, Index, Mask

if TYPE_CHECKING:
    import scipy.sparse

_DENSE = 400
"""Up to this many nodes dense linear algebra is quicker than loading the sparse one."""
FACTORED = 5_000
"""Up to this many nodes Q is factored, which is exact; beyond, its factors may not fit into memory."""
EIGENVALUE_RTOL = 1e-3
"""Beyond: how near the residual says that lambda_min(Q) is at least, relative to it; gamma* is twice as near."""
SUPPLY_RTOL = 1e-6
"""Beyond: how near w'Q^(-1)w is known, relative to it."""
SUPPLY_PRODUCTS = 1_000
"""Beyond: products with Q at most for that; if they are not enough, it is known less well, and how well is known."""


def allowed_interval(b: float, degree: float) -> tuple[float, float] | None:
    """The open interval of a that satisfies condition (3), a^2 + 2 b_i^2 d_i < a; None when there is none."""
    discriminant = 1 - 8 * b * b * degree
    if discriminant <= 0:
        return None
    s = math.sqrt(discriminant)
    return (1 - s) / 2, (1 + s) / 2


def satisfies_condition(a: float, b: float, degree: float) -> bool:
    """Condition (3) itself: a^2 + 2 b_i^2 d_i < a."""
    return 0 < a < 1 and a * a + 2 * b * b * degree < a


def allowed_intervals(b: Gain, degree: Index | Array) -> tuple[Array, Array]:
    """The same of many nodes, low and high ends; NaN where there is none."""
    with np.errstate(invalid="ignore"):
        s = np.sqrt(1 - 8 * b * b * degree)
    s[s <= 0] = np.nan
    return (1 - s) / 2, (1 + s) / 2


def condition_holds(a: Array, b: Gain, degree: Index | Array) -> Mask:
    """Condition (3) of many nodes; a: (n,) or (M, n)."""
    return np.asarray((a > 0) & (a < 1) & (a * a + 2 * b * b * degree < a))


def contraction(a: Array, candidates: Array) -> float:
    """The rho = max_j max(a_j, max_m a_jm - a_j) of |x(t+1)| <= rho |x(t)| + |w(t)|, whatever is estimated.

    The norm is |x| = sum |x_i| / b_i. a: (n,); candidates: (M, n), NaN where a list has fewer.
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
    """Q_ij = -b_i k_ij b_j of each incidence, (2E,), or the one number that all are."""
    beside = -b[graph.node] * b[graph.neighbour] if isinstance(b, np.ndarray) else -b * b
    return beside if graph.weight is None else beside * graph.weight


def smallest_eigenpair(a: Array, b: Gain, graph: Graph) -> tuple[float, Array]:
    """lambda_min(Q) and its unit eigenvector, signed so that its sum is not negative."""
    if graph.n <= _DENSE:
        try:
            values, vectors = np.linalg.eigh(_q_dense(a, b, graph))
        except np.linalg.LinAlgError as error:  # of numbers that no file of ours holds
            raise HedgerowError(f"gamma*: Q has no eigenvalues that can be computed ({error}); mend a and b") from None
        value, vector = float(values[0]), vectors[:, 0]
    elif graph.n > FACTORED:
        value, vector = _lobpcg(a, b, graph)
    else:
        from scipy.sparse.linalg import eigsh  # noqa: PLC0415

        values, vectors = eigsh(_q(a, b, graph), k=1, sigma=0, v0=np.ones(graph.n))
        value, vector = float(values[0]), vectors[:, 0]
    return value, -vector if vector.sum() < 0 else vector


def _lobpcg(a: Array, b: Gain, graph: Graph) -> tuple[float, Array]:
    """By products with Q alone, from a positive vector: of a matrix like Q, the one that is sought has one sign."""
    from scipy.sparse.linalg import LinearOperator, lobpcg  # noqa: PLC0415

    q = _q(a, b, graph).tocsr()
    diagonal = q.diagonal()
    divided = LinearOperator(q.shape, matvec=lambda x: x.ravel() / diagonal, matmat=lambda x: x / diagonal[:, None])
    # Q - (1 - a)^2 is positive semidefinite: no eigenvalue is below this one.
    residual = EIGENVALUE_RTOL * float(((1 - a) ** 2).min())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # that it did not come so near, which is looked at below
        values, vectors = lobpcg(q, (1 / diagonal)[:, None], M=divided, tol=residual, maxiter=2000, largest=False)
    value, vector = float(values[0]), vectors[:, 0] / np.linalg.norm(vectors[:, 0])
    if (found := float(np.linalg.norm(q @ vector - value * vector))) > 10 * residual:
        raise HedgerowError(f"gamma*: lambda_min(Q) = {value:g} is known to {found:.1g} only; report this network")
    return value, vector


def gamma_star(a: Array, b: Gain, graph: Graph) -> float:
    """gamma* = lambda_min(Q)^(-1/2), the optimal gain for the edge cost and known a; never the adaptive law's."""
    return 1 / math.sqrt(smallest_eigenpair(a, b, graph)[0])


def q_solver(a: Array, b: Gain, graph: Graph) -> Callable[[Array], Array]:
    """A function w -> Q^(-1) w, for w of shape (n,) or (n, k), by the factors of Q."""
    if graph.n <= _DENSE:
        inverse = np.linalg.inv(_q_dense(a, b, graph))
        return lambda w: inverse @ w
    from scipy.sparse.linalg import splu  # noqa: PLC0415

    return cast("Callable[[Array], Array]", splu(_q(a, b, graph)).solve)


def supply_rate(a: Array, b: Gain, graph: Graph) -> Callable[[Array], tuple[float, float]]:
    """A function w -> w'Q^(-1)w, (n,), as two numbers: not less than the first, nor than that by more than the second.

    Of up to FACTORED nodes the second is 0; of more it is SUPPLY_RTOL of the first, proved, not estimated.
    """
    if graph.n > FACTORED:
        return _Supply(a, b, graph)
    solve = q_solver(a, b, graph)
    return lambda w: (float((w * solve(w)).sum()), 0.0)


class _Supply:
    """By conjugate gradients, preconditioned by Q's diagonal D, from the best multiple of the last solution.

    For every y, w'Q^(-1)w = 2 y'w - y'Qy + r'Q^(-1)r with r = w - Qy; and since Q - (1 - a)^2 is positive semidefinite,
    0 <= r'Q^(-1)r <= sum (r_i / (1 - a_i))^2 <= max_i (D_i / (1 - a_i)^2) r'D^(-1)r, which the method knows anyway.
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
    """Not BLAS's, whose bits depend on how many threads it has."""
    return float((one * other).sum())
