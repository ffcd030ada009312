"""The laws of the project, by name. Each is a small file, loaded at its first use."""

from __future__ import annotations

from importlib import import_module

from hedgerow.agents.law import Law

LAWS: dict[str, str] = {
    "minimax": "Minimax",
    "hinf": "HInf",
    "nominal": "Nominal",
    "forgetting": "Forgetting",
    "hysteresis": "Hysteresis",
    "rls": "RLS",
    "bayes": "Bayes",
    "thompson": "Thompson",
    "set-membership": "SetMembership",
    "centred": "Centred",
    "notch": "Notch",
    "either": "Either",
    "robust": "Robust",
}
"""By name in a topology file: the class, in the module of that name."""


def law_of_name(name: str) -> type[Law]:
    """Return the class of a law of the project; raise KeyError for an unknown name."""
    attribute = LAWS[name]
    law: type[Law] = getattr(import_module(f"{__name__}.{name.replace('-', '_')}"), attribute)
    return law
