"""The cases, one module a theme, in the report's order."""

from ngvisco.verification.cases import (
    comparison,
    dependent,
    estimates,
    flows,
    fronts,
    hyper,
    invariants,
    limits,
    manufactured,
    manufactured_space,
    maxwell,
    rheology,
    robustness,
    shear,
    stability,
    waves,
)

MODULES = (
    stability,
    estimates,
    limits,
    dependent,
    invariants,
    hyper,
    maxwell,
    shear,
    rheology,
    waves,
    fronts,
    flows,
    manufactured,
    manufactured_space,
    robustness,
    comparison,
)
