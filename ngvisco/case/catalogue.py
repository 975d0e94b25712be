"""What a case file can name.  A new material, mechanism, load, wall or geometry is one line here.

Keys of a section are the parameters of the dataclass or function, read from its annotations.
"""

import importlib
from collections.abc import Callable, Mapping
from typing import Any

from ngvisco.case.laws import custom_material, isotropic_strain_energy
from ngvisco.forms.spaces import Discretisation
from ngvisco.forms.start.initial import Initial
from ngvisco.physics.activation import Activated, ActivatedViscosity
from ngvisco.physics.flow_rules import Composite, Creep, DruckerPrager, Eyring, Norton, Perzyna
from ngvisco.physics.heat import Heat
from ngvisco.physics.materials import (
    FENEP,
    BarotropicFluid,
    Damaged,
    HardeningElastic,
    IsochoricNeoHookean,
    LinearElastic,
    LogarithmicMooneyRivlin,
    LogarithmicNeoHookean,
    MooneyRivlin,
    NeoHookean,
    OldroydB,
    PerReferentialVolume,
    ReferentialMooneyRivlin,
    ReferentialNeoHookean,
    Thermal,
    WithQuadratic,
    Yosida,
)
from ngvisco.physics.model import BodyForce, CentralGravity, Gravity
from ngvisco.physics.regularisation import Regularisation
from ngvisco.physics.rheology import HyperViscosity, LinearViscosity, StokesViscosity
from ngvisco.physics.viscosities import Carreau, Cross, PowerLaw
from ngvisco.physics.walls import Inflow, NavierFriction, NoSlip, Open, PrescribedTangential, Slip, Traction
from ngvisco.run.time_steps import TimeSteps
from ngvisco.shapes.image import Image
from ngvisco.shapes.solids import Ball, Block, HalfSpace, Polygon, Subdomain
from ngvisco.shapes.surface import ClosedSurface
from ngvisco.solver.options import NewtonOptions


def _geometries() -> dict[str, Callable[..., Any]]:
    # importable only after ngvisco itself has found them beside it
    geometries = importlib.import_module("ngvisco.geometries")
    return {
        "annulus": geometries.annulus,
        "bar": geometries.bar,
        "block_with_hole": geometries.block_with_hole,
        "box": geometries.box,
        "channel": geometries.channel,
        "cylinder": geometries.cylinder,
        "disc": geometries.disc,
        "file": geometries.load,
        "sphere": geometries.sphere,
        "spherical_shell": geometries.spherical_shell,
        "structured_box": geometries.structured_box,
    }


GEOMETRIES = _geometries()

MATERIALS: dict[str, Callable[..., Any]] = {
    "BarotropicFluid": BarotropicFluid,
    "Custom": custom_material,
    "FENEP": FENEP,
    "HardeningElastic": HardeningElastic,
    "IsentropicFluid": BarotropicFluid.from_state_equation,
    "IsochoricNeoHookean": IsochoricNeoHookean,
    "IsotropicStrainEnergy": isotropic_strain_energy,
    "LinearElastic": LinearElastic,
    "LogarithmicMooneyRivlin": LogarithmicMooneyRivlin,
    "LogarithmicNeoHookean": LogarithmicNeoHookean,
    "MooneyRivlin": MooneyRivlin,
    "NeoHookean": NeoHookean,
    "OldroydB": OldroydB,
    "ReferentialMooneyRivlin": ReferentialMooneyRivlin,
    "ReferentialNeoHookean": ReferentialNeoHookean,
}

WRAPPERS: dict[str, Callable[..., Any]] = {
    "PerReferentialVolume": PerReferentialVolume,
    "Damaged": Damaged,
    "Thermal": Thermal,
    "Yosida": Yosida,
    "WithQuadratic": WithQuadratic,
}
"""Materials of another one, [material.material]: of those above, and of wrappers before them here."""

ALL_MATERIALS = {**MATERIALS, **WRAPPERS}

MECHANISMS: dict[str, type] = {
    "hyperviscosity": HyperViscosity,
    "heat": Heat,
    "regularisation": Regularisation,
}

FLOW_RULES: dict[str, type] = {
    "Linear": Creep,
    "DruckerPrager": DruckerPrager,
    "Eyring": Eyring,
    "Norton": Norton,
    "Perzyna": Perzyna,
}
"""What [rheology.creep] can be; the first where its kind is not said."""

FLOW_RULE_WRAPPERS: dict[str, type] = {"Activated": Activated, "Composite": Composite}
"""Rules of other ones: of those above, and of wrappers before them here."""

VISCOSITIES: dict[str, type] = {
    "StokesViscosity": StokesViscosity,
    "Carreau": Carreau,
    "Cross": Cross,
    "LinearViscosity": LinearViscosity,
    "PowerLaw": PowerLaw,
}
"""What [rheology.viscosity] can be; the first where its kind is not said."""

VISCOSITY_WRAPPERS: dict[str, type] = {"ActivatedViscosity": ActivatedViscosity}

CREEPS, ALL_VISCOSITIES = {**FLOW_RULES, **FLOW_RULE_WRAPPERS}, {**VISCOSITIES, **VISCOSITY_WRAPPERS}

LOADS: dict[str, type] = {"BodyForce": BodyForce, "CentralGravity": CentralGravity, "Gravity": Gravity}

WALLS: dict[str, type] = {
    "Inflow": Inflow,
    "NavierFriction": NavierFriction,
    "NoSlip": NoSlip,
    "Open": Open,
    "PrescribedTangential": PrescribedTangential,
    "Slip": Slip,
    "Traction": Traction,
}
"""Walls that a case does not name are Slip."""

SHAPES: dict[str, Callable[..., Any]] = {
    "Ball": Ball,
    "Block": Block,
    "ClosedSurface": ClosedSurface,
    "HalfSpace": HalfSpace,
    "Image": Image,
    "Polygon": Polygon,
    "Subdomain": Subdomain,
}
"""Where bodies are at the start, besides conditions on x, y, z."""

SECTIONS: dict[str, type] = {
    "discretisation": Discretisation,
    "initial": Initial,
    "solver": NewtonOptions,
    "time": TimeSteps,
}

TABLES: tuple[Mapping[str, Callable[..., Any]], ...] = (
    GEOMETRIES,
    ALL_MATERIALS,
    MECHANISMS,
    CREEPS,
    ALL_VISCOSITIES,
    LOADS,
    WALLS,
    SHAPES,
    SECTIONS,
)
