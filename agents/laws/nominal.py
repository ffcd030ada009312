"""The H-infinity controller of a nominal model.

    u_i = b x_i / (a_nominal,i - 1)

The paper's comparison, its figure 5: certainty equivalence without adaptation. The operator gives every node its
nominal value as the only candidate. It is right if the nominal value is near the truth. It never learns otherwise.
"""

from __future__ import annotations

from typing import ClassVar

from hedgerow.agents.law import Minimax


class Nominal(Minimax):
    """The paper's law with the nominal value as the only candidate of each node."""

    equation: ClassVar[str] = "ahat = the nominal value of the file"
