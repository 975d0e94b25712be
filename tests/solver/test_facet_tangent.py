"""Terms that couple cells across facets: their blocks are the derivative of their rows."""

import numpy as np
import pytest
from ngsolve import cos, pi, x

import ngvisco as nv
from ngvisco.geometries import box
from ngvisco.physics.variables import Concentration, ReciprocalJacobian

WALL = nv.WallExchange(potential=0.5, coefficient=2.0)
VISCOSITY = nv.StokesViscosity(K_v=0.1, G_v=0.1)


def swelling(A, c):
    """A gel whose volume follows the solute n = c J, per reference volume 10 (J - 1 - n/5)^2 + n^2/2, Pa."""
    room = 1 - A - 0.2 * c
    return 10 * room * room / A + 0.5 * c * c / A + 0.1 * A * A


def of_solute(dim):
    """A solute whose potential depends on A and c, with one permeable wall."""
    gel = nv.CustomMaterial(transported=(ReciprocalJacobian(), Concentration()), stored_energy=swelling)
    law = nv.Diffusion(variable="c", mobility=0.1, walls={"left": WALL})
    model = nv.Model(material=gel, viscosity=VISCOSITY, diffusion=law)
    start = nv.Initial(values={"c": 0.5 + 0.3 * cos(pi * x)}, density=1.0)
    mesh = box((1,) * dim, maxh=0.6 if dim == 2 else 1)
    return nv.Simulation(mesh, model, dt=0.05, initial=start, solver="split")


def applied(run, changed=lambda tangent: None):
    """Rows of z for a random increment of z, computed in two ways: by the facet blocks, and by the derivative
    of a residual that contains only the tangent's terms."""
    split = run.solver.newton
    residual, tangent = split.residual, split.preconditioner.sweep.exchange.tangent
    changed(tangent)
    run.rothe_step.context.tau.Set(0.05)
    residual.start()
    at, where, coupling = residual(split.unknowns.pack()), split.unknowns.slices["z"], tangent.coupling
    d = np.zeros_like(at.x)
    d[where] = np.random.default_rng(0).standard_normal(where.stop - where.start)
    own, across = tangent(at)
    by_cells = d[where].reshape(-1, coupling.cells, coupling.functions).transpose(1, 0, 2)
    dz = by_cells[:, tangent.columns].reshape(coupling.cells, -1, 1)
    found = own @ dz + (across @ dz[coupling.neighbours]).sum(axis=1)
    residual.at_points = residual.others = tangent.terms
    residual.carried = []
    rows = residual.derivative(at)(d)[where].reshape(-1, coupling.cells, coupling.functions)
    return found[..., 0], rows[tangent.rows].transpose(1, 0, 2).reshape(found.shape[:2])


@pytest.mark.parametrize("dim", [2, pytest.param(3, marks=pytest.mark.long)])
def test_facet_blocks_equal_the_derivative_of_the_rows(dim):
    found, expected = applied(of_solute(dim))
    assert np.linalg.norm(found - expected) <= 1e-12 * np.linalg.norm(expected)


def test_facet_blocks_without_the_last_facet_mean_differ_from_the_derivative():
    found, expected = applied(of_solute(2), lambda tangent: tangent.means.pop())
    assert np.linalg.norm(found - expected) > 0.1 * np.linalg.norm(expected)
