"""An energy is a function of the state alone: what else it reads, raises or returns is refused by name."""

import numpy as np
import pytest
from ngsolve import CF, L2, GridFunction, Parameter, specialcf, x

import ngvisco as nv
from ngvisco.geometries import box
from ngvisco.physics.energy_checks import check_energy
from ngvisco.physics.tensors import square
from ngvisco.physics.variables import Distortion, Jacobian

MESH = box((1, 1), 0.5)
FIELD = GridFunction(L2(MESH, order=0))
FACTOR = Parameter(2.0)


def plain(F, J):
    return 5 * square(F) / J ** (2 / 3) + 10 * (J - 1) * (J - 1) + 0.1 / J


def material(energy):
    return nv.CustomMaterial(transported=(Distortion(), Jacobian()), stored_energy=energy)


WRONG = {
    "position": (lambda F, J: (1 + x) * plain(F, J), "it reads the position"),
    "grid function": (lambda F, J: (1 + FIELD) * plain(F, J), "it reads a grid function"),
    "mesh size": (lambda F, J: specialcf.mesh_size * plain(F, J), "it reads the size of the cells"),
    "time": (lambda F, J: (1 + nv.time) * plain(F, J), "it reads the time"),
    "region": (lambda F, J: MESH.MaterialCF({"default": 2.0}) * plain(F, J), "it reads the region"),
    "normal": (lambda F, J: specialcf.normal(2)[0] * plain(F, J), "it reads the direction of a facet"),
    "tensor": (lambda F, J: F, r"a real scalar, not an array of shape \(3, 3\)"),
    "vector": (lambda F, J: CF((J, J)), r"not an array of shape \(2,\)"),
    "complex": (lambda F, J: 1j * J, "not a complex number"),
    "None": (lambda F, J: None, "returns a coefficient function, not None"),
    "float": (lambda F, J: 1.0, "returns a coefficient function, not 1.0"),
    "NumPy's float": (lambda F, J: np.float64(2), "returns a coefficient function, not"),
    "arguments": (lambda F: square(F), "it raises TypeError: .*unexpected keyword argument 'J'"),
    "attribute": (lambda F, J: F.nothing, "it raises AttributeError"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_no_function_of_the_state_is_refused_with_the_reason(name):
    energy, reason = WRONG[name]
    with pytest.raises(nv.ParameterError, match=reason) as error:
        material(energy)
    assert error.value.field == "CustomMaterial.stored_energy" and error.value.value is energy
    with pytest.raises(nv.ParameterError, match="strain_energy") as error:
        nv.IsotropicStrainEnergy(strain_energy=lambda E: energy(F=E, J=1 + E[0, 0]))


def test_functions_of_the_state_pass():
    material(plain)
    material(lambda F, J: FACTOR * plain(F, J))  # a number that stays as it is
    nv.IsotropicStrainEnergy(strain_energy=square)
    for wrapped in (nv.Yosida(material=material(plain), eps=1e-3),):
        nv.Model(material=nv.WithQuadratic(material=wrapped, delta=1e-3))


def test_a_material_class_of_ones_own_is_looked_at_by_the_model():
    class Placed(nv.Material):
        @property
        def variables(self):
            return (Distortion(), Jacobian())

        def energy(self, z):
            return x * plain(**z)

    with pytest.raises(nv.ParameterError, match=r"Placed.energy = .*it reads the position"):
        nv.Model(material=Placed())


def test_the_time_is_left_as_it_was():
    nv.time.Set(0.7)
    try:
        with pytest.raises(nv.ParameterError):
            check_energy(material(lambda F, J: nv.time * plain(F, J)))
        assert nv.time.Get() == 0.7
    finally:
        nv.time.Set(0.0)
