"""Checks by samples that an energy is a function of the state alone, and does not depend on the observer."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from materials import examples
from ngsolve import CF, L2, GridFunction, Parameter, specialcf, x
from support import each_once, tensor, tensors, value

import ngvisco as nv
from ngvisco.geometries import box
from ngvisco.physics.energy_checks import check_energy, require_isotropy
from ngvisco.physics.tensors import square, tr
from ngvisco.physics.variables import Distortion, Jacobian, SmallStrain

EXAMPLES = {e.constructor: e.material for e in examples()}


@pytest.mark.parametrize(("name", "dim"), each_once(EXAMPLES, [2, 3]))
def test_every_material_is_independent_of_the_observer(name, dim):
    report = nv.check_isotropy(EXAMPLES[name], dim=dim)
    assert report.passed and report.samples > 500


@dataclass(frozen=True)
class StrainEnergy(nv.Material):
    """A material with any function of E, which the package's own materials refuse."""

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
    # the energy changes also if it is evaluated without the sampler
    E, Q = report.point["E"], report.rotation
    assert pytest.approx(np.eye(3), abs=1e-14) == Q @ Q.T and np.linalg.det(Q) == pytest.approx(1)

    def phi(E):
        return float(value(material.energy(tensors({"E": E}))))

    assert abs(phi(Q @ E @ Q.T) - phi(E)) == pytest.approx(report.worst, rel=1e-9)
    with pytest.raises(
        nv.ParameterError,
        match=r"expected an energy that is the same for all observers, but the given energy changes by",
    ):
        require_isotropy(material)
    with pytest.raises(nv.ParameterError, match=r"IsotropicStrainEnergy.strain_energy .* under the rotation"):
        nv.IsotropicStrainEnergy(strain_energy=material.of)


def test_out_of_plane_anisotropy_is_accepted_in_plane_strain():
    material = StrainEnergy(lambda E: square(E) + E[2, 2] * E[2, 2])
    assert nv.check_isotropy(material, dim=2).passed and not nv.check_isotropy(material, dim=3).passed


def test_an_energy_of_F_has_to_be_frame_indifferent_only():
    """phi(Q F) = phi(F) holds for |F e_1|^2, which is not isotropic, and does not hold for tr F."""
    e = tensor(np.array([1.0, 0, 0]))
    fibre = nv.CustomMaterial(
        transported=(Distortion(), Jacobian()), stored_energy=lambda F, J: square(F * e) + J * J
    )
    assert nv.check_isotropy(fibre).passed
    with pytest.raises(nv.ParameterError, match=r"CustomMaterial.stored_energy .* under the rotation"):
        nv.CustomMaterial(transported=(Distortion(),), stored_energy=lambda F: tr(F) * tr(F))


MESH = box((1, 1), 0.5)
FIELD = GridFunction(L2(MESH, order=0))
FACTOR = Parameter(2.0)


def plain(F, J):
    return 5 * square(F) / J ** (2 / 3) + 10 * (J - 1) * (J - 1) + 0.1 / J


def material(energy):
    return nv.CustomMaterial(transported=(Distortion(), Jacobian()), stored_energy=energy)


WRONG = {
    "position": (lambda F, J: (1 + x) * plain(F, J), "reads the position"),
    "grid function": (lambda F, J: (1 + FIELD) * plain(F, J), "reads a grid function"),
    "mesh size": (lambda F, J: specialcf.mesh_size * plain(F, J), "reads the size of the cells"),
    "time": (lambda F, J: (1 + nv.time) * plain(F, J), "reads the time"),
    "region": (lambda F, J: MESH.MaterialCF({"default": 2.0}) * plain(F, J), "reads the region"),
    "normal": (lambda F, J: specialcf.normal(2)[0] * plain(F, J), "reads the direction of a facet"),
    "tensor": (lambda F, J: F, r"a real scalar, not an array of shape \(3, 3\)"),
    "vector": (lambda F, J: CF((J, J)), r"not an array of shape \(2,\)"),
    "complex": (lambda F, J: 1j * J, "not a complex number"),
    "None": (lambda F, J: None, "returns a coefficient function, not None"),
    "float": (lambda F, J: 1.0, "returns a coefficient function, not 1.0"),
    "NumPy's float": (lambda F, J: np.float64(2), "returns a coefficient function, not"),
    "arguments": (
        lambda F: square(F),
        "the given function raises TypeError: .*unexpected keyword argument 'J'",
    ),
    "attribute": (lambda F, J: F.nothing, "the given function raises AttributeError"),
}


@pytest.mark.parametrize("name", WRONG)
def test_an_energy_that_depends_on_more_than_the_state_is_refused_with_the_reason(name):
    energy, reason = WRONG[name]
    with pytest.raises(nv.ParameterError, match=reason) as error:
        material(energy)
    assert error.value.field == "CustomMaterial.stored_energy" and error.value.value is energy
    with pytest.raises(nv.ParameterError, match="strain_energy") as error:
        nv.IsotropicStrainEnergy(strain_energy=lambda E: energy(F=E, J=1 + E[0, 0]))


def test_energies_that_depend_on_the_state_alone_are_accepted():
    material(plain)
    material(lambda F, J: FACTOR * plain(F, J))  # FACTOR is a constant
    nv.IsotropicStrainEnergy(strain_energy=square)
    for wrapped in (nv.Yosida(material=material(plain), eps=1e-3),):
        nv.Model(material=nv.WithQuadratic(material=wrapped, delta=1e-3))


def test_the_model_checks_a_user_s_material_class():
    class Placed(nv.Material):
        @property
        def variables(self):
            return (Distortion(), Jacobian())

        def energy(self, z):
            return x * plain(**z)

    with pytest.raises(nv.ParameterError, match=r"Placed.energy = .*reads the position"):
        nv.Model(material=Placed())


def test_the_checks_restore_the_time():
    nv.time.Set(0.7)
    try:
        with pytest.raises(nv.ParameterError):
            check_energy(material(lambda F, J: nv.time * plain(F, J)))
        assert nv.time.Get() == 0.7
    finally:
        nv.time.Set(0.0)


@pytest.mark.parametrize("check", [nv.check_convexity, nv.check_isotropy])
def test_a_dimension_may_be_an_integer_of_numpy(check):
    material = nv.LinearElastic(K_e=2.0, G_e=1.0)
    assert check(material, dim=np.array(2)) == check(material, dim=2)
