"""The Lagrangian reference of a tube against the damped standing wave of small amplitude."""

import numpy as np

from tests.verification.tube import densities


def test_a_small_wave_is_the_damped_standing_one():
    """v = a sin(k x) f(t), f'' + eta k^2 f' + k^2 f = 0: with P = lambda - 1 and rho_0 = 1."""
    amplitude, eta, k = 1e-4, 0.05, 2 * np.pi
    line, times = np.linspace(0.1, 0.9, 17), [0.1, 0.3]
    found = densities(lambda s: s - 1, eta, lambda X: amplitude * np.sin(k * X), times, line, 200)
    decay = 0.5 * eta * k * k
    omega = np.sqrt(k * k - decay * decay)
    for profile, t in zip(found, times, strict=True):
        # lambda - 1 = a k cos(k x) g(t), g' = f, g(0) = 0, f(0) = 1
        g = np.exp(-decay * t) * np.sin(omega * t) / omega
        expected = 1 - amplitude * k * np.cos(k * line) * g
        assert np.abs(profile - expected).max() <= 0.01 * amplitude
