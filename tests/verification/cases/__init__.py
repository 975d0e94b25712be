"""The cases: modules in the report's order, each with the themes of its cases."""

from collections.abc import Sequence
from importlib import import_module

from ngvisco.errors import UnknownNameError
from tests.verification.case import Case, VerificationError

MODULES = (
    "stability",
    "limits",
    "whole_scheme",
    "sequence",
    "dependent",
    "invariants",
    "hyper",
    "maxwell",
    "shear",
    "rheology",
    "conformation",
    "cylinder",
    "flow_rules",
    "viscoplastic",
    "shear_band",
    "necking",
    "winding",
    "waves",
    "foundation",
    "riemann",
    "sphere_modes",
    "refinement",
    "fronts",
    "pulse",
    "couette",
    "interfaces",
    "soft_disc",
    "collision",
    "topography",
    "unloaded",
    "jelly",
    "cantilever",
    "free_bar",
    "slab",
    "sloshing",
    "rayleigh_taylor",
    "rayleigh_taylor_viscous",
    "heat",
    "heat_flow",
    "heat_onset",
    "heat_riemann",
    "heat_manufactured",
    "manufactured",
    "creep_gradient",
    "schemes",
    "robustness",
    "positivity",
    "in_space",
    "comparison",
)


def all_cases() -> tuple[Case, ...]:
    """Every case, in the order of the report.  Raises VerificationError if two cases share a name."""
    found = tuple(case for module in MODULES for case in import_module(f"{__name__}.{module}").CASES)
    names = [case.name for case in found]
    double = sorted({name for name in names if names.count(name) > 1})
    if double:
        raise VerificationError(f"two cases are called {', '.join(double)}")
    return found


def select(cases: Sequence[Case], names: Sequence[str] = (), reduced: bool = False) -> tuple[Case, ...]:
    """The cases asked for: all of them, the reduced set, or those with the given names or name beginnings.

    Raises UnknownNameError for a name that no case has, with the nearest one.
    """
    for name in names:
        if not any(_matches(case, name) for case in cases):
            raise UnknownNameError("verification case", name, [case.name for case in cases])
    chosen = [case for case in cases if not names or any(_matches(case, name) for name in names)]
    return tuple(case for case in chosen if case.reduced or not reduced)


def _matches(case: Case, name: str) -> bool:
    """``limit-tau`` stands for ``limit-tau-linearised`` and ``limit-tau-finite``."""
    return case.name == name or case.name.startswith(f"{name}-")
