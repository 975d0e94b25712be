"""The names that a case file may use; a new material, mechanism, load, wall or geometry is one name here.

The keys of a section are the parameters of its dataclass or function, read from the annotations.
"""

from collections.abc import Callable, Mapping
from types import ModuleType
from typing import Any, TypeAlias

import ngvisco.geometries as geometries
from ngvisco.case.laws import custom_material, isotropic_strain_energy
from ngvisco.case.python import KIND, python_material
from ngvisco.forms.spaces import Discretisation
from ngvisco.forms.start.initial import Initial
from ngvisco.physics import activation, diffusion, flow_rules, heat, loads, materials, rheology, walls
from ngvisco.physics.regularisation import Regularisation
from ngvisco.run.stepping import TimeSteps
from ngvisco.shapes import shape
from ngvisco.shapes.files import ClosedSurface, Image
from ngvisco.solver.options import NewtonOptions

Kinds: TypeAlias = Mapping[str, Callable[..., Any]]


def _of(module: ModuleType, names: str) -> dict[str, Any]:
    """Classes or functions of a module by their names."""
    return {name: getattr(module, name) for name in names.split()}


GEOMETRIES: Kinds = {
    **_of(geometries, "annulus bar block_with_hole box channel cylinder disc"),
    "file": geometries.load,
    **_of(geometries, "half_disc sphere spherical_shell structured_box"),
}
MATERIALS: Kinds = {
    "BarotropicFluid": materials.BarotropicFluid,
    "Custom": custom_material,
    "FENEP": materials.FENEP,
    "Gas": materials.Thermal,
    "Gent": materials.Gent,
    "HardeningElastic": materials.HardeningElastic,
    "IsentropicFluid": materials.BarotropicFluid.from_state_equation,
    "IsochoricNeoHookean": materials.IsochoricNeoHookean,
    "IsotropicStrainEnergy": isotropic_strain_energy,
    **_of(materials, "LinearElastic LogarithmicMooneyRivlin LogarithmicNeoHookean MooneyRivlin NeoHookean"),
    **_of(materials, "Ogden OldroydB"),
    KIND: python_material,
    **_of(materials, "ReferentialMooneyRivlin ReferentialNeoHookean"),
}
WRAPPERS: Kinds = {
    "PerReferentialVolume": materials.PerReferentialVolume,
    "Network": materials.Network,
    "Prony": materials.prony_network,
    **_of(materials, "Damaged Yosida WithQuadratic"),
}
"""Materials that wrap another material, [material.material], or several, [material.branches.NAME.material]. A
wrapper may wrap the materials above and the wrappers before it."""
MECHANISMS: Kinds = {
    "diffusion": diffusion.Diffusion,
    "hyperviscosity": rheology.HyperViscosity,
    "heat": heat.Heat,
    "regularisation": Regularisation,
}
FLOW_RULES: Kinds = {
    "Linear": flow_rules.Creep,
    **_of(flow_rules, "DruckerPrager Eyring Giesekus Norton PTT Perzyna"),
}
"""Kinds of [rheology.creep]; the first is the default."""
FLOW_RULE_WRAPPERS: Kinds = {
    **_of(activation, "Activated WLF"),
    "Composite": flow_rules.Composite,
}
"""Flow rules that wrap other rules: the rules above and the wrappers before."""
VISCOSITIES: Kinds = {
    "StokesViscosity": rheology.StokesViscosity,
    **_of(rheology, "Carreau Cross"),
    "LinearViscosity": rheology.LinearViscosity,
    "PowerLaw": rheology.PowerLaw,
}
"""Kinds of [rheology.viscosity]; the first is the default."""
VISCOSITY_WRAPPERS: Kinds = _of(activation, "ActivatedViscosity")
CREEPS: Kinds = {**FLOW_RULES, **FLOW_RULE_WRAPPERS}
ALL_VISCOSITIES: Kinds = {**VISCOSITIES, **VISCOSITY_WRAPPERS}
LOADS: Kinds = _of(loads, "BodyForce CentralGravity Gravity")
WALLS: Kinds = _of(
    walls, "Inflow NavierFriction NoSlip Open PrescribedNormal PrescribedTangential Slip Traction"
)
"""Kinds of [walls.NAME]; a wall without a table is Slip."""
SHAPES: Kinds = {
    **_of(shape, "Ball Block"),
    "ClosedSurface": ClosedSurface,
    "HalfSpace": shape.HalfSpace,
    "Image": Image,
    **_of(shape, "Polygon Subdomain"),
}
"""Kinds of shapes for bodies' initial places, besides conditions on x, y, z."""
SECTIONS: Kinds = {
    "discretisation": Discretisation,
    "initial": Initial,
    "solver": NewtonOptions,
    "time": TimeSteps,
}
KINDS: Kinds = {
    **{**GEOMETRIES, **MATERIALS, **WRAPPERS, **MECHANISMS, **CREEPS, **ALL_VISCOSITIES},
    **{**LOADS, **WALLS, **SHAPES, **SECTIONS},
}
"""All kinds of the catalogue by name."""
