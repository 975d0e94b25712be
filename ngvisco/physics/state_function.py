"""A stored energy must be a function of the state alone: what else one may read by mistake is refused.

The ledger's conjugates are derivatives by the state.  An energy that also depends on the place, on the time,
on a grid function or on the mesh has a rate that no term of the equations holds.
"""

import numpy as np
from ngsolve import CF, CoefficientFunction

from ngvisco.errors import NgviscoError, ParameterError
from ngvisco.physics.material import Material
from ngvisco.physics.materials.heterogeneous import Heterogeneous
from ngvisco.physics.signals import one_value, reads_time, sampled
from ngvisco.physics.variables import Values

_OTHERS = {
    ("coordinate",): "the position",
    ("GridFunction",): "a grid function",
    ("MeshSize",): "the size of the cells",
    ("normal vector", "tangential vector", "Curvature"): "the direction of a facet",
    ("DomainWise", "RegionCF"): "the region of the mesh",
    ("Voxel",): "values on a grid",
    ("ReferenceCoordinate", "Jacobian"): "the map of the cells",
    ("ProxyFunction",): "a trial or test function",
}
"""What NGSolve calls the leaves of an expression, and what they are."""


def check_energy(material: Material) -> None:
    """Raise ParameterError unless ``material.energy`` is a scalar function of the variables' values alone."""
    inner = getattr(material, "material", None)
    if isinstance(inner, Material) and not isinstance(material, Heterogeneous):
        # a wrapper's energy is made of that of another material
        check_energy(inner)
        return
    owner = f"{type(material).__name__}.{material.energy_parameter}"
    function = getattr(material, material.energy_parameter)
    names = ", ".join(v.name for v in material.variables)
    F = CF((1.2, 0.1, 0, -0.2, 0.9, 0, 0, 0, 1.05), dims=(3, 3))  # a state without symmetries
    z = {v.name: v.from_distortion(F).MakeVariable() for v in material.variables}
    phi = _evaluated(material, z, owner, function, names)
    text = str(phi)
    for leaves, what in _OTHERS.items():
        if any(leaf in text for leaf in leaves):
            raise ParameterError(owner, function, f"a function of {names} alone; it reads {what}")
    if reads_time(phi):
        raise ParameterError(owner, function, f"a function of {names} alone; it reads the time")
    if _is_constant(phi, z):
        expected = f"an energy that changes with {names}: this one is a constant, without any stress"
        raise ParameterError(owner, function, expected)
    if not one_value(sampled(phi)):
        expected = f"a function of {names} alone; it differs from place to place at one state"
        raise ParameterError(owner, function, expected)


def _is_constant(phi: CoefficientFunction, z: Values) -> bool:
    """Whether no variable's conjugate differs from zero, but for what rounding leaves of sums that vanish."""
    slopes = [abs(part) for variable in z.values() for part in np.ravel(sampled(phi.Diff(variable)))]
    size = max(np.abs(sampled(phi)))
    return bool(max(slopes) <= 1e-14 * size)


def _evaluated(
    material: Material, z: Values, owner: str, function: object, names: str
) -> CoefficientFunction:
    try:
        phi = material.energy(z)
    except NgviscoError:
        raise
    except Exception as error:  # whatever a function of the user raises
        expected = f"a function of {names}; it raises {type(error).__name__}: {error}"
        raise ParameterError(owner, function, expected) from error
    if not isinstance(phi, CoefficientFunction):
        expected = f"a function of {names} that returns a coefficient function, not {phi!r:.60}"
        raise ParameterError(owner, function, expected)
    if phi.dim != 1 or phi.is_complex:
        what = "a complex number" if phi.is_complex else f"an array of shape {tuple(phi.dims)}"
        raise ParameterError(owner, function, f"a function of {names} that returns a real scalar, not {what}")
    return phi
