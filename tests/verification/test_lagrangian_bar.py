"""Tests of the reference code for bars at a wall: an elastic bounce, yielding, volume and energy."""

import math

import numpy as np
import pytest

from tests.verification.lagrangian_bar import Metal, ThrownBar

COPPER = Metal(density=8.93, bulk=130.0, shear=43.3, yield_stress=0.4, hardening=0.1)


def energy(bar: ThrownBar) -> float:
    """The sum of a bar's stored, kinetic and dissipated energy."""
    return bar.kinetic + bar.stored + bar.worked + bar.damped


def test_an_elastic_block_leaves_the_wall_when_its_wave_comes_back():
    """The slender block in plane strain has waves of the speed (E/((1 - nu^2) rho))^{1/2}, and keeps its
    energy."""
    K, G, rho, speed = 2.0, 1.0, 1.0, 1e-3
    metal = Metal(density=rho, bulk=K, shear=G, yield_stress=1e6, hardening=0.0)
    bar = ThrownBar(metal, 10.0, 0.5, speed, 2, revolution=False)
    sound = math.sqrt(4 * G * (3 * K + G) / (3 * K + 4 * G) / rho)  # E/(1 - nu^2) in K and G
    first, mass = energy(bar), bar.masses.sum()
    bar.run(0.9 * 20.0 / sound)
    assert bar.x[:3, 1].max() < 1e-6  # the foot is still at the wall
    bar.run(1.4 * 20.0 / sound)
    assert bar.x[:3, 1].min() > 1e-5
    assert 0.85 < (bar.masses * bar.v[:, 1]).sum() / mass / speed < 1.0
    assert 0.9 < energy(bar) / first < 1.0  # the nodes of the foot stop at once
    assert bar.worked == 0.0


@pytest.mark.parametrize("revolution", [True, False])
def test_a_bar_that_yields_keeps_its_volume_and_its_energy(revolution: bool):
    bar = ThrownBar(COPPER, 32.4, 3.2, 0.227, 2, revolution)
    first, (_, before, _) = energy(bar), bar._mapped()
    bar.run(5.0)
    _, after, _ = bar._mapped()
    assert 0.95 < energy(bar) / first < 1.0
    assert abs(after.sum() / before.sum() - 1) < 0.01
    assert 0.05 < bar.worked / first < 0.25
    # the wave of loading has not reached the rear
    assert np.allclose(bar.v[-3:, 1], -0.227, rtol=1e-2)
    size = np.linalg.norm(
        bar.b - np.trace(bar.b, axis1=2, axis2=3)[..., None, None] / 3 * np.eye(3), axis=(2, 3)
    )
    limit = math.sqrt(2 / 3) * (0.4 + 0.1 * bar.k) / COPPER.shear
    assert (size <= limit * (1 + 1e-9)).all() and np.allclose(np.linalg.det(bar.b), 1.0)
