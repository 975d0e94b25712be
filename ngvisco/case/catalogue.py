"""The names that a case file may use; one name here adds a material, mechanism, load, wall or geometry.

The keys of a section are the parameters of its dataclass or function, read from the annotations.
"""

from collections.abc import Callable, Mapping
from types import ModuleType
from typing import Any, TypeAlias

import ngvisco.geometries as geometries
from ngvisco.case.laws import custom_material, isotropic_strain_energy
from ngvisco.case.python import python_material
from ngvisco.forms.spaces import Discretisation
from ngvisco.forms.start.initial import Initial
from ngvisco.physics import activation, diffusion, flow_rules, heat, loads, materials, rheology, walls
from ngvisco.physics.regularisation import Regularisation
from ngvisco.run.stepping import TimeSteps
from ngvisco.shapes import shape
from ngvisco.shapes.files import ClosedSurface, Image
from ngvisco.solver.options import NewtonOptions

Kinds: TypeAlias = Mapping[str, Callable[..., Any]]


def _of(module: ModuleType, names: str, **others: Any) -> dict[str, Any]:
    """Classes or functions of a module with these ``names``, and ``others``, by name in alphabetical
    order."""
    return dict(sorted({**{name: getattr(module, name) for name in names.split()}, **others}.items()))


GEOMETRIES: Kinds = _of(
    geometries,
    "annulus bar block_with_hole box channel cylinder disc half_disc sphere spherical_shell structured_box",
    file=geometries.load,
)
MATERIALS: Kinds = _of(
    materials,
    "BarotropicFluid FENEP Gent HardeningElastic IsochoricNeoHookean LinearElastic LogarithmicMooneyRivlin "
    "LogarithmicNeoHookean MooneyRivlin NeoHookean Ogden OldroydB ReferentialMooneyRivlin "
    "ReferentialNeoHookean",
    Custom=custom_material,
    Gas=materials.Thermal,
    IsentropicFluid=materials.BarotropicFluid.from_state_equation,
    IsotropicStrainEnergy=isotropic_strain_energy,
    Python=python_material,
)
WRAPPERS: Kinds = {
    "PerReferentialVolume": materials.PerReferentialVolume,
    "Network": materials.Network,
    "Prony": materials.prony_network,
    "Damaged": materials.Damaged,
    "Yosida": materials.Yosida,
    "WithQuadratic": materials.WithQuadratic,
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
    "Activated": activation.Activated,
    "WLF": activation.WLF,
    "Composite": flow_rules.Composite,
}
"""Flow rules that wrap one or more of the rules above and of the wrappers before them."""
VISCOSITIES: Kinds = {
    "StokesViscosity": rheology.StokesViscosity,
    **_of(rheology, "Carreau Cross LinearViscosity PowerLaw"),
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
SHAPES: Kinds = _of(shape, "Ball Block HalfSpace Polygon Subdomain", ClosedSurface=ClosedSurface, Image=Image)
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
