"""The distributed minimax adaptive controller, equations (6) and (7) of the paper.

    ahat_i = first candidate that minimises J_i,m,    J_i,m(t + 1) = J_i,m(t) + (a_m x_i(t) + b f_i(t) - x_i(t + 1))^2

Renganathan, Rantzer and Kjellqvist, "Distributed Adaptive Control", arXiv:2210.00081, equations (6) and (7). It is
right if the disturbance is white, or small beside the state. It fails if the disturbance is correlated with the state.
Under a sinusoid or a constant from x(0) = 0, the least-squares estimate is biased, and J prefers the wrong model
forever. Its class is `hedgerow.agents.law.Minimax`.
"""

from __future__ import annotations

from hedgerow.agents.law import Minimax

__all__ = ["Minimax"]
