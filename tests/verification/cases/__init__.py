"""The cases: the report's themes in its order, each with its modules."""

from dataclasses import replace
from importlib import import_module

THEMES = {
    "Stability for every step length": "stability",
    "Limits": "limits",
    "The whole scheme": "whole_scheme sequence",
    "Dependent variables": "dependent",
    "Mass, density and Jacobian": "invariants",
    "The role of hyperviscosity": "hyper",
    "Exact solutions: shear and relaxation": "maxwell shear",
    "Exact solutions: rheology": "rheology conformation cylinder",
    "Exact solutions: flow rules": "flow_rules viscoplastic shear_band necking",
    "Creeping flow at finite strain": "winding",
    "Exact solutions: waves": "waves foundation riemann sphere_modes refinement",
    "Exact solutions: layers and fronts": "fronts pulse",
    "Exact solutions: rotation, Couette flow": "couette",
    "Bodies and their interfaces": "interfaces soft_disc collision topography unloaded jelly cantilever "
    "free_bar slab sloshing rayleigh_taylor rayleigh_taylor_viscous",
    "Heat": "heat heat_flow heat_onset heat_riemann heat_manufactured",
    "Convergence: manufactured solutions": "manufactured",
    "Creep with a gradient": "creep_gradient",
    "Time schemes": "schemes",
    "Robustness of the scheme": "robustness positivity",
    "Three dimensions": "in_space",
    "The models against each other": "comparison",
}
CASES = tuple(
    replace(case, theme=theme)
    for theme, modules in THEMES.items()
    for module in modules.split()
    for case in import_module(f"{__name__}.{module}").CASES
)
