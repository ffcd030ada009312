"""Upper bounds on the gain of large networks: one multiplier nu for all edges, and closed forms per node.

With the same nu on every edge, the edges meet a node only in psi_i = (B phi)_i. Then the form of `gain_bound` is at
most 0 if there are eta_i with

    p (y - psi + w)^2 - p x^2 + x^2 - g w^2 + tau (z - alpha_low x)(alpha_high x - z) + s (v - low x)(high x - v)
        + nu z psi - eta psi^2 <= 0 at every node, with y = a x or v, and
    sum eta_i (B phi)_i^2 <= (nu - 1) |phi|^2, which is  diag((nu - 1)/eta) - B B' >= 0.

The least eta of a node is a minimum over one number, q = p g/(g - p). The rest is the largest eigenvalue of one sparse
matrix with a row per node, which is convex in (g, nu). docs/guarantee.md has the derivation.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from hedgerow.orchestrator.metrics.gain_plant import PlantModel
from hedgerow.orchestrator.metrics.semidefinite import UNIT, Blocks, Form, NoBoundError, Program
from hedgerow.topologies.graph import Array, Index

NEAR = 1e-5
"""Relative distance from the least g at which the search ends."""
STEPS = 60
"""Number of steps in g, and in nu, at most."""
LARGEST_G = 1e12
ROOM = 1e-6
"""Share of the storage that no multiplier takes, so that a form is less than 0 and not 0."""
DENSE = 300
"""Number of nodes up to which eigenvalues are of a dense matrix."""
FACTORED = 5_000
"""Number of nodes up to which a network with odd cycles is factored; its factors fill up."""
GOLDEN, RATIO = 55, (5**0.5 - 1) / 2
"""Number of steps of the golden section search, and the share of the interval that each keeps."""


@dataclass(frozen=True)
class Nodes:
    """The numbers of all nodes that a bound depends on, (n,) each."""

    middle: Array
    """a, or the middle of the list of a node that jumps"""
    radius: Array
    """0, or half the width of that list"""
    alpha_low: Array
    alpha_high: Array
    low: Array
    """the smallest candidate"""
    high: Array
    """the largest candidate"""

    @classmethod
    def of(cls, plant: PlantModel, jumps: bool) -> Nodes:
        """Return the nodes of a plant; with `jumps` any a within the lists."""
        low, high = plant.lowest, plant.highest
        moves = (low < high) & jumps
        return cls(
            np.where(moves, (low + high) / 2, plant.a),
            np.where(moves, (high - low) / 2, 0.0),
            1 / (1 - low),
            1 / (1 - high),
            low,
            high,
        )

    @property
    def least_g(self) -> float:
        """Return the square of the largest gain of a node without edges, which no g is below."""
        return float((1 / (1 - self.middle - self.radius) ** 2).max())

    def kinds(self) -> list[Index]:
        """Return the nodes that have the same variables."""
        fixed, unmoved = self.alpha_low == self.alpha_high, self.radius == 0
        each = [np.flatnonzero((fixed == f) & (unmoved == u)) for f in (False, True) for u in (False, True)]
        return [of for of in each if len(of)]


@dataclass(frozen=True)
class Least:
    """The least eta of every node for some g and nu, with its derivatives and the multipliers that reach it."""

    g: float
    nu: float
    eta: Array
    by_g: Array
    by_nu: Array
    p: Array
    tau: Array
    s: Array


def least(nodes: Nodes, g: float, nu: float, margin: float = 0.0) -> Least:
    """Return the least eta: the minimum over q of q + m(q)^2 / c(q), by golden section.

    m = max(nu alpha_high/2 - a q, a q - nu alpha_low/2) and c = (1 - radius)^2 q g/(q + g) - 1 - a^2 q > 0, where a is
    the middle of the list.
    """
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return _least(nodes, g, nu, margin)


def _least(nodes: Nodes, g: float, nu: float, margin: float) -> Least:
    a, keep = nodes.middle, (1 - nodes.radius) ** 2
    # c (q + g) is a quadratic in q with two roots above 0, because g > 1/(1 - a - radius)^2.
    half = (keep * g - 1 - a * a * g) / 2
    root = np.sqrt(np.maximum(half * half - a * a * g, 0.0))
    high = np.where(a > 0, (half + root) / np.maximum(a * a, 1e-300), 1e300)
    low = g / (half + root)
    # Beyond these q, both parts of eta grow.
    high = np.maximum(low, np.minimum(high, np.maximum(4 * low, nu * nodes.alpha_high / np.maximum(a, 1e-300)) + 4 * g))

    def value(q: Array) -> Array:
        m = np.maximum(nu * nodes.alpha_high / 2 - a * q, a * q - nu * nodes.alpha_low / 2)
        c = keep * q * g / (q + g) - 1 - a * a * q
        return np.asarray(np.where(c > 0, q + m * m / np.maximum(c, 1e-300), np.inf))

    one, two = high - RATIO * (high - low), low + RATIO * (high - low)
    at_one, at_two = value(one), value(two)
    for _ in range(GOLDEN):
        left = at_one <= at_two
        low, high = np.where(left, low, one), np.where(left, two, high)
        new = np.where(left, high - RATIO * (high - low), low + RATIO * (high - low))
        at_new = value(new)
        one, two = np.where(left, new, two), np.where(left, one, new)
        at_one, at_two = np.where(left, at_new, at_two), np.where(left, at_one, at_new)
    q = np.where(at_one <= at_two, one, two)
    upper, lower = nu * nodes.alpha_high / 2 - a * q, a * q - nu * nodes.alpha_low / 2
    m, c = np.maximum(upper, lower), keep * q * g / (q + g) - 1 - a * a * q
    eta = np.where(c > 0, q + m * m / c, np.inf)
    # Where both are equal, the derivative is that of a mixture of the two, for which q is stationary.
    slope = 1 - (m / c) ** 2 * (keep * (g / (q + g)) ** 2 - a * a)
    share = np.clip((1 + slope * c / (2 * m * a)) / 2, 0.0, 1.0)
    by_nu = m / c * (share * nodes.alpha_high - (1 - share) * nodes.alpha_low)
    by_g = -((m / c) ** 2) * keep * (q / (q + g)) ** 2
    # Of a node that jumps q is q0 s/(s - q0), and p = q0 g/(q0 + g).
    q0 = (1 - nodes.radius) / (1 / q + nodes.radius / g)
    s = q0 * q / (q - q0)
    # The form of the node has no room in x: leave some for a margin in x, z = sigma x, v = a q/q0 x and w = q0/g v.
    sigma, v = (nodes.alpha_low + nodes.alpha_high) / 2, a * q / q0
    room = 4 * margin * (1 + sigma**2 + v**2 * (1 + (q0 / g) ** 2))
    tau = ((1 - ROOM) * c - room) * nu / ((nodes.alpha_high - nodes.alpha_low) * m)
    return Least(g, nu, eta, by_g, by_nu, q0 * g / (q0 + g), tau, s)


class Edges:
    """B B' of a network, and the eigenvalues that decide how much the edges take."""

    def __init__(self, n: int, ends: Index, gains: Array) -> None:
        """Take the ends (E, 2) of the edges, and |B_ie| at both, (E, 2)."""
        import scipy.sparse  # noqa: PLC0415 (half a second, and only large networks need it)

        self.n, self.ends, self.gains = n, ends, gains
        count = len(ends)
        column = np.repeat(np.arange(count), 2)
        values = (gains * [1.0, -1.0]).ravel()
        shape = (n, count)
        self.signed = scipy.sparse.coo_array((values, (ends.ravel(), column)), shape).tocsr()
        self.bipartite = _bipartite(n, ends)
        self._laplacian: Any = (self.signed @ self.signed.T).tocsc()
        self._before: Array | None = None

    def largest(self, eta: Array) -> tuple[float, Array]:
        """Return the largest eigenvalue of sqrt(eta) B B' sqrt(eta), and its unit vector."""
        root = np.sqrt(eta)
        if self.n <= DENSE:
            values, vectors = np.linalg.eigh(root[:, None] * self._laplacian.toarray() * root)
            return float(values[-1]), np.asarray(vectors[:, -1])
        from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigsh  # noqa: PLC0415

        operator = LinearOperator(
            (self.n, self.n), matvec=lambda x: root * (self._laplacian @ (root * x.ravel())), dtype=float
        )
        start = self._before if self._before is not None else np.ones(self.n) * (1 - 2 * (np.arange(self.n) % 2))
        try:
            values, vectors = eigsh(operator, k=1, which="LA", v0=start, tol=1e-6, maxiter=2_000, ncv=24)
        except ArpackNoConvergence:
            raise NoBoundError("the largest eigenvalue was not found") from None
        self._before = vectors[:, 0]
        return float(values[-1]), np.asarray(vectors[:, -1])

    def proved(self, eta: Array, room: float) -> bool:
        """Return True if sum eta_i (B phi)_i^2 <= room |phi|^2 for all phi, rounding included."""
        if not len(self.ends):
            return True
        return self._dominated(eta, room) if self.bipartite or self.n > FACTORED else self._factored(eta, room)

    def _dominated(self, eta: Array, room: float) -> bool:
        """Prove it by weights mu_e > 0: sum over the ends of |B_ie| eta_i sum_f |B_if| mu_f <= room mu_e.

        (sum_e B_ie phi_e)^2 <= (sum |B_ie| mu_e)(sum |B_ie| phi_e^2/mu_e), by Cauchy and Schwarz. The weights solve
        (room/eta - |B B'|) m = 1 and mu = |B|'m, which are positive if it holds. All terms are positive, so each sum
        errs by at most its number of terms.
        """
        from scipy.sparse.linalg import LinearOperator, cg  # noqa: PLC0415

        size: Any = abs(self.signed)
        wide = size @ size.T
        scale = np.sqrt(eta / room)
        operator = LinearOperator(
            (self.n, self.n), matvec=lambda x: x.ravel() - scale * (wide @ (scale * x.ravel())), dtype=float
        )
        found, _ = cg(operator, scale, rtol=1e-9, maxiter=5_000)
        m = scale * found
        if not (np.isfinite(m).all() and (m[np.diff(size.indptr) > 0] > 0).all()):
            return False
        mu = size.T @ m
        taken = size.T @ (eta * (size @ mu))
        terms = int(np.diff(size.indptr).max(initial=0)) + 10
        return bool((taken * (1 + 4 * terms * UNIT) <= room * mu).all())

    def _factored(self, eta: Array, room: float) -> bool:
        """Prove it by a sparse factorisation L U of M = diag(room/eta) - B B', with pivots on the diagonal.

        M + F = L U holds with |F| <= k u |L||U|, where k is 4 n at most. With Delta = diag(U) > 0, L Delta L' >= 0,
        and so M = L Delta L' + L (U - Delta L') - F is at least minus the norms of the last two.
        """
        import scipy.sparse  # noqa: PLC0415
        from scipy.sparse.linalg import splu  # noqa: PLC0415

        matrix = (scipy.sparse.diags_array(room / eta) - self._laplacian).tocsc()
        # A share of the diagonal covers the rounding of the factors, and of the entries: degree + 8 operations each.
        degree = int(np.bincount(self.ends.ravel(), minlength=self.n).max(initial=0))
        size = float(abs(matrix).sum(axis=1).max())
        taken = 1e-9 * size
        shifted = (matrix - taken * scipy.sparse.eye_array(self.n)).tocsc()
        options = {"SymmetricMode": True, "Equil": False}
        try:
            factors = splu(shifted, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
        except RuntimeError:
            return False
        diagonal = factors.U.diagonal()
        if (factors.perm_r != factors.perm_c).any() or not (diagonal > 0).all():
            return False
        lower, upper = abs(factors.L), abs(factors.U)
        uneven = abs(factors.U - scipy.sparse.diags_array(diagonal) @ factors.L.T)
        ones = np.ones(self.n)
        rounding = 4 * self.n * UNIT * max(
            float((lower @ (upper @ ones)).max()), float((upper.T @ (lower.T @ ones)).max())
        )  # fmt: skip
        rest = max(float((lower @ (uneven @ ones)).max()), float((uneven.T @ (lower.T @ ones)).max()))
        rest += self.n * UNIT * float((lower @ (upper @ ones)).max())
        return bool(1.01 * (rounding + rest) + 4 * (degree + 8) * UNIT * size <= taken)


def _bipartite(n: int, ends: Index) -> bool:
    import scipy.sparse  # noqa: PLC0415
    from scipy.sparse.csgraph import connected_components  # noqa: PLC0415

    i, j = ends.T
    # In the double cover an odd cycle joins the two copies of a node.
    rows, columns = np.concatenate([i, i + n]), np.concatenate([j + n, j])
    cover = scipy.sparse.coo_array((np.ones(len(rows)), (rows, columns)), (2 * n, 2 * n))
    _, label = connected_components(cover, directed=False)
    return bool((label[:n] != label[n:]).all())


def search(nodes: Nodes, edges: Edges, until: float) -> tuple[float, float]:
    """Return the least g, nearly, and its nu; raises NoBoundError.

    f(g, nu) = largest eigenvalue - (nu - 1) is convex, and must be 0 at most. Newton's steps in g, each at the best nu,
    come near the least g from below.
    """
    floor = nodes.least_g
    if not len(edges.ends):
        return floor, 2.0
    g, nu, below = 1.5 * floor, 2.0, floor
    for _ in range(STEPS):
        excess, by_g, nu = _best(nodes, edges, g, nu, until)
        if excess > 0:
            below = max(below, g)
        new = g - excess / by_g
        if not np.isfinite(new) or new > LARGEST_G:
            break
        # Left of a value that is too small there is nothing.
        new = new if new > below else (below + g) / 2
        if abs(new - g) <= NEAR * g:
            return float(max(new, g)), nu
        g = new
    raise NoBoundError("the search found no storage of this form that bounds the gain")


def _best(nodes: Nodes, edges: Edges, g: float, nu: float, until: float) -> tuple[float, float, float]:
    """Return the least f over nu, its derivative by g, and the nu: where the derivative by nu changes its sign."""
    low, high, step = 1.0, np.inf, 0.1 * nu
    at_low = at_high = np.nan
    for _ in range(STEPS):
        if time.monotonic() > until:
            raise NoBoundError("the search took too long")
        value, by_g, by_nu = _excess(nodes, edges, g, nu)
        if by_nu < 0:
            low, at_low = nu, by_nu
        else:
            high, at_high = nu, by_nu
        if not np.isfinite(high):
            new, step = nu + step, 3 * step
        elif np.isnan(at_low):
            new = max(low, nu - step) if low < nu - step else (low + nu) / 2
            step *= 3
        else:
            secant = low - at_low * (high - low) / (at_high - at_low)
            edge = 0.05 * (high - low)
            new = min(max(secant, low + edge), high - edge)
        if abs(by_nu) < 1e-3 or high - low < 1e-5 * nu:
            break
        nu = new
    return value, by_g, nu


def _excess(nodes: Nodes, edges: Edges, g: float, nu: float) -> tuple[float, float, float]:
    """Return largest eigenvalue - (nu - 1), and its derivatives by g and nu."""
    found = least(nodes, g, nu)
    value, vector = edges.largest(found.eta)
    weight = value * vector**2 / found.eta
    return value - nu + 1, float(weight @ found.by_g), float(weight @ found.by_nu) - 1


def uniform(plant: PlantModel, jumps: bool, margin: float, until: float) -> tuple[float, Array, float]:
    """Return a proved g, the storage p, and the magnitude; every form is at most -margin |(x, z, w, v, phi)|^2.

    Raises NoBoundError.
    """
    nodes = Nodes.of(plant, jumps)
    edges = Edges(plant.n, plant.edges, plant.b[plant.edges] * plant.root_weights[:, None])
    g, nu = search(nodes, edges, until)
    for more in np.geomspace(NEAR, 0.1, 13):
        found = least(nodes, g * (1 + more), nu, margin)
        if (magnitude := _proof(nodes, edges, found, margin)) is not None:
            return found.g, found.p, magnitude
    raise NoBoundError("the answer of the search is not proved, even with a larger g")


def _proof(nodes: Nodes, edges: Edges, found: Least, margin: float) -> float | None:
    """Return the magnitude of the form if the multipliers prove g, else None."""
    eta, every, psi = np.empty(len(nodes.middle)), [], 0
    for of in nodes.kinds():
        blocks = _blocks(nodes, found, of)
        matrix = blocks.matrices(np.zeros(1))[0]
        psi = blocks.m - 1
        inner, beside = -matrix[:, :psi, :psi] - 2 * margin * np.eye(psi), matrix[:, :psi, psi, None]
        try:
            np.linalg.cholesky(inner)
            needed = matrix[:, psi, psi] + (beside * np.linalg.solve(inner, beside)).sum(axis=(1, 2))
        except np.linalg.LinAlgError:
            return None
        # The least eta that the forms of these nodes allow, and a little for the margin.
        eta[of] = needed * (1 + 1e-9) + 4 * margin
        blocks.entry(-1, psi, psi, -eta[of])
        every.append(blocks)
    magnitude = Program(1, np.empty(0, dtype=np.int64), every).proof(np.zeros(1), margin)
    if magnitude is None or not edges.proved(eta, found.nu - 1 - 2 * margin):
        return None
    # In phi, a row of the form has sum |B_ie| as much as in psi, twice.
    spread = np.bincount(edges.ends.ravel(), edges.gains.ravel(), edges.n).max(initial=1.0)
    return max(magnitude * max(1.0, float(spread)) ** 2, found.g)


def _blocks(nodes: Nodes, found: Least, of: Index) -> Blocks:
    """Return the forms of nodes of one kind in (x, w, [z], [v], psi), without eta."""
    alpha_low, alpha_high = nodes.alpha_low[of], nodes.alpha_high[of]
    has_z, has_v = bool((alpha_low < alpha_high).all()), bool((nodes.radius[of] > 0).all())
    m = 3 + has_z + has_v
    blocks = Blocks(m, len(of))
    x, w, psi = (Form((k,), (1.0,)) for k in (0, 1, m - 1))
    z = Form((2,), (1.0,)) if has_z else Form((0,), (alpha_low,))
    v = Form((2 + has_z,), (1.0,)) if has_v else Form((0,), (nodes.middle[of],))
    after = Form((*v.at, *w.at, *psi.at), (*v.coefficient, 1.0, -1.0))
    blocks.add(-1, after, after, found.p[of])
    blocks.add(-1, x, x, 1.0 - found.p[of])
    blocks.add(-1, w, w, -found.g)
    blocks.add(-1, z, psi, found.nu)
    if has_z:
        blocks.sector(-1, z, x, alpha_low, alpha_high, found.tau[of])
    if has_v:
        blocks.sector(-1, v, x, nodes.low[of], nodes.high[of], found.s[of])
    return blocks
