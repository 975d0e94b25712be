"""Energies by arrays: derivatives, and what is not supported; every material is in ``test_split_agrees``."""

import ngsolve
import numpy as np
import pytest

from ngvisco.physics.arrays import Array, derivatives
from ngvisco.physics.materials.custom import CustomMaterial
from ngvisco.physics.materials.hyperelastic import NeoHookean
from ngvisco.physics.pointwise import CHUNK, array_slope
from ngvisco.physics.tensors import dev, if_positive, inner, log, sph, square, sym, tensor_space, tr
from ngvisco.physics.variables import Distortion, Jacobian, SmallStrain


def states(material, dim, count=7):
    """Components near rest."""
    rng = np.random.default_rng(1)
    z = 0.1 * rng.standard_normal((material.states(dim).size, count))
    for variable, where in zip(material.variables, material.states(dim).slices.values(), strict=True):
        space = tensor_space(variable.kind, dim)
        rest = np.ones(1) if space.is_scalar else space.columns.T @ np.eye(3).ravel()
        z[where] += (0.0 if isinstance(variable, SmallStrain) else 1.0) * rest[:, None]
    return z


def test_many_points_are_taken_in_pieces():
    material = NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1)
    slope, z = array_slope(material, 2), states(material, 2, count=2 * CHUNK + 3)
    whole = slope(z)
    assert (whole[:, :5] == slope(z[:, :5])).all()
    assert whole[:, -1] == pytest.approx(slope(z[:, -1:])[:, 0], rel=1e-14)


def test_every_operation_against_differences():
    rng = np.random.default_rng(2)
    A, B, s = rng.standard_normal((3, 3, 4)), rng.standard_normal((3, 3, 4)), 1 + rng.random(4)

    def energy(A, B, s):
        products = inner(A * B, sym(B)) + tr(A * A.trans) / s + 2 / s - square(dev(A)) * s**1.5
        return products + log(s) * (3 - square(sph(B))) + if_positive(s - 1.5, s * s, 0.5 * s) - (1 - s)

    arguments = [Array(each) for each in (A, B, s)]
    found = derivatives(energy(*arguments), arguments)
    for i, (values, derivative) in enumerate(zip((A, B, s), found, strict=True)):
        for index in np.ndindex(values.shape[:-1]):
            quotient = []
            for sign in (1, -1):
                moved = [each.copy() for each in (A, B, s)]
                moved[i][index] += sign * 1e-6
                quotient.append(energy(*map(Array, moved)).value)
            assert derivative[index] == pytest.approx((quotient[0] - quotient[1]) / 2e-6, rel=1e-7, abs=1e-7)


def test_an_energy_that_needs_ngsolve_is_left_to_it():
    material = CustomMaterial(
        transported=(Distortion(), Jacobian()),
        stored_energy=lambda F, J: 3 * square(F) + 10 * (J - 1) * (J - 1) - 6 * ngsolve.log(J),
    )
    assert array_slope(material, 2) is None


@pytest.mark.parametrize(
    "wrong",
    [
        lambda T, s: T + s,
        lambda T, s: T / T,
        lambda T, s: T**2.0,
        lambda T, s: s**s,
        lambda T, s: T.log(),
        lambda T, s: s.trans,
        lambda T, s: T.InnerProduct(s),
        lambda T, s: s * "2",
    ],
)
def test_meaningless_operations_are_type_errors(wrong):
    with pytest.raises(TypeError):
        wrong(Array(np.ones((3, 3, 2))), Array(np.ones(2)))


@pytest.mark.parametrize("exponent", [0, 0.5, 1, 1.5, 2])
def test_powers_of_zero_are_numbers(exponent):
    """A law may have a value where it has no derivative: at rest."""
    with np.errstate(all="raise"):
        assert (Array(np.zeros(2)) ** exponent).value == pytest.approx(0.0**exponent, abs=0)
