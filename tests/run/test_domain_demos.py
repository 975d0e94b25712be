"""The demos of walls, periodic cells and curved domains meet their closed forms, energy and mass."""

import numpy as np
import pytest
from support import demo as load

from tests.verification.cases.shear import TABLE

LONG = (pytest.mark.long, pytest.mark.ci)


def assert_exact_balance(run):
    assert np.abs(run.ledger.column("closure_relative")).max() <= 1e-10
    assert np.abs(run.ledger.column("mass_drift")).max() <= 1e-12


def test_shear_demo_has_the_curve_of_the_published_table():
    """The table has six decimals, which is 0.1 % in its smallest entry."""
    demo = load("shear")
    assert list(demo.TIMES) == list(TABLE)
    assert np.abs(demo.exact(np.array(demo.TIMES)) - list(TABLE.values())).max() < 1e-6


@pytest.mark.long
@pytest.mark.ci
def test_shear_meets_the_whole_table_to_a_thousandth(tmp_path):
    """By the midpoint rule with 800 steps; the backward Euler scheme is off by a quarter in tau_11."""
    results = load("shear").main(str(tmp_path))
    for scheme, bounds in (("midpoint", (1e-6, 2.5e-4)), ("backward-euler", (1.5e-3, 0.3))):
        run, errors = results[scheme]
        assert errors.shape == (7, 2) and run.number == 800
        assert np.all(errors.max(axis=0) < bounds), scheme
        assert_exact_balance(run)
    assert np.all(results["backward-euler"][1].max(axis=0) > 1e3 * results["midpoint"][1].max(axis=0))
    assert (tmp_path / "stress.png").stat().st_size > 0


@pytest.mark.parametrize(("scheme", "theta"), [("backward-euler", 1.0), ("midpoint", 0.5)])
def test_shear_is_the_scheme_applied_to_its_two_equations(scheme, theta):
    """The fields are uniform, so that the mesh adds nothing to d tau_12/dt and d tau_11/dt."""
    demo, dt = load("shear"), 0.05
    rate, relaxation = theta * dt * demo.RATE, 1 + theta * dt * demo.G / demo.ETA
    solve = np.linalg.inv([[relaxation, rate], [-rate, relaxation]])
    run, tau = demo.simulation(dt, scheme=scheme), np.zeros(2)
    for _ in range(4):
        run.advance()
        inner = solve @ (tau + theta * dt * np.array([demo.G * demo.RATE, 0.0]))
        tau = tau + (inner - tau) / theta
        assert demo.stress(run) == pytest.approx(tau, rel=1e-6)


@pytest.mark.parametrize(
    ("scheme", "mu"),
    [
        ("midpoint", 0.02),
        ("backward-euler", 0.0),
        *(pytest.param(*case, marks=LONG) for case in (("midpoint", 0.0), ("backward-euler", 0.02))),
    ],
)
def test_wave_has_the_speed_and_decay_of_the_dispersion_relation(mu, scheme):
    """Without the factor of the scheme, (1 + s dt/2)/(1 - s dt/2) or 1/(1 - s dt), instead of exp(s dt)."""
    demo = load("wave")
    run, amplitudes = demo.amplitudes(mu, 16, scheme)
    exact, z = demo.dispersion(mu), np.exp(demo.DT * demo.exponent(amplitudes))
    s = (2 * (z - 1) / (z + 1) if scheme == "midpoint" else 1 - 1 / z) / demo.DT
    assert abs(s.imag / exact.imag) == pytest.approx(1, abs=3e-4)
    assert s.real == pytest.approx(exact.real, rel=2e-3)
    assert_exact_balance(run)


@pytest.mark.long
@pytest.mark.ci
@pytest.mark.parametrize("mu", [0.0, 0.02])
def test_wave_decays_in_the_run_as_the_model_says(mu):
    """With the scheme's own error: Euler adds omega^2 dt/2 = 0.08 1/s to the decay."""
    demo = load("wave")
    exact = demo.dispersion(mu)
    found = {
        scheme: demo.exponent(demo.amplitudes(mu, 16, scheme)[1]) for scheme in ("midpoint", "backward-euler")
    }
    assert found["midpoint"].real == pytest.approx(exact.real, rel=5e-3)
    assert abs(found["midpoint"].imag) == pytest.approx(abs(exact.imag), rel=1e-3)
    assert found["backward-euler"].real == pytest.approx(exact.real - 0.08, rel=0.02)


@pytest.mark.long
@pytest.mark.ci
def test_couette_stress_is_that_of_the_closed_form(tmp_path):
    demo = load("couette")
    run = demo.simulation(maxh=0.5)
    run.run(1.5)
    r = np.linspace(1.1, 1.9, 5)
    assert np.abs(demo.profile(run, r) / demo.shear_stress(r) - 1).max() < 0.01
    assert run.ledger.column("power_wall_outer")[1:].min() > 0
    assert_exact_balance(run)


@pytest.mark.long
def test_couette_demo_is_within_half_a_per_cent(tmp_path):
    _, error = load("couette").main(str(tmp_path))
    assert error < 0.005


@pytest.mark.long
@pytest.mark.ci
def test_heavy_body_sinks_in_the_shell():
    demo = load("shell")
    run = demo.simulation(maxh=0.6)
    before = demo.depth(run)
    run.run(0.6)
    assert demo.depth(run) < before - 0.005
    assert_exact_balance(run)


@pytest.mark.long
def test_shell_demo_runs_as_its_readme_says(tmp_path):
    run, before, after = load("shell").main(str(tmp_path))
    assert after < before - 0.1
    assert_exact_balance(run)
