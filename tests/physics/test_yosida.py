"""The Yosida approximation as a function of states: definition, bounds, derivatives, limit."""

import numpy as np
import pytest
from materials import examples
from ngsolve import Det, log
from support import each_once

import ngvisco as nv
from ngvisco.errors import NgviscoError
from ngvisco.physics.energy_checks import StateSampling
from ngvisco.physics.pointwise import respond
from ngvisco.physics.response import Response
from ngvisco.physics.tensors import square
from ngvisco.physics.variables import Distortion, Jacobian

EXAMPLES = {example.constructor: example.material for example in examples()}
NEO_HOOKEAN = EXAMPLES["NeoHookean"]


def states(material: nv.Material, dim: int, spread: float = 0.4) -> np.ndarray:
    """Random states with J > 0."""
    sampling = StateSampling(material, dim, spread, np.random.default_rng(1))
    return sampling.changed(sampling.fitting())[:40]


def approximation(material: nv.Material, eps: float, z: np.ndarray, dim: int) -> Response:
    response = respond(nv.Yosida(material=material, eps=eps), dim)(z)
    assert response.failure is None
    return response


@pytest.mark.parametrize(("name", "dim"), each_once(EXAMPLES, [2, 3]))
def test_the_approximation_satisfies_its_definition(name: str, dim: int) -> None:
    """y = z - eps phi_eps' has phi'(y) = phi_eps'(z) and the energy phi(y) + |z - y|^2/(2 eps)."""
    material, eps = EXAMPLES[name], 0.02
    z = states(material, dim)
    found = approximation(material, eps, z, dim)
    y = z - eps * found.slope
    at_y = respond(material, dim)(y)
    scale = np.abs(at_y.slope).max()
    assert np.abs(at_y.slope - found.slope).max() < 1e-12 * scale
    energy = at_y.energy + ((z - y) ** 2).sum(axis=1) / (2 * eps)
    np.testing.assert_allclose(found.energy, energy, rtol=1e-12)


@pytest.mark.parametrize("name", EXAMPLES)
def test_derivatives_are_those_of_the_energy_and_bounded(name: str) -> None:
    """Derivatives agree with differences; 0 <= phi_eps'' <= 1/eps; phi_eps <= phi; Bregman distances are >=
    0."""
    material, eps = EXAMPLES[name], 0.1
    z = states(material, 2)
    direction = np.random.default_rng(2).standard_normal(z.shape)
    found = approximation(material, eps, z, 2)
    h = 1e-4
    shifted = {s: approximation(material, eps, z + s * h * direction, 2) for s in (-2, -1, 1, 2)}
    energy = (8 * (shifted[1].energy - shifted[-1].energy) - shifted[2].energy + shifted[-2].energy) / (
        12 * h
    )
    slope = (8 * (shifted[1].slope - shifted[-1].slope) - shifted[2].slope + shifted[-2].slope) / (12 * h)
    assert np.abs(energy - (found.slope * direction).sum(axis=1)).max() < 1e-9 * np.abs(found.slope).max()
    product = np.einsum("nij,nj->ni", found.hessian, direction)
    assert np.abs(slope - product).max() < 1e-9 * np.abs(found.hessian).max()
    curvature = np.linalg.eigvalsh(found.hessian)
    rounding = 1e-10 * curvature.max()
    assert curvature.min() >= -rounding and curvature.max() <= (1 + 1e-12) / eps
    assert (found.energy <= respond(material, 2)(z).energy).all()
    other = found.energy[::-1], z[::-1], found.slope[::-1]
    bregman = other[0] - found.energy - (found.slope * (other[1] - z)).sum(axis=1)
    assert (bregman >= -1e-12 * np.abs(found.energy).max()).all()
    jump = np.linalg.norm(found.slope - other[2], axis=1)
    assert (jump <= np.linalg.norm(z - other[1], axis=1) / eps).all()


@pytest.mark.parametrize("name", ["NeoHookean", "ReferentialMooneyRivlin", "CustomMaterial"])
def test_the_approximation_is_of_first_order_in_eps(name: str) -> None:
    """phi - phi_eps = eps/2 |phi'|^2 + O(eps^2), and the slope differs by O(eps)."""
    material = EXAMPLES[name]
    z = states(material, 3, 0.2)
    exact = respond(material, 3)(z)
    remainders, gaps = [], []
    for eps in (1e-5, 5e-6):
        found = approximation(material, eps, z, 3)
        first = 0.5 * eps * (exact.slope**2).sum(axis=1)
        remainders.append(np.abs(exact.energy - found.energy - first).max())
        gaps.append(np.abs(exact.slope - found.slope).max())
    assert remainders[1] < 1e-2 * first.max()
    assert remainders[0] / remainders[1] == pytest.approx(4, abs=0.2)
    assert gaps[0] / gaps[1] == pytest.approx(2, abs=0.1)


@pytest.mark.parametrize("eps", [1e-14, 1e-3, 1.0, 1e8])
def test_quadratic_energies_have_a_closed_form(eps: float) -> None:
    """phi = K z^2/2 becomes K/(1 + eps K) z^2/2, to rounding for any eps; here K is 3 K_e and 2 G_e."""
    moduli = {"K_e": 10.0, "G_e": 5.0}
    z = states(nv.LinearElastic(**moduli), 3)
    found = approximation(nv.LinearElastic(**moduli), eps, z, 3)
    softer = {"K_e": 10 / (1 + 30 * eps), "G_e": 5 / (1 + 10 * eps)}
    expected = respond(nv.LinearElastic(**softer), 3)(z)
    np.testing.assert_allclose(found.energy, expected.energy, rtol=1e-13)
    assert np.abs(found.slope - expected.slope).max() < 1e-14 * np.abs(expected.slope).max()
    assert np.abs(found.hessian - expected.hessian).max() < 1e-13 * np.abs(expected.hessian).max()


@pytest.mark.parametrize("J", [-50.0, -1.0, 0.0, 1e-9, 1.0, 1e6])
@pytest.mark.parametrize(
    "name", ["NeoHookean", "ReferentialNeoHookean", "LogarithmicNeoHookean", "BarotropicFluid"]
)
def test_singular_energies_become_finite_everywhere(name: str, J: float) -> None:
    """For any J or A, also a negative one, the minimiser has a positive J or A."""
    material, eps = EXAMPLES[name], 0.05
    z = states(material, 3)
    where = {"LogarithmicNeoHookean": 9}.get(name, z.shape[1] - 1)
    z[:, where] = J
    found = approximation(material, eps, z, 3)
    assert (z - eps * found.slope)[:, where].min() > -1e-14 * abs(J)
    assert found.finite.all()


def test_a_users_energy_has_a_minimiser_for_a_state_outside_its_domain() -> None:
    """The energy has log Det F alone, without J: for det F < 0 the energy is not defined, and the iteration
    starts from rest."""
    material = nv.CustomMaterial(
        transported=(Distortion(),), stored_energy=lambda F: 10 * square(F) - 0.1 * log(Det(F))
    )
    z = np.diag([-0.1, 1.0, 1.0]).reshape(1, 9)
    found = approximation(material, 0.01, z, 3)
    y = z - 0.01 * found.slope
    assert np.linalg.det(y.reshape(3, 3)) > 0


def test_an_approximation_without_a_minimum_reports_the_reason() -> None:
    material = nv.CustomMaterial(transported=(Jacobian(),), stored_energy=lambda J: -10 * (J - 1) * (J - 1))
    response = respond(nv.Yosida(material=material, eps=1.0), 2)(np.array([[1.2]]))
    assert response.failure is not None and "eps = 1" in response.failure
    assert "no minimum at" in response.failure and "not convex" in response.failure
    assert np.isnan(response.energy).all()
    one = approximation(material, 0.01, np.array([[1.2]]), 2)
    assert np.isfinite(one.energy).all()  # |z|^2/(2 eps) makes the sum convex
    bounded = EXAMPLES['BarotropicFluid(form="A")']  # A^gamma is finite at A = 0, and has no value for A < 0
    response = respond(nv.Yosida(material=bounded, eps=1.0), 2)(np.array([[-1.0], [1.0]]))
    assert response.failure is not None and "no minimiser at 1 points" in response.failure
    assert np.isnan(response.energy[0]) and np.isfinite(response.energy[1])
    response = respond(nv.Yosida(material=bounded, eps=1.0), 2)(np.array([[np.nan], [1.0]]))
    assert response.failure is not None and "not finite at 1 points" in response.failure


def test_an_approximated_energy_as_an_expression_is_refused() -> None:
    with pytest.raises(NgviscoError, match=r"is not an expression; use ngvisco.physics.pointwise.respond"):
        nv.Yosida(material=NEO_HOOKEAN, eps=1.0).energy({})
