"""Flow rules at a point: the formulas of the literature, their resolvents, and rules that a model
refuses."""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import pytest
from flow_rules import EXAMPLES, OF_CONFORMATION
from scipy.integrate import quad

import ngvisco as nv
from ngvisco.errors import Quantity
from ngvisco.physics.arrays import TINY, Array
from ngvisco.physics.flow_rules.resolvent import resolved, slope_of
from ngvisco.physics.parameters import Modulus
from ngvisco.physics.tensors import identity_like, square, trace_free_tensors
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
        # the strain rate is B sigma^3 with B = 0.3
        (
            nv.Norton(A=1.5**2 * 0.3, n=3),
            2.0 * UNIAXIAL,
            1.5 * 0.3 * 2.0**3 * UNIAXIAL,
        ),
        (nv.Perzyna(sigma_Y=1.0, G_m=2.0), 0.999 * UNIAXIAL, 0 * UNIAXIAL),
        (nv.Perzyna(sigma_Y=1.0, G_m=2.0), 3.0 * UNIAXIAL, (3.0 - 1.0) / 2.0 * UNIAXIAL),
        (nv.Perzyna(sigma_Y=1.0, G_m=2.0, n=3), 3.0 * UNIAXIAL, 2.0**3 / 2.0 * UNIAXIAL),
        (nv.Perzyna(sigma_Y=1.0, G_m=2.0), 0.577 * SHEAR, 0 * SHEAR),  # tau_Y = sigma_Y/sqrt(3)
        (nv.Perzyna(sigma_Y=math.sqrt(3), G_m=2.0), 3.0 * SHEAR, SHEAR),  # dev T = tau_Y + G_m/2 (2 eps)
        (nv.Eyring(A=0.7, sigma_0=2.0), math.sqrt(2) * SHEAR, 0.7 * math.sinh(1.0) / math.sqrt(2) * SHEAR),
    ],
)
def test_rates_equal_the_formulas_of_the_literature(rule, M, expected):
    assert rate(rule, M) == pytest.approx(expected, rel=1e-13, abs=1e-15)


@pytest.mark.parametrize("pressure", [-10.0, 0.0, 2.0])
def test_strength_grows_with_pressure_and_is_never_negative(pressure):
    rule, tau = nv.DruckerPrager(cohesion=1.0, friction_angle=30.0, G_m=4.0), 3.0
    strength = max(0.0, math.cos(math.pi / 6) + pressure / 2)
    assert rate(rule, tau * SHEAR, pressure) == pytest.approx((tau - strength) / 4.0 * SHEAR, rel=1e-13)
    assert not rate(rule, 0.999 * strength * SHEAR, pressure).any()


def test_every_shipped_rule_is_among_the_examples():
    """``tests/solver/test_rules_in_flows.py`` runs these examples with all materials, solvers, dimensions and
    schemes."""
    shipped = {each for each in vars(nv).values() if isinstance(each, type) and issubclass(each, nv.FlowRule)}
    known = {type(rule) for rule in (EXAMPLES | OF_CONFORMATION).values()}
    assert known == shipped - {nv.FlowRule}


WITH_POTENTIAL = [name for name, rule in EXAMPLES.items() if type(rule).psi is not nv.FlowRule.psi]


@pytest.mark.parametrize("name", WITH_POTENTIAL)
def test_psi_is_the_dual_of_the_potential_of_the_rate(name):
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
def test_slopes_by_complex_increments_equal_central_differences(name, size):
    rule, h = EXAMPLES[name], 1e-6
    M, N = size * SHEAR, UNIAXIAL + SHEAR
    of_increment = rate(rule, M + (TINY * 1j) * N).imag / TINY
    difference = (rate(rule, M + h * N) - rate(rule, M - h * N)) / (2 * h)
    assert of_increment == pytest.approx(difference, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("name", EXAMPLES)
def test_a_model_accepts_every_shipped_rule(name):
    nv.Model(material=nv.LinearElastic(K_e=10.0, G_e=5.0), creep=EXAMPLES[name])


SPACE = trace_free_tensors(3)
Y = np.random.default_rng(0).standard_normal((200, 5)) * 10.0 ** np.linspace(-3, 2, 200)[:, None]


def at_points(rule, turned=False):
    read = {PRESSURE: Array(np.full(len(Y), 0.2), None)}
    axes = np.linspace(0.5, 2.0, 5) if turned else 1.0

    def rate(M):
        Pi = rule.rate(SPACE.tensor(Array((axes * M).T, None)), None, read)
        return axes * SPACE.components(Pi).value.T

    return rate


RULES = {
    name: rule for name, rule in EXAMPLES.items() if name not in ("linear hardening", "Voce", "activated")
}
RULES |= {f"yield, {G_m:g} Pa s": nv.Perzyna(sigma_Y=0.5, G_m=G_m) for G_m in (1e-3, 1e-8)}


@pytest.mark.parametrize("name", RULES)
def test_the_resolved_stress_plus_its_rate_equals_the_given_tensor(name):
    rate = at_points(RULES[name])
    for start in (None, np.zeros(len(Y)), np.full(len(Y), 10.0)):
        M, Pi = resolved(rate, Y, 0.1, start)
        assert np.allclose(Pi, rate(M), rtol=1e-12, atol=0)
        steep = 1 + 0.1 * abs(slope_of(rate, M)).max(axis=(1, 2))
        left = np.linalg.norm(M + 0.1 * rate(M) - Y, axis=1)
        assert (left <= 1e-13 * steep * np.linalg.norm(Y, axis=1)).all()
        assert (np.linalg.norm(M, axis=1) <= (1 + 1e-14) * np.linalg.norm(Y, axis=1)).all()


@pytest.mark.parametrize("name", ["Norton, n = 3", "Bingham"])
def test_a_resolvent_exists_for_rates_that_are_no_multiples_of_their_stress(name):
    rate = at_points(RULES[name], turned=True)
    M, _ = resolved(rate, Y, 0.1)
    assert (np.linalg.norm(M + 0.1 * rate(M) - Y, axis=1) <= 1e-11 * np.linalg.norm(Y, axis=1)).all()


def test_the_resolved_stress_of_a_rate_that_gives_energy_is_larger_than_the_given_one():
    M, _ = resolved(lambda M: -0.3 * M, Y, 1.0)
    assert np.allclose(M, Y / 0.7, rtol=1e-13)


@dataclass(frozen=True, kw_only=True)
class Odd(nv.FlowRule):
    """A rule with a wrong sign, a trace, or the potential of another rule."""

    sign: float = 1.0
    trace: float = 0.0
    nu: float = 0.0
    factor: float = 1.0

    def rate(self, M, zeta, z):
        return self.sign * M + self.trace * identity_like(M) * square(M)

    def psi(self, Pi, z):
        return (0.5 * self.factor) * square(Pi)


class Powerless(nv.FlowRule):
    nu = 1.0

    def rate(self, M, zeta, z):
        return 2.0 * M


@dataclass(frozen=True, kw_only=True)
class Direct(nv.FlowRule):
    """A rule whose rate multiplies by the Modulus object and not by its value at the point."""

    A: Annotated[Modulus, Quantity("1/s/Pa", "> 0", 0.1)]

    def rate(self, M, zeta, z):
        return self.A * M


@pytest.mark.parametrize(
    ("rule", "field"),
    [
        (Direct(A=nv.Parameter("A", start=1.0)), r"Direct.rate.*value_at\(self.A, z\)"),
        (Odd(sign=-1.0), "Odd.rate.*M : Pi >= 0"),
        (Odd(trace=1.0), "Odd.rate.*expected 0 for the trace of Pi"),
        (Odd(nu=1.0, factor=2.0), "Odd.psi.*psi'"),
        (Powerless(), "Powerless.nu.*no potential"),
    ],
)
def test_an_invalid_rule_is_refused_by_name(rule, field):
    with pytest.raises(nv.ParameterError, match=field):
        nv.Model(material=nv.LinearElastic(K_e=10.0, G_e=5.0), creep=rule)


@pytest.mark.parametrize("nu", [0.0, 1.0])
def test_a_valid_rule_is_accepted(nu):
    nv.Model(material=nv.LinearElastic(K_e=10.0, G_e=5.0), creep=Odd(nu=nu))


def test_the_linear_rule_has_the_relaxation_time_of_maxwell():
    assert nv.Creep(G_m=3.0).relaxation_time(5.0, {}) == pytest.approx(0.3, rel=1e-14)
    assert nv.Creep(G_m=math.inf).relaxation_time(5.0, {}) == math.inf
