"""Models whose interfaces between bodies can be sharpened."""

from ngsolve import ET, VOL, Mesh

from ngvisco.errors import ParameterError
from ngvisco.forms.spaces import Discretisation
from ngvisco.physics.mixture import Mixture
from ngvisco.physics.model import Model

SHARP = "Discretisation.sharp"
"""Name of the option in messages."""


def check_sharp(model: Model, mesh: Mesh, discretisation: Discretisation) -> None:
    """Raise ParameterError, with the reason, for a model whose interfaces cannot be sharpened."""
    material = model.material
    if not isinstance(material, Mixture):
        raise ParameterError(SHARP, True, False, " for a model without bodies")
    for is_wrong, reason in (
        (discretisation.m != 1, " unless m = 1"),
        (
            len({float(body.density or 0.0) for body in material.bodies}) > 1,
            " for bodies of different densities, since sharpening would change the momentum",
        ),
        (not material.has_one_volume, " for different volumetric energies, since energy would rise"),
        (not all(psi.is_linear for psi in material.energies.values()), " unless energies are linear in B"),
        (material.heat is not None, " for bodies with heat"),
        (bool(material.plastic_contents), " for bodies that harden"),
        ({cell.type for cell in mesh.Elements(VOL)} - {ET.TRIG, ET.TET}, " on quadrilaterals"),
    ):
        if is_wrong:
            raise ParameterError(SHARP, True, False, reason)
    if discretisation.outlines and mesh.dim == 3:
        raise ParameterError("Discretisation.outlines", True, False, " in three dimensions")
