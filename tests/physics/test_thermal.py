"""Materials with a temperature: its laws against thermodynamics that was not written here."""

import numpy as np
import pytest
from ngsolve import CF, Id

import ngvisco as nv
from ngvisco.physics.material import cauchy_stress, conjugates
from ngvisco.physics.materials.thermal import entropy_in, rest_stress_and_modulus
from ngvisco.physics.signals import sampled

COLD = {
    "B and J": nv.IsochoricNeoHookean(K_e=20.0, G_e=1.0, elastic_state="B"),
    "H, A and K": nv.LogarithmicNeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1),
    "E": nv.LinearElastic(K_e=10.0, G_e=5.0),
    "per volume": nv.PerReferentialVolume(material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1)),
}


def state(material, J, theta):
    F = J ** (1 / 3) * Id(3)
    z = {v.name: v.from_distortion(F) for v in material.variables}
    entropy = material.start(CF(theta), z["A"])
    return z | {"s": CF(float(sampled(entropy)[0]))}  # a number: derivatives by A see none of its A


def temperature(material, J, theta):
    """theta by the energy's derivative at the entropy that the start makes of theta."""
    z = state(material, J, theta)
    return float(sampled(conjugates(material, z)["s"])[0]) / entropy_in(material).unit


def pressure(material, J, theta):
    z = state(material, J, theta)
    return -float(sampled(cauchy_stress(material, z)[0, 0])[0])


@pytest.mark.parametrize("heat", [{"expansion": 0.01}, {"gruneisen": 1.5}, {}])
@pytest.mark.parametrize("cold", COLD)
def test_energy_gives_the_temperature_pressure_and_heat_capacity_that_are_asked_for(cold, heat):
    material = nv.Thermal(material=COLD[cold], c=3.0, theta_R=300.0, entropy_unit=2.0, **heat)
    assert temperature(material, 1.2, 350.0) == pytest.approx(350.0, rel=1e-13)
    hot, at_rest = pressure(material, 1.2, 350.0), pressure(material, 1.2, 300.0)
    K = rest_stress_and_modulus(COLD[cold])[1]
    expected = {"expansion": K * 0.01 * 50, "gruneisen": 1.5 * 3.0 * 50 / 1.2}
    assert hot - at_rest == pytest.approx(sum(expected[name] for name in heat), rel=1e-10, abs=1e-9)
    energies = [float(sampled(material.energy(state(material, 1.2, 350.0 + d)))[0]) for d in (1, -1)]
    assert 1.2 * (energies[0] - energies[1]) / 2 == pytest.approx(3.0, rel=1e-9)  # of a reference volume


def test_an_ideal_gas_has_its_laws():
    """p V = (gamma - 1) U, adiabats p V^gamma = constant, and the isentropic bulk modulus gamma p."""
    gas = nv.Thermal(c=862.0, gruneisen=0.4, theta_R=293.0, rho_R=1.2)
    assert pressure(gas, 2.0, 400.0) == pytest.approx(0.4 * 862 * 400 / 2, rel=1e-12)
    F = 2 ** (1 / 3) * Id(3)
    z = {v.name: v.from_distortion(F) for v in gas.variables}  # S = 0: on the adiabat of theta_R at J = 1
    T = cauchy_stress(gas, z)[0, 0]
    assert -sampled(T)[0] == pytest.approx(0.4 * 862 * 293 * 2**-1.4, rel=1e-12)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("heat", [{"expansion": 0.1}, {"gruneisen": 1.5}])
@pytest.mark.parametrize("cold", COLD)
def test_energy_is_jointly_convex(cold, heat, dim):
    material = nv.Thermal(material=COLD[cold], c=3.0, theta_R=1.0, **heat)
    assert nv.check_convexity(material, dim=dim).passed


def test_convexity_check_sees_an_energy_that_is_not_convex_in_s():
    good = nv.Thermal(material=COLD["E"], c=3.0, theta_R=1.0)
    bad = nv.CustomMaterial(
        transported=good.variables, stored_energy=lambda **z: good.energy(z) - 3.0 * z["s"] * z["s"]
    )
    with pytest.warns(nv.ConvexityWarning, match="s"):
        assert not nv.check_convexity(bad, dim=2).passed


def test_numbers_of_the_entropy_do_not_depend_on_what_it_counts_in():
    slopes = []
    for unit in (2.0, 3.0):
        material = nv.Thermal(material=COLD["E"], c=3.0, theta_R=300.0, expansion=0.01, entropy_unit=unit)
        z = state(material, 1.1, 310.0)
        slopes.append([float(sampled(z["s"])[0]) * unit, temperature(material, 1.1, 310.0)])
    assert np.allclose(*slopes, rtol=1e-13)
