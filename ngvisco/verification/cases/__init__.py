"""The cases, one module a theme, in the report's order."""

from ngvisco.verification.cases import (
    comparison,
    dependent,
    estimates,
    flows,
    hyper,
    invariants,
    limits,
    manufactured,
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
    shear,
    rheology,
    waves,
    flows,
    manufactured,
    robustness,
    comparison,
)
