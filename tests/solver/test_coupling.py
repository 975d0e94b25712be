"""Blocks of cells and sides against the rows that the transport forms point by point."""

from __future__ import annotations

import numpy as np
import pytest
from ngsolve import CF, x, y, z

import ngvisco as nv
from ngvisco.geometries import box, disc
from ngvisco.solver.split.sweep import SWEEPS

pytestmark = pytest.mark.usefixtures("double_precision")


@pytest.fixture(params=["2D", "3D", "periodic", "constants", "quadratic", "disc"])
def split(request):
    dim = 3 if request.param == "3D" else 2
    m = {"constants": 0, "quadratic": 2}.get(request.param, 1)
    model = nv.Model(
        material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1),
        viscosity=nv.StokesViscosity(K_v=0.1, G_v=0.2),
    )
    periodic = "x" if request.param == "periodic" else ""
    mesh = box((1,) * dim, maxh=0.6 if dim == 3 else 0.35, periodic=periodic)
    if request.param == "disc":
        mesh = disc(1.0, maxh=0.5)
    velocity = (CF(x + 2 * y) * (1 - y), CF(1 - x * y), CF(z - x))[:dim]
    run = nv.Simulation(
        mesh,
        model,
        dt=0.01,
        initial=nv.Initial(velocity=CF(velocity)),
        solver="split",
        discretisation=nv.Discretisation(k=2, m=m),
    )
    split = run.solver.newton
    rng = np.random.default_rng(1)
    split.transport.z[:] += 0.02 * rng.standard_normal(split.transport.z.shape)
    split.transport.rho[:] += 0.02 * rng.standard_normal(split.transport.rho.shape)
    run.rothe_step.context.tau.Set(0.01)
    split.momentum.start()
    split.residual()
    split.preconditioner.sweep.update()
    return split


def rows(sweep, own, across, values):
    return sweep._sparse(own, across) @ values


def test_rows_of_a_field(split):
    sweep, f = split.preconditioner.sweep, split.transport.facets
    own, across = sweep.coupling.blocks(-f.carried, 1 - f.inflow, f.carried, f.trace_mass)
    expected = f.fields()
    assert np.abs(across).max() > 0
    for field, row in zip(split.transport.z, expected, strict=True):
        assert rows(sweep, own, across, field) == pytest.approx(row, abs=1e-13 * np.abs(expected).max())


def test_rows_of_the_density(split):
    sweep, f = split.preconditioner.sweep, split.transport.facets
    own, across = sweep.coupling.blocks(f.up, f.up, -f.down, f.density_mass)
    own += sweep._mass / split.transport.context.tau.Get() - sweep._convection().transpose(0, 2, 1)
    found = rows(sweep, own, across, split.transport.rho - split.transport.rho_old)
    # the rows are affine in rho: their part from the old density, taken off
    now = split.transport.residual()[0]
    split.transport.rho[:] = split.transport.rho_old
    split.transport.set_traces()
    expected = now - split.transport.residual()[0]
    assert found == pytest.approx(expected, abs=1e-13 * np.abs(expected).max())


def test_sweeps_approach_the_solution(split):
    """Three sweeps are the first terms of the series for T^{-1}; of the density's too."""
    sweep, t = split.preconditioner.sweep, split.transport
    f = t.facets
    own, across = sweep.coupling.blocks(-f.carried, 1 - f.inflow, f.carried, f.trace_mass)
    own += sweep._mass / t.context.tau.Get() + sweep._convection()
    T, r = sweep._sparse(own, across), np.ascontiguousarray(t.z.T)
    found = sweep.fields(r)
    once = sweep.in_cells(r)
    exact = np.linalg.solve(T.toarray(), r)
    assert np.linalg.norm(found - exact) < 0.5 * np.linalg.norm(once - exact)
    twice = once + sweep.in_cells(r - T @ once)
    thrice = twice + sweep.in_cells(r - T @ twice)
    assert found == pytest.approx(thrice, abs=1e-12 * np.abs(found).max())
    own, across = sweep.coupling.blocks(f.up, f.up, -f.down, f.density_mass)
    own += sweep._mass / t.context.tau.Get() - sweep._convection().transpose(0, 2, 1)
    T, r = sweep._sparse(own, across), t.rho - 1.1
    x = np.zeros_like(r)
    for _ in range(SWEEPS):
        x += np.linalg.solve(own, (r - T @ x).reshape(*own.shape[:2], 1)).ravel()
    assert sweep.density(r) == pytest.approx(x, abs=1e-12 * np.abs(x).max())
