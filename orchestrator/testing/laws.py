"""The contract test of laws, for the tests of their authors."""

from __future__ import annotations

from typing import Any

from hedgerow.agents.contract import Trial
from hedgerow.agents.contract import check_law as _check
from hedgerow.agents.loading import law_class
from hedgerow.orchestrator.ground.assignment import candidates_of, law_seed
from hedgerow.orchestrator.ground.laws import with_defaults
from hedgerow.topologies.law_choice import LawChoice
from hedgerow.topologies.named import Named, resolved


def check_law(law: type[Any] | str, network: Named | None = None, /, **parameters: Any) -> None:
    """Raise LawError if a law breaks the contract of laws; the message names the line, the method and a fix.

    `law` is a class, or the text of a choice such as `mylaws:RLS(p0=10)`. `network` gives the candidates of the test;
    by default the test uses five nodes. Raises UserError for a wrong parameter. Every run makes this test before it
    begins.
    """
    name = law if isinstance(law, str) else f"{law.__module__}:{law.__qualname__}"
    given, tested = parameters, law
    if isinstance(tested, str):
        choice = LawChoice.parse(tested)
        given, tested = {**choice.parameters, **parameters}, law_class(choice.name)
    trial, seed = None, 0
    if network is not None:
        topology = resolved(network)
        drawn, seed = topology.network, law_seed(topology)
        trial = Trial.of(drawn.ids, drawn.b, candidates_of(topology), drawn.graph.weight is not None)
    label = name.partition("(")[0]
    _check(tested, trial, with_defaults(tested, given, f"law {label}"), label, seed)
