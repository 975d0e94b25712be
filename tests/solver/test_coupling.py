"""Blocks of cells and sides against the rows that the transport forms point by point."""

import numpy as np
import pytest
from ngsolve import CF, x, y, z

import ngvisco as nv
from ngvisco.algebra.sparse import of_blocks
from ngvisco.forms.terms.transport import Kinematics
from ngvisco.geometries import box, disc

pytestmark = pytest.mark.usefixtures("double_precision")


@pytest.fixture(params=["2D", "3D", "periodic", "constants", "quadratic", "disc"])
def split(request):
    dim = 3 if request.param == "3D" else 2
    m = {"constants": 0, "quadratic": 2}.get(request.param, 1)
    model = nv.Model(
        material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1), viscosity=nv.StokesViscosity(K_v=0.1, G_v=0.2)
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
    values = split.unknowns.pack()
    for name in ("z", "rho"):
        where = split.unknowns.slices[name]
        values[where] += 0.02 * rng.standard_normal(where.stop - where.start)
    run.rothe_step.context.tau.Set(0.01)
    where = split.unknowns.slices["v"]
    run.rothe_step.wind.vec.FV().NumPy()[:] = values[where]
    run.rothe_step.follow_wind()
    split.residual.start()
    at = split.residual(values)
    split.preconditioner.sweep.update(at)
    return split, at


def rows(sweep, own, across, values):
    return of_blocks(own, across, sweep.coupling.neighbours()) @ values


def weights(split, at):
    r = split.residual
    through = r.side_op.inner * (r.side_op.points.normals * at.facets.v.value).sum(axis=0)
    return through, at.facets.context.upwinding.share.value, r.trace_mass


def blocks_of_fields(split, at):
    through, share, mass = weights(split, at)
    return split.preconditioner.sweep.coupling.blocks(-through, share, through, mass)


def blocks_of_density(split, at):
    through, share, mass = weights(split, at)
    return split.preconditioner.sweep.coupling.blocks(0 * through, share, through, mass)


def test_rows_of_a_field(split):
    split, at = split
    sweep, r = split.preconditioner.sweep, split.residual
    own, across = blocks_of_fields(split, at)
    kinematics = [term for term in r.claims.at_points if isinstance(term, Kinematics)]
    expected = r.facet_terms.rows(kinematics, at.facets)["z"]
    assert np.abs(across).max() > 0
    for field, row in zip(at.coefficients["z"], expected, strict=True):
        assert rows(sweep, own, across, field) == pytest.approx(row, abs=1e-13 * np.abs(expected).max())


def test_rows_of_the_density(split):
    split, at = split
    sweep, where = split.preconditioner.sweep, split.unknowns.slices["rho"]
    own, across = blocks_of_density(split, at)
    own += sweep._mass / split.step.context.tau.Get() - sweep._convection(at).transpose(0, 2, 1)
    old = split.step.state_old.vec.FV().NumPy()[split.step.layout.ranges["rho"]]
    found = rows(sweep, own, across, at.x[where] - old)
    # the rows are affine in rho: their part from the old density, taken off
    x = at.x.copy()
    x[where] = old
    expected = at.residual.density - split.residual(x).residual.density
    assert found == pytest.approx(expected, abs=1e-13 * np.abs(expected).max())


def test_sweeps_approach_the_solution(split):
    """Three sweeps are the first terms of the series for T^{-1}; of the density's too."""
    split, at = split
    sweep, tau = split.preconditioner.sweep, split.step.context.tau.Get()
    own, across = blocks_of_fields(split, at)
    own += sweep._mass / tau + sweep._convection(at)
    T, r = of_blocks(own, across, sweep.coupling.neighbours()), np.ascontiguousarray(at.coefficients["z"].T)
    found = sweep.fields(r)
    once = sweep.in_cells(r)
    exact = np.linalg.solve(T.toarray(), r)
    assert np.linalg.norm(found - exact) < 0.5 * np.linalg.norm(once - exact)
    twice = once + sweep.in_cells(r - T @ once)
    thrice = twice + sweep.in_cells(r - T @ twice)
    assert found == pytest.approx(thrice, abs=1e-12 * np.abs(found).max())
    own, across = blocks_of_density(split, at)
    own += sweep._mass / tau - sweep._convection(at).transpose(0, 2, 1)
    T, r = of_blocks(own, across, sweep.coupling.neighbours()), at.coefficients["rho"] - 1.1
    x = np.zeros_like(r)
    for _ in range(sweep.sweeps):
        x += np.linalg.solve(own, (r - T @ x).reshape(*own.shape[:2], 1)).ravel()
    assert sweep.density(r[:, None])[:, 0] == pytest.approx(x, abs=1e-12 * np.abs(x).max())
