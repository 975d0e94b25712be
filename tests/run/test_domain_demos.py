"""The demos of walls, periodic cells and curved domains meet their closed forms, energy and mass."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

DEMOS = Path(__file__).resolve().parents[2] / "demos"


def load(name):
    spec = importlib.util.spec_from_file_location(f"demo_{name}", DEMOS / name / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def assert_exact_balance(run):
    assert np.abs(run.ledger.column("closure_relative")).max() <= 1e-10
    assert np.abs(run.ledger.column("mass_drift")).max() <= 1e-12


SHEAR_TABLE = {  # tau_12 and tau_11 of Farrington et al. 2014 (ASPECT, simple_shear), Pa
    0.01: (0.298505, 0.000447),
    0.02: (0.594036, 0.001776),
    0.1: (2.854460, 0.042106),
    0.25: (6.630142, 0.238383),
    0.5: (11.765275, 0.810418),
    1.0: (18.747691, 2.362833),
    2.0: (25.079664, 5.231418),
}


def test_shear_demo_has_the_curve_of_the_published_table():
    """The table has six decimals, which is 0.1 % in its smallest entry."""
    demo = load("shear")
    assert list(demo.TIMES) == list(SHEAR_TABLE)
    assert np.abs(demo.exact(np.array(demo.TIMES)) - list(SHEAR_TABLE.values())).max() < 1e-6


def test_shear_meets_the_whole_table_to_a_thousandth(tmp_path):
    """A plain run, without extrapolation: steps of 1.65e-6 s at first, doubled after every 400."""
    run, errors = load("shear").main(str(tmp_path))
    assert errors.shape == (7, 2)
    assert np.abs(errors[:, 0]).max() < 4e-4
    assert np.abs(errors[:, 1]).max() < 1e-3
    assert run.ledger.column("dt")[1] == 1.65e-6
    assert (tmp_path / "stress.png").stat().st_size > 0
    assert_exact_balance(run)


def test_shear_is_the_implicit_euler_solution_of_its_two_equations():
    """The fields are uniform, so that the mesh adds nothing to dt E_12 and dt E_11."""
    demo, dt = load("shear"), 0.05
    rate, relaxation = dt * demo.RATE, 1 + dt * demo.G / demo.ETA
    step = np.linalg.inv([[relaxation, rate], [-rate, relaxation]])
    run, tau = demo.simulation(dt), np.zeros(2)
    for _ in range(4):
        run.advance()
        tau = step @ (tau + dt * np.array([demo.G * demo.RATE, 0.0]))
        assert demo.stress(run) == pytest.approx(tau, rel=1e-6)


@pytest.mark.parametrize("mu", [0.0, 0.02])
def test_wave_has_the_speed_and_decay_of_the_dispersion_relation(mu):
    demo = load("wave")
    run, amplitudes = demo.amplitudes(mu, 16)
    s, exact = demo.exponent(amplitudes), demo.dispersion(mu)
    assert abs(s.imag / exact.imag) == pytest.approx(1, abs=3e-4)
    assert s.real == pytest.approx(exact.real, rel=2e-3)
    assert_exact_balance(run)


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
