"""Materials with a temperature, alone and as bodies: laws against independent formulas of thermodynamics."""

import math

import ngsolve
import numpy as np
import pytest
from ngsolve import CF, Id, x
from scipy.optimize import minimize
from support import tensor, tensors, value, values

import ngvisco as nv
from ngvisco.geometries import box
from ngvisco.physics.arrays import Array
from ngvisco.physics.material import cauchy_stress, conjugates
from ngvisco.physics.materials.thermal import entropy_in, rest_stress_and_modulus
from ngvisco.physics.pointwise import respond
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
    # s is a number, so that derivatives by A are taken at constant s
    return z | {"s": CF(float(sampled(entropy)[0]))}


def temperature(material, J, theta):
    """The temperature from the energy's derivative, at the entropy that the start computes from
    ``theta``."""
    z = state(material, J, theta)
    return float(sampled(conjugates(material, z)["s"])[0]) / entropy_in(material).unit


def pressure(material, J, theta):
    z = state(material, J, theta)
    return -float(sampled(cauchy_stress(material, z)[0, 0])[0])


@pytest.mark.parametrize("heat", [{"expansion": 0.01}, {"gruneisen": 1.5}, {}])
@pytest.mark.parametrize("cold", COLD)
def test_a_thermal_energy_has_the_given_temperature_pressure_and_heat_capacity(cold, heat):
    material = nv.Thermal(material=COLD[cold], c=3.0, theta_R=300.0, entropy_unit=2.0, **heat)
    assert temperature(material, 1.2, 350.0) == pytest.approx(350.0, rel=1e-13)
    hot, at_rest = pressure(material, 1.2, 350.0), pressure(material, 1.2, 300.0)
    K = rest_stress_and_modulus(COLD[cold])[1]
    expected = {"expansion": K * 0.01 * 50, "gruneisen": 1.5 * 3.0 * 50 / 1.2}
    assert hot - at_rest == pytest.approx(sum(expected[name] for name in heat), rel=1e-10, abs=1e-9)
    energies = [float(sampled(material.energy(state(material, 1.2, 350.0 + d)))[0]) for d in (1, -1)]
    # J phi is the energy per reference volume
    assert 1.2 * (energies[0] - energies[1]) / 2 == pytest.approx(3.0, rel=1e-9)


def test_an_ideal_gas_satisfies_the_gas_laws():
    """p V = (gamma - 1) U, adiabats have constant p V^gamma, and the isentropic bulk modulus is gamma p."""
    gas = nv.Thermal(c=862.0, gruneisen=0.4, theta_R=293.0, rho_R=1.2)
    assert pressure(gas, 2.0, 400.0) == pytest.approx(0.4 * 862 * 400 / 2, rel=1e-12)
    F = 2 ** (1 / 3) * Id(3)
    z = {v.name: v.from_distortion(F) for v in gas.variables}  # S = 0: on the adiabat of theta_R at J = 1
    T = cauchy_stress(gas, z)[0, 0]
    assert -sampled(T)[0] == pytest.approx(0.4 * 862 * 293 * 2**-1.4, rel=1e-12)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("heat", [{"expansion": 0.1}, {"gruneisen": 1.5}])
@pytest.mark.parametrize("cold", COLD)
def test_energy_with_heat_is_jointly_convex(cold, heat, dim):
    material = nv.Thermal(material=COLD[cold], c=3.0, theta_R=1.0, **heat)
    assert nv.check_convexity(material, dim=dim).passed


ONE_COLD = nv.ReferentialNeoHookean(K_e=10.0, G_e=1.0)
STIFF = nv.ReferentialNeoHookean(K_e=40.0, G_e=1.0)
GAS = {"material": None, "c": 3.0, "gruneisen": 0.4}
PAIRS = {
    "no expansion": ({"c": 3.0}, {"c": 1.0, "theta_R": 2.0}),
    "one thermal pressure": ({"c": 3.0, "expansion": 0.1}, {"c": 1.0, "expansion": 0.1}),
    "two expansions": ({"c": 3.0, "expansion": 0.1}, {"c": 1.0, "expansion": 0.3}),
    "other stiffness": ({"c": 3.0, "expansion": 0.1}, {"c": 1.0, "material": STIFF}),
    "as of gases": ({"c": 3.0, "gruneisen": 0.4}, {"c": 1.0, "expansion": 0.1}),
    "two gases": (GAS, GAS | {"c": 1.0, "p_infinity": 2.0}),
    "gas and solid": (GAS, {"c": 1.0, "expansion": 0.1}),
}
LONG = (pytest.mark.long, pytest.mark.ci)
HAVE_AN_EXPRESSION = ("no expansion", "one thermal pressure")


def some(*always):
    """All pairs; the default suite tries at least the given pairs."""
    return [pytest.param(pair, marks=() if pair in always else LONG) for pair in PAIRS]


def warm(**given):
    return nv.Thermal(**({"material": ONE_COLD, "theta_R": 1.5} | given))


def body(name, material, **given):
    return nv.Body(name=name, where=0.5 - x if name == "a" else None, material=material, density=1.0, **given)


def mixture(pair):
    one, other = (warm(**given) for given in PAIRS[pair])
    return nv.Model(bodies=[body("a", one), body("b", other)]).material


@pytest.mark.parametrize("pair", some("one thermal pressure"))
def test_energy_of_bodies_with_heat_is_jointly_convex(pair):
    material = mixture(pair)
    assert material.has_one_volume == (pair in HAVE_AN_EXPRESSION)
    assert nv.check_convexity(material, dim=2).passed


def internal(given, S, J):
    """eps(S, J) of a body at B = I, J/m^3 of its reference volume."""
    each = warm(**given)
    g = each._Gamma * (np.log(J) if each.is_absolute else J - 1)
    heat = each.c * each.theta_R * (np.exp(S / each.c - g) - 1 + (0 if each.is_absolute else g))
    cold = each.material
    if cold is None:
        return heat + each.p_infinity * (J - 1)
    return heat + cold.K_e / 2 * (J - 1) ** 2 + 3 * cold.G_e


@pytest.mark.parametrize("pair", some("gas and solid"))
def test_bodies_share_volume_and_entropy_so_that_the_energy_is_minimal(pair):
    """For comparison, the energy is minimised over volumes and entropies. Differences of the minimum give
    pressure and temperature."""
    material, (one, other) = mixture(pair), PAIRS[pair]
    slices, respond_to = material.states(2).slices, respond(material, 2)

    def least(n, s):
        def total(unknown):
            J, S = unknown
            if not 0 < J < 1 / n[0]:
                return np.inf
            return n[0] * internal(one, S, J) + n[1] * internal(
                other, (s - n[0] * S) / n[1], (1 - n[0] * J) / n[1]
            )

        options = {"xatol": 1e-10, "fatol": 1e-15, "maxiter": 2000}
        return minimize(total, [1 / sum(n), s], method="Nelder-Mead", options=options).fun

    n, s = np.array([0.3, 0.6]), 0.5
    state = np.zeros((1, material.states(2).size))
    state[0, slices["s"]] = s / material.heat.entropy.unit
    for amount, name in zip(n, "ab", strict=True):
        state[0, slices[f"n_{name}"]] = amount
        if (tensor := slices.get(f"B_{name}")) is not None:
            state[0, tensor] = [amount, 0, amount, amount]
    found = respond_to(state)
    assert found.energy[0] == pytest.approx(least(n, s), rel=1e-11)
    theta = found.slope[0, slices["s"]][0] / material.heat.entropy.unit
    assert theta == pytest.approx((least(n, s + 1e-3) - least(n, s - 1e-3)) / 2e-3, rel=1e-5)
    step = 1e-5 * np.eye(len(state[0]))
    slopes = np.array([(respond_to(state + d).slope - respond_to(state - d).slope)[0] / 2e-5 for d in step])
    assert found.hessian[0] == pytest.approx(slopes, rel=1e-5, abs=1e-6 * abs(slopes).max())


@pytest.mark.parametrize(
    ("pair", "said"),
    [
        ((ONE_COLD, warm(c=1.0)), r"bodies\['a'\]\.material.*as for 'b', since"),
        ((warm(c=1.0, entropy_unit=1.0), warm(c=1.0, entropy_unit=2.0)), "one entropy_unit"),
        (
            (warm(c=1.0), nv.WithQuadratic(material=warm(c=1.0), delta=0.1)),
            "Thermal.*does not follow from other energies",
        ),
    ],
)
def test_bodies_without_a_common_temperature_are_refused(pair, said):
    with pytest.raises(nv.NgviscoError, match=said):
        nv.Model(bodies=[body("a", pair[0]), body("b", pair[1])])


def test_invalid_heat_of_a_body_is_refused():
    with pytest.raises(nv.NgviscoError, match=r"bodies\['a'\]\.heat'? ?= .*None"):
        nv.Model(bodies=[body("a", ONE_COLD, heat=nv.Heat(conductivity=1.0)), body("b", ONE_COLD)])
    with pytest.raises(nv.NgviscoError, match=r"bodies\['a'\]\.heat\.numerical_heating"):
        nv.Model(
            bodies=[body("a", warm(c=1.0), heat=nv.Heat(numerical_heating=True)), body("b", warm(c=1.0))]
        )
    with pytest.raises(nv.NgviscoError, match=r"Heat\.numerical_heating.*pressures"):
        pair = [body(name, warm(**given)) for name, given in zip("ab", PAIRS["two expansions"], strict=True)]
        nv.Model(bodies=pair, heat=nv.Heat(numerical_heating=True))


def test_conduction_and_sources_of_bodies_are_weighted_by_their_fractions():
    pair = [body(n, warm(c=1.0), heat=nv.Heat(conductivity=k, source=k)) for n, k in (("a", 2.0), ("b", 4.0))]
    law = nv.Model(bodies=pair, heat=nv.Heat(conductivity=1.0)).heat_law
    z = {"n_a": Array(np.array([0.5]), None), "n_b": Array(np.array([1.5]), None)}
    assert law.size(1.0, z).value == pytest.approx([1 + 0.25 * 2 + 0.75 * 4])
    assert sum(law.share(name, z) * value for name, value in law.sources).value == pytest.approx([3.5])


RUBBER = nv.ReferentialNeoHookean(K_e=20.0, G_e=5.0, elastic_state="B")
BETA, C_V, WARM = 0.01, 3.0, 300.0
"""Expansion, 1/K, heat capacity, J/(m^3 K), and reference temperature, K."""


def breaking(**options):
    given = {"material": RUBBER, "G_c": 0.1, "length": 0.5, "part": "all", "floor": 1e-6} | options
    return nv.Thermal(material=nv.Damaged(**given), c=C_V, theta_R=WARM, expansion=BETA)


def at(material, d, change, J=1.0):
    """Values of a body of the volume J and the entropy of a temperature at J = 1, ``change`` above WARM."""
    F = np.eye(3) * J ** (1 / 3)
    z = values({v.name: v.from_distortion(tensor(F)) for v in material.variables})
    s = math.log((WARM + change) / WARM) / J
    return tensors(z) | {"damage": ngsolve.Parameter(d), "s": ngsolve.Parameter(s)}


def test_thermal_stress_is_whole_in_an_intact_body_and_zero_in_a_broken_one():
    material = breaking()
    pressures = [-np.trace(value(cauchy_stress(material, at(material, d, 0.5)))) / 3 for d in (0.0, 1.0)]
    assert pressures[0] == pytest.approx(20.0 * BETA * 0.5, rel=1e-9)  # the pressure is K beta dtheta
    assert pressures[1] == pytest.approx(1e-6 * pressures[0], rel=1e-6)


def test_thermal_stress_drives_damage_and_free_expansion_does_not():
    """-d phi/dd at d = 0 is twice the elastic energy, K (beta dtheta)^2/2 in a clamped body."""
    material, change = breaking(), -0.5
    energy = 0.5 * 20.0 * (BETA * change) ** 2
    # the adiabatic stiffness is larger than the isothermal one by this factor
    stiffer = 1 + 20.0 * BETA**2 * WARM / C_V
    clamped = -value(conjugates(material, at(material, 0.0, change))["damage"])
    assert clamped == pytest.approx(2 * energy / stiffer, rel=1e-2)
    free = 1 + BETA * change / stiffer
    assert abs(value(conjugates(material, at(material, 0.0, change, free))["damage"])) < 0.02 * clamped


def test_a_clamped_body_that_is_cooled_breaks_like_a_material_point():
    """In one step at rest AT2 has d = 2 e/(2 e + G_c/l) with the elastic energy e."""
    change, material = -8.0, breaking(floor=1e-3)
    start = nv.Initial(density=1.0, temperature=WARM + change)
    model = nv.Model(material=material)
    run = nv.Simulation(box((1, 1), maxh=1.0), model, dt=0.1, initial=start, solver="coupled")
    run.run(0.1)
    bulk = 20.0 + (20.0 * BETA) ** 2 / C_V * (WARM + change)
    twice = (1 - 1e-3) * (20.0 * BETA * change) ** 2 / bulk
    assert run.fields["damage"](run.mesh(0.3, 0.4)) == pytest.approx(twice / (twice + 0.1 / 0.5), rel=1e-9)
    assert run.fields["damage"](run.mesh(0.3, 0.4)) > 0.3


def test_a_thermal_material_wraps_a_damaged_one_and_the_reverse_order_is_refused():
    warm = nv.Thermal(material=RUBBER, c=C_V, theta_R=WARM, expansion=BETA)
    with pytest.raises(nv.ParameterError, match=r"Damaged\.material.*nv\.Thermal\(material=\.+\) around"):
        nv.Damaged(material=warm, G_c=0.1, length=0.5)
    with pytest.raises(nv.ParameterError, match=r"Thermal\.expansion = 0\.01.*part=.all"):
        breaking(part="tensile")
    broken = nv.Damaged(material=RUBBER, G_c=0.1, length=0.5)
    with pytest.raises(
        nv.ParameterError, match=r"Thermal\.gruneisen = 0\.4.*expansion gives the thermal stress"
    ):
        nv.Thermal(material=broken, c=C_V, theta_R=WARM, gruneisen=0.4)
    # without a thermal stress the material is accepted
    assert nv.Thermal(material=broken, c=C_V, theta_R=WARM).material is broken
