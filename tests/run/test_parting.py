"""Bodies that part: in cells that a body shares with a gas, an opening gap strains the gas alone."""

import numpy as np
import pytest
from ngsolve import CF, x, y, z

import ngvisco as nv
from ngvisco.errors import ParameterError
from ngvisco.forms.projections import VertexSlope
from ngvisco.geometries import box, structured_box
from ngvisco.physics.tensors import constant, opening
from ngvisco.physics.variables import Jacobian
from tests.support import assert_goes_on, assert_same, others_by_ci

SOLID = nv.ReferentialNeoHookean(K_e=2.0, G_e=0.5)
DAMPED = nv.StokesViscosity(K_v=0.02, G_v=0.02)
THIN = nv.StokesViscosity(K_v=1e-4, G_v=1e-4)


def gas(bulk):
    return nv.CustomMaterial(
        transported=(Jacobian(),), stored_energy=lambda J: bulk / 2 * (J - 1) * (J - 1) / J
    )


def pulled(parts=True, solver="split", m=0, dim=2, creep=None, **options):
    """A block on the bottom of a box, under a gas. The block fills half of the second row of cells.

    With m = 1 the gas has a fifth of the block's modulus; from a tenth on, linear amounts would overshoot.
    """
    bulk, light = ((2e-3, 1e-3), (0.4, 0.2))[m]
    mesh = structured_box((0.5, 1.0), (2, 4)) if dim == 2 else structured_box((0.5, 0.5, 1.0), (1, 1, 3))
    up = y if dim == 2 else z
    shear = 0.0 if "symmetry" in options else 0.2 * up
    block = {"name": "block", "where": 0.4 - up, "material": SOLID, "density": 1.0, "viscosity": DAMPED}
    bodies = [
        nv.Body(**block, creep=creep, parts=parts),
        nv.Body(name="gas", material=gas(bulk), density=light, viscosity=THIN),
    ]
    return nv.Simulation(
        mesh,
        nv.Model(bodies=bodies, loads=(nv.Gravity((shear, *(dim - 2) * [0.0], -0.5)),)),
        dt=0.1,
        solver=solver,
        discretisation=nv.Discretisation(k=m + 1, m=m),
        **options,
    )


SETTINGS = {
    "constants in cells": {},
    "linear in cells": {"m": 1},
    "in space": {"dim": 3},
    "linear in cells in space": {"dim": 3, "m": 1},
    "about an axis": {"symmetry": "axisymmetric"},
    "creep": {"creep": nv.Creep(G_m=1.0)},
    "midpoint": {"scheme": "midpoint"},
}


@pytest.mark.long
@pytest.mark.ci
@pytest.mark.parametrize("name", others_by_ci(SETTINGS, "about an axis"))
def test_both_solvers_agree_and_the_ledger_closes_where_bodies_part(name):
    setting = SETTINGS[name]
    runs = [pulled(solver=solver, **setting) for solver in ("split", "coupled")]
    for run in runs:
        ledger = run.run(0.2)
        assert np.abs(ledger.column("closure_relative")).max() <= 1e-12
        assert ledger.column("bregman")[1:].min() >= 0
        assert np.ptp(ledger.column("mass")) <= 1e-12 * ledger.column("mass")[0]
    assert_same(*runs)
    sticking = pulled(parts=False, **setting).run(0.2)
    stored = [np.diff(of_run.column("stored")) for of_run in (ledger, sticking)]
    assert np.abs(stored[1] / stored[0] - 1).max() > 1e-2


@pytest.mark.long
@pytest.mark.ci
def test_a_resumed_run_equals_the_uninterrupted_run_bit_for_bit(tmp_path):
    """The normals follow from the state at the start of a step, so that a resumed run computes the same
    normals."""
    assert_goes_on(pulled, tmp_path / "run.h5", 0.4, 2)


def test_an_opening_gap_strains_no_body_and_a_stretch_along_the_interface_does():
    """The rates D = n x n and D = n x t + t x n are openings. The rate D = t x t - n x n, which keeps the
    volume, is not an opening."""
    n, t = np.array([0.6, 0.8, 0.0]), np.array([-0.8, 0.6, 0.0])
    P, zero = constant(np.outer(n, n)), np.zeros((3, 3))
    mesh = box((1, 1), 1.0)
    nn, nt, tt = np.outer(n, n), np.outer(n, t) + np.outer(t, n), np.outer(t, t)
    for D, expected in ((nn, nn), (nt, nt), (tt - nn, zero)):
        entries = opening(constant(D), P)(mesh(0.5, 0.5))
        assert np.reshape(entries, (3, 3)) == pytest.approx(expected, abs=1e-14)


def test_slopes_from_vertices_are_exact_for_a_linear_function_in_cells_away_from_walls():
    mesh = structured_box((1, 1), (6, 6))
    slope = VertexSlope(mesh, 2 * x - y, periodic=False, of_slope=False)
    slope()
    assert slope.target(mesh(0.45, 0.55)) == pytest.approx((2.0, -1.0), abs=1e-12)


def test_a_linear_slope_is_recovered_from_its_means_at_vertices():
    """The means at vertices of a linear slope are its values there, in a mesh of equal cells."""
    mesh = structured_box((1, 1), (6, 6))
    slope = VertexSlope(mesh, CF((x - 2 * y, y)), periodic=False, of_slope=True)
    slope()
    for at in ((0.45, 0.55), (0.52, 0.4)):
        expected = at[0] - 2 * at[1], at[1]
        assert slope.target(mesh(*at)) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("bulk", [2.0, 20.0])
def test_a_body_that_meets_nothing_more_compressible_is_refused(bulk):
    bodies = [
        nv.Body(name="block", where=0.4 - y, material=SOLID, density=1.0, parts=True),
        nv.Body(name="gas", material=gas(bulk), density=1.0),
    ]
    with pytest.raises(ParameterError, match=r"block.*parts.*no other body is more compressible"):
        nv.Simulation(box((1, 1), 0.5), nv.Model(bodies=bodies), dt=0.1)


def test_the_option_parts_is_refused_for_a_fluid():
    bodies = [
        nv.Body(name="water", where=0.4 - y, material=gas(2.0), density=1.0, parts=True),
        nv.Body(name="gas", material=gas(1e-3), density=1.0),
    ]
    with pytest.raises(ParameterError, match=r"water.*parts.*fluid"):
        nv.Simulation(box((1, 1), 0.5), nv.Model(bodies=bodies), dt=0.1)
