"""The rules at a point: what they are, against the formulas of the literature, and what they refuse."""

import math

import numpy as np
import pytest
from flow_rules import EXAMPLES
from scipy.integrate import quad

import ngvisco as nv
from ngvisco.physics.arrays import TINY, Array
from ngvisco.physics.variables import HARDENING, PRESSURE

UNIAXIAL = np.diag([2.0, -1.0, -1.0]) / 3
SHEAR = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])


UNHARDENED = {HARDENING: Array(np.zeros(1), None)}


def rate(rule, M, pressure=0.0):
    values = UNHARDENED | {PRESSURE: Array(np.array([pressure]), None)}
    return rule.rate(Array(np.asarray(M)[..., None], None), None, values).value[..., 0]


def stress(rule, Pi):
    return rule.force(Array(np.asarray(Pi)[..., None], None), UNHARDENED).value[..., 0]


@pytest.mark.parametrize(
    ("rule", "M", "expected"),
    [
        (
            nv.Norton(A=1.5**2 * 0.3, n=3),
            2.0 * UNIAXIAL,
            1.5 * 0.3 * 2.0**3 * UNIAXIAL,
        ),  # strain rate B sigma^3
        (nv.Perzyna(sigma_Y=1.0, G_m=2.0), 0.999 * UNIAXIAL, 0 * UNIAXIAL),
        (nv.Perzyna(sigma_Y=1.0, G_m=2.0), 3.0 * UNIAXIAL, (3.0 - 1.0) / 2.0 * UNIAXIAL),
        (nv.Perzyna(sigma_Y=1.0, G_m=2.0, n=3), 3.0 * UNIAXIAL, 2.0**3 / 2.0 * UNIAXIAL),
        (nv.Perzyna(sigma_Y=1.0, G_m=2.0), 0.577 * SHEAR, 0 * SHEAR),  # tau_Y = sigma_Y/sqrt(3)
        (nv.Perzyna(sigma_Y=math.sqrt(3), G_m=2.0), 3.0 * SHEAR, SHEAR),  # dev T = tau_Y + G_m/2 (2 eps)
        (nv.Eyring(A=0.7, sigma_0=2.0), math.sqrt(2) * SHEAR, 0.7 * math.sinh(1.0) / math.sqrt(2) * SHEAR),
    ],
)
def test_rates_are_those_of_the_literature(rule, M, expected):
    assert rate(rule, M) == pytest.approx(expected, rel=1e-13, abs=1e-15)


@pytest.mark.parametrize("pressure", [-10.0, 0.0, 2.0])
def test_strength_grows_with_pressure_and_is_never_negative(pressure):
    rule, tau = nv.DruckerPrager(cohesion=1.0, friction_angle=30.0, G_m=4.0), 3.0
    strength = max(0.0, math.cos(math.pi / 6) + pressure / 2)
    assert rate(rule, tau * SHEAR, pressure) == pytest.approx((tau - strength) / 4.0 * SHEAR, rel=1e-13)
    assert not rate(rule, 0.999 * strength * SHEAR, pressure).any()


def test_every_shipped_rule_is_among_the_examples():
    """Which ``tests/solver/test_rules_in_flows.py`` runs by all materials, solvers, dimensions, schemes."""
    shipped = {each for each in vars(nv).values() if isinstance(each, type) and issubclass(each, nv.FlowRule)}
    assert {type(rule) for rule in EXAMPLES.values()} == shipped - {nv.FlowRule}


WITH_POTENTIAL = [name for name, rule in EXAMPLES.items() if type(rule).psi is not nv.FlowRule.psi]


@pytest.mark.parametrize("name", WITH_POTENTIAL)
def test_psi_is_the_dual_of_the_rate_s_potential(name):
    """psi(Pi) = int M : dPi along a ray, and psi'(rate(M)) = M."""
    rule, sizes = EXAMPLES[name], (1.0, 2.0)
    rates = [rate(rule, size * SHEAR) for size in sizes]
    for size, Pi in zip(sizes, rates, strict=True):
        assert stress(rule, Pi) == pytest.approx(size * SHEAR, rel=1e-6)
    at = [float(rule.psi(Array(Pi[..., None], None), UNHARDENED).value[0]) for Pi in rates]
    power, _ = quad(lambda size: 2 * rate(rule, size * SHEAR)[0, 1], *sizes, epsrel=1e-12)
    complementary = sum(
        sign * size * 2 * Pi[0, 1] for sign, size, Pi in zip((-1, 1), sizes, rates, strict=True)
    )
    assert at[1] - at[0] == pytest.approx(complementary - power, rel=1e-6)


@pytest.mark.parametrize("name", EXAMPLES)
@pytest.mark.parametrize("size", [0.0, 1e-9, 1.0])
def test_slopes_by_complex_increments_are_those_of_differences(name, size):
    rule, h = EXAMPLES[name], 1e-6
    M, N = size * SHEAR, UNIAXIAL + SHEAR
    of_increment = rate(rule, M + (TINY * 1j) * N).imag / TINY
    difference = (rate(rule, M + h * N) - rate(rule, M - h * N)) / (2 * h)
    assert of_increment == pytest.approx(difference, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("name", EXAMPLES)
def test_a_model_takes_every_rule(name):
    nv.Model(material=nv.LinearElastic(K_e=10.0, G_e=5.0), creep=EXAMPLES[name])
