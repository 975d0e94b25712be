"""The verification cases: the report's themes in their order, and functions that find and select cases."""

from collections.abc import Sequence
from importlib import import_module
from pkgutil import iter_modules

from ngvisco.errors import UnknownNameError
from tests.verification.bounds import VerificationError
from tests.verification.case import Case

THEMES = (
    "Stability for every step length",
    "Momentum",
    "Limits",
    "The whole scheme",
    "Dependent variables",
    "Mass, density and Jacobian",
    "The role of hyperviscosity",
    "Exact solutions: shear and relaxation",
    "Exact solutions: rheology",
    "Exact solutions: flow rules",
    "Creeping flow at finite strain",
    "Exact solutions: waves",
    "Exact solutions: layers and fronts",
    "Exact solutions: rotation, Couette flow",
    "Bodies and their interfaces",
    "Heat",
    "Convergence: manufactured solutions",
    "Creep with a gradient",
    "Time schemes",
    "Robustness of the scheme",
    "Three dimensions",
    "The models against each other",
    "Sensitivities",
)
"""Headings of the report in their order; under a heading cases are sorted by modules."""


def all_cases() -> tuple[Case, ...]:
    """Every case, in the order of the report.  Raises VerificationError if two cases share a name."""
    modules = (import_module(f"{__name__}.{module.name}") for module in iter_modules(__path__))
    found = sorted((c for module in modules for c in module.CASES), key=lambda c: THEMES.index(c.theme))
    names = [case.name for case in found]
    double = sorted({name for name in names if names.count(name) > 1})
    if double:
        raise VerificationError(f"two cases are called {', '.join(double)}")
    return tuple(found)


def select(cases: Sequence[Case], names: Sequence[str] = (), reduced: bool = False) -> tuple[Case, ...]:
    """Select all cases, the reduced set, or the cases with the given names or beginnings of names.

    Raises UnknownNameError, with the nearest name, for a name that no case has.
    """
    for name in names:
        if not any(_matches(case, name) for case in cases):
            raise UnknownNameError("verification case", name, [case.name for case in cases])
    chosen = [case for case in cases if not names or any(_matches(case, name) for name in names)]
    return tuple(case for case in chosen if case.reduced or not reduced)


def _matches(case: Case, name: str) -> bool:
    """Whether a case has the name, or a name that begins with it and a dash, as ``limit-tau`` selects
    ``limit-tau-finite``."""
    return case.name == name or case.name.startswith(f"{name}-")
