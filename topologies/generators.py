"""Graphs by a rule: one model per kind, which makes the edges for any number of nodes.

    line, ring, star    as their names
    grid                rows of nodes, each with up to four neighbours
    tree                every node has the same number of branches
    random_tree         every node has an edge to an earlier one, drawn uniformly
    random_regular      every node has the same number of neighbours, drawn
    small_world         a ring with further neighbours; some edges are rewired at random (Watts and Strogatz)
    scale_free          every node gets earlier neighbours in proportion to their degrees (Barabási and Albert)
    geometric           nodes in a square, with an edge between two near ones

Nodes are 0 .. n-1. A few NumPy calls make the edges of 10^6 nodes, in less time and memory than igraph takes
(`python -m benchmarks.graphs`). With a graph library, the edges of a file would depend on the release of the library.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from typing import Annotated, Any, ClassVar, Literal, Self, cast

import numpy as np
from pydantic import BeforeValidator, ConfigDict, Discriminator, Field, StrictInt, Tag, model_validator
from pydantic_core import PydanticCustomError

from hedgerow.topologies import budget
from hedgerow.topologies.base import Model, kind_of, number
from hedgerow.topologies.edges import PositiveValue, weights_of
from hedgerow.topologies.graph import Array, Index

# Up to 10^9, because numpy counts in 64 bits and raises OverflowError for more.
Count = Annotated[StrictInt, Field(ge=1, le=10**9)]
Few = Annotated[StrictInt, Field(ge=1, le=1000)]

BYTES_PER_NODE, BYTES_PER_EDGE = 100, 200


def _kind_required(schema: dict[str, Any]) -> None:
    schema["required"] = ["kind", *schema.get("required", ())]


class Generator(Model):
    """A rule that makes a graph."""

    model_config = ConfigDict(json_schema_extra=cast("Callable[[dict[str, Any]], None]", _kind_required))

    LEAST: ClassVar[int] = 1
    """the minimum number of nodes"""

    nodes: Annotated[StrictInt, Field(ge=1, le=10**7)] = Field(
        description="the number of nodes; their ids are 0, 1, 2, …"
    )
    seed: Annotated[StrictInt, Field(ge=0, lt=2**63)] | None = Field(
        None, description="the seed of its draws; the `seed:` of the file if absent"
    )
    max_degree: Count | None = Field(None, description="the maximum number of neighbours of a node")
    weight: PositiveValue = Field(1.0, description="k_e of every edge, above 0; or `{random: [low, high]}`")

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if self.nodes < self.LEAST:
            raise PydanticCustomError("graph", "needs {least} nodes or more", {"least": self.LEAST})
        # Refuse it here: every later check makes the graph.
        if why := budget.excess(self.memory):
            raise PydanticCustomError("budget", "{why}", {"why": why})
        if self.max_degree is not None and self.degree > self.max_degree:
            raise PydanticCustomError(
                "graph",
                "has nodes of {degree} neighbours, more than its `max_degree:`",
                {"degree": self.degree},
            )
        return self

    @property
    def mean_degree_made(self) -> float:
        """Return an upper bound of the mean number of neighbours, before `max_degree` removes any."""
        return 2.0

    @property
    def memory(self) -> int:
        """Return the memory of the graph while it is made and used [bytes], by measurements at 10^6 nodes."""
        return round(self.nodes * (BYTES_PER_NODE + BYTES_PER_EDGE * self.mean_degree_made / 2))

    @property
    def degree(self) -> int:
        """Return the maximum number of neighbours if the rule alone determines it; otherwise 0, and `max_degree` is
        kept.
        """
        return 0

    def edges(self, seed: int) -> Index:
        """Return the edges (i, j), i < j, each once, in ascending order, (E, 2); `seed` is that of the file."""
        own = seed if self.seed is None else self.seed
        stream = np.random.default_rng([own, zlib.crc32(kind_of(self).encode())])  # type: ignore[union-attr]
        key = _keys(self._make(stream), self.nodes)
        # np.unique takes ten times as long, and most rules make each edge once, in order.
        if not (key[1:] > key[:-1]).all():
            key.sort()
            key = key[np.append(True, key[1:] != key[:-1])]
        edges = np.empty((len(key), 2), dtype=np.int64)
        np.divmod(key, self.nodes, out=(edges[:, 0], edges[:, 1]))
        loops = edges[:, 0] == edges[:, 1]
        return edges[~loops] if loops.any() else edges

    def weights(self, seed: int, edges: Index) -> Array | None:
        """Return the weights of the edges from `edges`, (E,), None if all are 1."""
        own = seed if self.seed is None else self.seed
        return weights_of(self.weight, own, range(self.nodes), edges)

    def _make(self, stream: np.random.Generator) -> Index:
        """Return edges in any order, with either end first; `edges` removes loops and repeated edges."""
        raise NotImplementedError

    def _within_degree(self, pairs: Index) -> Index:
        """Return the edges that are among the first `max_degree` of both their ends."""
        if self.max_degree is None:
            return pairs
        ends = pairs.ravel()
        order = ends.argsort(kind="stable")
        first = np.searchsorted(ends[order], np.arange(self.nodes))
        rank = np.empty_like(ends)
        rank[order] = np.arange(len(ends)) - first[ends[order]]
        good: Index = pairs[(rank < self.max_degree).reshape(-1, 2).all(axis=1)]
        return good


def _keys(pairs: Index, n: int) -> Index:
    """Return one number for each edge, low * n + high, (E,)."""
    one, other = pairs[:, 0], pairs[:, 1]
    key: Index = np.minimum(one, other)
    key *= n
    key += np.maximum(one, other)
    return key


def _repeats(key: Index) -> Index:
    """Return the places of numbers that repeat an earlier one, in any order."""
    # np.unique with the places takes several times as long.
    order = key.argsort(kind="stable")
    there = key[order]
    repeats: Index = order[1:][there[1:] == there[:-1]]
    return repeats


def _first_of_each(pairs: Index, n: int) -> Index:
    """Without loops, and of repeated edges the first, in the order given."""
    good = pairs[:, 0] != pairs[:, 1]
    good[_repeats(_keys(pairs, n))] = False
    found: Index = pairs[good]
    return found


class Line(Generator):
    """0 - 1 - 2 - …"""

    kind: Literal["line"] = "line"

    @property
    def degree(self) -> int:
        return min(2, self.nodes - 1)

    def _make(self, _: np.random.Generator) -> Index:
        i = np.arange(self.nodes - 1)
        return np.stack([i, i + 1], axis=1)


class Ring(Generator):
    """A line with its two ends joined."""

    LEAST = 3
    kind: Literal["ring"] = "ring"

    @property
    def degree(self) -> int:
        return 2

    def _make(self, _: np.random.Generator) -> Index:
        i = np.arange(self.nodes)
        return np.stack([i, (i + 1) % self.nodes], axis=1)


class Star(Generator):
    """Node 0 in the middle, and all others around it."""

    kind: Literal["star"] = "star"

    @property
    def degree(self) -> int:
        return self.nodes - 1

    def _make(self, _: np.random.Generator) -> Index:
        i = np.arange(1, self.nodes)
        return np.stack([np.zeros_like(i), i], axis=1)


class Grid(Generator):
    """Rows of nodes, numbered row by row; each node is joined to the next and to the one below."""

    kind: Literal["grid"] = "grid"
    columns: Count | None = Field(None, description="nodes per row; nearly a square if absent")

    @property
    def width(self) -> int:
        """Return the number of nodes in a row; the last row may have fewer."""
        return self.columns or int(np.ceil(np.sqrt(self.nodes)))

    @property
    def mean_degree_made(self) -> float:
        return 4.0

    @property
    def degree(self) -> int:
        rows = -(-self.nodes // self.width)
        return min(2, min(self.width, self.nodes) - 1) + min(2, rows - 1)

    def _make(self, _: np.random.Generator) -> Index:
        i, width = np.arange(self.nodes), self.width
        across, down = i[(i % width < width - 1) & (i + 1 < self.nodes)], i[i + width < self.nodes]
        return np.concatenate([np.stack([across, across + 1], axis=1), np.stack([down, down + width], axis=1)])


class Tree(Generator):
    """Node 0 at the top, and the given number of branches below every node, filled level by level."""

    kind: Literal["tree"] = "tree"
    branches: Count = Field(2, description="nodes below each")

    @property
    def degree(self) -> int:
        return min(self.nodes - 1, self.branches + (self.nodes > self.branches + 1))

    def _make(self, _: np.random.Generator) -> Index:
        i = np.arange(1, self.nodes)
        return np.stack([(i - 1) // self.branches, i], axis=1)


class RandomTree(Generator):
    """Every node has an edge to an earlier one, drawn uniformly among those with fewer than `max_degree` neighbours."""

    kind: Literal["random_tree"] = "random_tree"

    @model_validator(mode="after")
    def _room(self) -> Self:
        if self.max_degree == 1 and self.nodes > 2:
            raise PydanticCustomError("graph", "is no tree with at most one neighbour a node; allow at least 2")
        return self

    def _make(self, stream: np.random.Generator) -> Index:
        i = np.arange(1, self.nodes)
        lots = stream.random(len(i))
        if self.max_degree is None:
            return np.stack([(lots * i).astype(np.int64), i], axis=1)
        room, left, above = [0], [self.max_degree] + [self.max_degree - 1] * len(i), []
        for node, lot in enumerate(lots.tolist(), 1):
            place = int(lot * len(room))
            chosen = room[place]
            above.append(chosen)
            left[chosen] -= 1
            if left[chosen]:
                room.append(node)
            else:  # the new node takes its place, and has room for at least one neighbour
                room[place] = node
        return np.stack([np.array(above, dtype=np.int64), i], axis=1)


class RandomRegular(Generator):
    """Every node has `degree` neighbours, by a random pairing; loops and repetitions are drawn again."""

    kind: Literal["random_regular"] = "random_regular"
    neighbours: Few = Field(3, alias="degree", description="neighbours of every node; nodes times degree must be even")

    @property
    def mean_degree_made(self) -> float:
        return float(self.neighbours)

    @property
    def degree(self) -> int:
        return self.neighbours

    @model_validator(mode="after")
    def _even(self) -> Self:
        if self.neighbours >= self.nodes:
            raise PydanticCustomError("graph", "has fewer nodes than neighbours for each; lower `degree:`")
        if self.nodes * self.neighbours % 2:
            raise PydanticCustomError("graph", "has an odd number of ends of edges; make nodes or degree even")
        return self

    def _make(self, stream: np.random.Generator) -> Index:
        n, d = self.nodes, self.neighbours
        if 2 * d >= n:  # few pairings of a dense graph are free of repetitions; its complement is sparse
            rest = n - 1 - d
            others = self.model_copy(update={"neighbours": rest}).edges(int(stream.integers(2**62))) if rest else None
            apart = np.triu(np.ones((n, n), dtype=bool), 1)
            if others is not None:
                apart[others[:, 0], others[:, 1]] = False
            return np.argwhere(apart)
        pairs = stream.permutation(np.repeat(np.arange(n), d)).reshape(-1, 2)
        while len(bad := self._bad(pairs)):
            # Mix the ends of bad edges with those of as many other edges, drawn at random.
            again = np.unique(np.concatenate([bad, stream.integers(len(pairs), size=len(bad))]))
            pairs[again] = stream.permutation(pairs[again].ravel()).reshape(-1, 2)
        return pairs

    def _bad(self, pairs: Index) -> Index:
        """Return the edges that are loops or repeat another edge."""
        bad = pairs[:, 0] == pairs[:, 1]
        bad[_repeats(_keys(pairs, self.nodes))] = True
        return np.flatnonzero(bad)


class SmallWorld(Generator):
    """A ring with edges from each node to its `degree` nearest; the far end of an edge is drawn again with a
    probability.
    """

    LEAST = 3
    kind: Literal["small_world"] = "small_world"
    nearest: Annotated[StrictInt, Field(ge=2, le=1000, multiple_of=2)] = Field(
        4, alias="degree", description="neighbours of each node on the ring, an even number"
    )
    rewire: Annotated[float, Field(ge=0, le=1), BeforeValidator(number)] = Field(
        0.1, description="the probability that an edge leads to a random node"
    )

    @property
    def mean_degree_made(self) -> float:
        return float(self.nearest)

    @model_validator(mode="after")
    def _sparse(self) -> Self:
        if self.nearest >= self.nodes:
            raise PydanticCustomError("graph", "has fewer nodes than neighbours for each; lower `degree:`")
        return self

    def _make(self, stream: np.random.Generator) -> Index:
        i = np.tile(np.arange(self.nodes), self.nearest // 2)
        far = (i + np.repeat(np.arange(1, self.nearest // 2 + 1), self.nodes)) % self.nodes
        moved = stream.random(len(i)) < self.rewire
        uniform = stream.integers(self.nodes, size=len(i))
        pairs = np.stack([i, np.where(moved, uniform, far)], axis=1)
        # The edges of the ring come first: a drawn edge must not replace them.
        return self._within_degree(_first_of_each(pairs[moved.argsort(kind="stable")], self.nodes))


class ScaleFree(Generator):
    """Every node gets edges to `attach` earlier nodes, drawn in proportion to their numbers of neighbours."""

    LEAST = 2
    kind: Literal["scale_free"] = "scale_free"
    attach: Few = Field(2, description="edges that come with each node")

    @property
    def mean_degree_made(self) -> float:
        return 2.0 * self.attach

    def _make(self, stream: np.random.Generator) -> Index:
        m = self.attach
        new = np.repeat(np.arange(1, self.nodes), m)
        # Place 2k holds the new node of edge k, and place 2k + 1 its other end. That end is the content of an earlier
        # place, drawn uniformly. So a node is drawn in proportion to its number of edges (Batagelj and Brandes).
        drawn = (stream.random(len(new)) * (2 * m) * (new - 1)).astype(np.int64)
        drawn[:m] = -2  # the edges of node 1 have no choice
        while len(open_ := np.flatnonzero(drawn % 2)):
            drawn[open_] = drawn[drawn[open_] // 2]
        other = np.where(drawn >= 0, new[drawn // 2], 0)
        return self._within_degree(_first_of_each(np.stack([other, new], axis=1), self.nodes))


class Geometric(Generator):
    """Nodes at random places in a square, and an edge between two near ones; the distance limit gives `mean_degree` on
    average.
    """

    kind: Literal["geometric"] = "geometric"
    mean_degree: Annotated[float, Field(gt=0, le=1000), BeforeValidator(number)] = Field(
        6.0, description="neighbours of a node in the middle of the square, on average"
    )

    @property
    def mean_degree_made(self) -> float:
        return self.mean_degree

    def _make(self, stream: np.random.Generator) -> Index:
        from scipy.spatial import cKDTree  # noqa: PLC0415 (it takes a while to load)

        places = stream.random((self.nodes, 2))
        radius = float(np.sqrt(self.mean_degree / (np.pi * self.nodes)))
        pairs: Index = cKDTree(places).query_pairs(radius, output_type="ndarray").astype(np.int64).reshape(-1, 2)
        if self.max_degree is None:
            return pairs
        squared = ((places[pairs[:, 0]] - places[pairs[:, 1]]) ** 2).sum(axis=1)
        return self._within_degree(pairs[np.lexsort((pairs[:, 1], pairs[:, 0], squared))])


GENERATORS: dict[str, type[Generator]] = {
    model.model_fields["kind"].default: model
    for model in (Line, Ring, Star, Grid, Tree, RandomTree, RandomRegular, SmallWorld, ScaleFree, Geometric)
}
GraphRule = Annotated[
    Annotated[Line, Tag("line")]
    | Annotated[Ring, Tag("ring")]
    | Annotated[Star, Tag("star")]
    | Annotated[Grid, Tag("grid")]
    | Annotated[Tree, Tag("tree")]
    | Annotated[RandomTree, Tag("random_tree")]
    | Annotated[RandomRegular, Tag("random_regular")]
    | Annotated[SmallWorld, Tag("small_world")]
    | Annotated[ScaleFree, Tag("scale_free")]
    | Annotated[Geometric, Tag("geometric")],
    Discriminator(
        kind_of, custom_error_type="kind", custom_error_message=f"a graph has `kind:` {', '.join(GENERATORS)}"
    ),
]
