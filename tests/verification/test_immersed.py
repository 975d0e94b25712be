"""Tests of the reference code for soft discs: its fluid, its solid, and their coupling."""

import numpy as np
import pytest

from tests.verification.cases.soft_disc import PATH
from tests.verification.immersed import CAVITY, Immersed, Problem, computed, limit


def test_forces_are_the_slope_of_the_energy_and_in_balance():
    run = Immersed(CAVITY, 16)
    rng = np.random.default_rng(1)
    X = run.X @ np.array([[1.2, 0.3], [0.1, 0.9]]) + 1e-3 * rng.standard_normal(run.X.shape)
    direction, step = rng.standard_normal(X.shape), 1e-6
    forces = run.elastic(X)[1]
    slope = (run.elastic(X + step * direction)[0] - run.elastic(X - step * direction)[0]) / (2 * step)
    assert -(forces * direction).sum() == pytest.approx(slope, rel=1e-5)
    assert np.abs(forces.sum(axis=0)).max() < 1e-14


def test_a_taylor_green_vortex_decays_at_its_exact_rate():
    """The energy decays by exp(-16 pi^2 nu t); the disc's shear modulus is negligible."""
    still = Problem(centre=(0.5, 0.5), radius=0.2, shear_modulus=1e-9, viscosity=0.01, vortex=0.05)
    rows = computed(still, 32, np.array([0.0, 0.2]))
    assert rows[1, 4] / rows[0, 4] == pytest.approx(np.exp(-16 * np.pi**2 * 0.01 * 0.2), rel=5e-3)


def test_energy_is_only_lost_to_viscosity_in_a_fluid_without_divergence():
    run = Immersed(CAVITY, 16)
    assert abs(run.elastic(run.X)[0]) < 1e-14
    swinging = Problem(centre=(0.5, 0.5), radius=0.2, shear_modulus=1.0, viscosity=1e-3, vortex=0.05)
    rows = computed(swinging, 32, np.linspace(0, 0.3, 7))
    total = rows[:, 4] + rows[:, 5]
    assert (np.diff(total) < 0).all()
    assert rows[:, 5].max() > 0.2 * total[0]
    assert rows[-1, 3] == pytest.approx(rows[0, 3], rel=5e-3)
    run.advance(0.01)
    assert np.abs(run.divergence(run.u, run.v)).max() < 1e-12 < run.elastic(run.X)[0]


@pytest.mark.long
@pytest.mark.ci
def test_the_kept_path_is_the_limit_of_fine_grids_with_both_kernels():
    """Errors on grids are of first order. The limit by each kernel differs from the kept path by less than a
    fifth of the error on 48 cells."""
    times = np.array([0.0, 1.0])
    for width in (4, 3):
        rows = {cells: computed(CAVITY, cells, times, width) for cells in (24, 32, 48)}
        own, limited = (np.linalg.norm(path[1, 1:3] - PATH[1, 1:]) for path in (rows[48], limit(rows)))
        assert 3e-4 < own < 3e-3 and limited < 0.2 * own
