"""Tests of the reference code for bouncing discs: a free vibration, momentum and energy."""

import math

import numpy as np
import pytest
from ngsolve import CF, x, y
from scipy.optimize import brentq
from scipy.special import j0, j1
from support import by_ci

from tests.verification.lagrangian import Disc, Medium, ThrownDisc, restitution

DISC = Disc(radius=0.21, density=1.0, bulk=2.0, shear=1.0, viscosity=0.002)


@pytest.mark.parametrize("damping", [by_ci(0.0), 0.05])
def test_a_disc_breathes_at_its_own_frequency_and_decays(damping: float):
    """The mode u_r = J_1(k r), plane strain, free at r = R, has (lambda + 2 mu) kR J_0(kR) = 2 mu J_1(kR).

    With K = G and both viscosities eta, the linearised viscous stress is eta/G times the time derivative of
    the elastic stress. The mode is therefore an oscillator with the decay omega^2 eta/(2 G).
    """
    bulk = shear = 1.0
    lame, density, radius = bulk - 2 / 3 * shear, 1.5, 0.21
    wave = lame + 2 * shear
    kR = brentq(lambda s: wave * s * j0(s) - 2 * shear * j1(s), 1.0, 2.4)
    omega = kR / radius * math.sqrt(wave / density)
    decay = damping * omega
    disc = Disc(
        radius=radius, density=density, bulk=bulk, shear=shear, viscosity=2 * decay * shear / omega**2
    )
    s2 = (kR / radius) ** 2 * (x * x + y * y) / 4
    profile = sum((-s2) ** m / (math.factorial(m) * math.factorial(m + 1)) for m in range(1, 7)) + 1.0
    free = ThrownDisc(disc, 1e-4 * CF((x, y)) * profile, gap=1.0, maxh=0.1)
    period = 2 * math.pi / math.sqrt(omega**2 - decay**2)
    rows = free.run(period, period / 64)
    left = math.exp(-2 * decay * period)
    # after a period the velocity is the start value times the decay
    assert rows[-1, 2] / rows[0, 2] == pytest.approx(left, rel=5e-3)
    assert rows[-1, 3] <= 2e-3 * rows[0, 2]
    assert rows[-1, 5] / rows[0, 2] == pytest.approx(1 - left, abs=5e-3)


@pytest.mark.parametrize("medium", [None, Medium(bulk=2.0, area=0.42)])
def test_a_bounce_keeps_energy_up_to_viscosity_and_time_steps(medium: Medium | None):
    run = ThrownDisc(DISC, CF((0.2, 0.0)), gap=0.01, maxh=0.2, medium=medium)
    rows = run.run(1.1, 0.05)
    total = rows[:, 2:].sum(axis=1)
    mass = math.pi * DISC.radius**2
    assert rows[0, 1] == pytest.approx(0.2 * mass, rel=1e-3)
    assert rows[0, 2] == pytest.approx(0.02 * mass, rel=1e-3)
    assert abs(total / total[0] - 1).max() < 0.004
    assert 0.85 < restitution(rows) < 1.0
    assert (np.diff(rows[:, 5]) >= 0).all()
    assert rows[-1, 4] == 0.0  # the disc has left the wall
    assert rows[:, 4].max() < 0.05 * total[0]
    assert (rows[:, 6].max() > 1e-3 * total[0]) == (medium is not None)
