"""The stress of a flow rule by what it and its rate make together."""

import numpy as np
import pytest
from flow_rules import EXAMPLES

import ngvisco as nv
from ngvisco.physics.arrays import Array
from ngvisco.physics.flow_rules.resolvent import resolved, slope_of
from ngvisco.physics.tensors import trace_free_tensors
from ngvisco.physics.variables import PRESSURE

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
def test_stress_and_rate_make_what_is_given(name):
    rate = at_points(RULES[name])
    for start in (None, np.zeros(len(Y)), np.full(len(Y), 10.0)):
        M, Pi = resolved(rate, Y, 0.1, start)
        assert np.allclose(Pi, rate(M), rtol=1e-12, atol=0)
        steep = 1 + 0.1 * abs(slope_of(rate, M)).max(axis=(1, 2))
        left = np.linalg.norm(M + 0.1 * rate(M) - Y, axis=1)
        assert (left <= 1e-13 * steep * np.linalg.norm(Y, axis=1)).all()
        assert (np.linalg.norm(M, axis=1) <= (1 + 1e-14) * np.linalg.norm(Y, axis=1)).all()


@pytest.mark.parametrize("name", ["Norton, n = 3", "Bingham"])
def test_a_rate_that_is_no_multiple_of_its_stress(name):
    rate = at_points(RULES[name], turned=True)
    M, _ = resolved(rate, Y, 0.1)
    assert (np.linalg.norm(M + 0.1 * rate(M) - Y, axis=1) <= 1e-11 * np.linalg.norm(Y, axis=1)).all()


def test_a_rate_that_gives_energy_has_its_stress_above():
    M, _ = resolved(lambda M: -0.3 * M, Y, 1.0)
    assert np.allclose(M, Y / 0.7, rtol=1e-13)
