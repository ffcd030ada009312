"""Not allowed: each node acts on what the other nodes of its process are doing."""

from hedgerow.agents.law import Array, Minimax


class Gossip(Minimax):
    def act(self, x: Array) -> Array:
        apart: Array = x - x.mean()
        return super().act(x) + 0.01 * apart
