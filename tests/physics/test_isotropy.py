"""The sampled check that energies do not depend on the observer."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from materials import examples
from support import tensor, tensors, value

import ngvisco as nv
from ngvisco.physics.energy_checks import require_isotropy
from ngvisco.physics.tensors import square, tr
from ngvisco.physics.variables import Distortion, Jacobian, SmallStrain

EXAMPLES = {e.constructor: e.material for e in examples()}


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", EXAMPLES)
def test_every_material_is_the_same_for_every_observer(name, dim):
    report = nv.check_isotropy(EXAMPLES[name], dim=dim)
    assert report.passed and report.samples > 500


@dataclass(frozen=True)
class StrainEnergy(nv.Material):
    """Any function of E: what the package's own materials refuse."""

    energy_parameter = "of"

    of: Callable

    @property
    def variables(self):
        return (SmallStrain(),)

    def energy(self, z):
        return self.of(z["E"])


def test_anisotropic_energy_is_refused_with_a_rotation_that_shows_it():
    material = StrainEnergy(lambda E: square(E) + 0.01 * E[0, 0] * E[0, 0])
    report = nv.check_isotropy(material)
    assert not report.passed
    # the change is real, evaluated without the sampler
    E, Q = report.point["E"], report.rotation
    assert pytest.approx(np.eye(3), abs=1e-14) == Q @ Q.T and np.linalg.det(Q) == pytest.approx(1)

    def phi(E):
        return float(value(material.energy(tensors({"E": E}))))

    assert abs(phi(Q @ E @ Q.T) - phi(E)) == pytest.approx(report.worst, rel=1e-9)
    with pytest.raises(
        nv.ParameterError, match=r"expected an energy that no rotation .* changes: it changes by"
    ):
        require_isotropy(material)
    with pytest.raises(nv.ParameterError, match=r"IsotropicStrainEnergy.strain_energy .* under the rotation"):
        nv.IsotropicStrainEnergy(strain_energy=material.of)


def test_out_of_plane_anisotropy_is_none_in_plane_strain():
    material = StrainEnergy(lambda E: square(E) + E[2, 2] * E[2, 2])
    assert nv.check_isotropy(material, dim=2).passed and not nv.check_isotropy(material, dim=3).passed


def test_energy_of_F_is_asked_for_frame_indifference_only():
    """phi(Q F) = phi(F) holds for |F e_1|^2, which is not isotropic, and not for tr F."""
    e = tensor(np.array([1.0, 0, 0]))
    fibre = nv.CustomMaterial(
        transported=(Distortion(), Jacobian()), stored_energy=lambda F, J: square(F * e) + J * J
    )
    assert nv.check_isotropy(fibre).passed
    with pytest.raises(nv.ParameterError, match=r"CustomMaterial.stored_energy .* under the rotation"):
        nv.CustomMaterial(transported=(Distortion(),), stored_energy=lambda F: tr(F) * tr(F))
