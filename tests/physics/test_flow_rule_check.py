"""Flow rules at a point: what a model refuses of them."""

import math
from dataclasses import dataclass

import pytest

import ngvisco as nv
from ngvisco.physics.tensors import identity_like, square


@dataclass(frozen=True, kw_only=True)
class Odd(nv.FlowRule):
    """A rule with something wrong, by its sign, its trace or a potential that is not its own."""

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


@pytest.mark.parametrize(
    ("rule", "field"),
    [
        (Odd(sign=-1.0), "Odd.rate.*M : Pi >= 0"),
        (Odd(trace=1.0), "Odd.rate.*tr Pi = 0"),
        (Odd(nu=1.0, factor=2.0), "Odd.psi.*psi'"),
        (Powerless(), "Powerless.nu.*no potential"),
    ],
)
def test_a_rule_that_makes_no_sense_is_refused_by_name(rule, field):
    with pytest.raises(nv.ParameterError, match=field):
        nv.Model(material=nv.LinearElastic(K_e=10.0, G_e=5.0), creep=rule)


@pytest.mark.parametrize("nu", [0.0, 1.0])
def test_a_rule_that_makes_sense_is_taken(nu):
    nv.Model(material=nv.LinearElastic(K_e=10.0, G_e=5.0), creep=Odd(nu=nu))


def test_the_relaxation_time_of_the_linear_rule_is_that_of_maxwell():
    assert nv.Creep(G_m=3.0).relaxation_time(5.0, {}) == pytest.approx(0.3, rel=1e-14)
    assert nv.Creep(G_m=math.inf).relaxation_time(5.0, {}) == math.inf
