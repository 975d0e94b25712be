"""The ledger's column of motion that no variable feels, and its warning."""

import warnings

import numpy as np
import pytest
from ngsolve import pi, sin, x, y
from support import small_run

import ngvisco as nv
from ngvisco.forms.unfelt import UNFELT
from ngvisco.geometries import structured_box

SMOOTH = {"velocity": (0.1 * sin(pi * x) * y, -0.1 * sin(pi * y) * x), "density": 2.0}


def run_of(k, m, cells=(4, 4), solver="coupled", **start):
    space, mesh = nv.Discretisation(k=k, m=m), structured_box((1, 1), cells)
    return small_run(mesh, discretisation=space, solver=solver, **(SMOOTH | start))


@pytest.mark.parametrize(("k", "m"), [(2, 0), (3, 0), (3, 1), (2, 1), (3, 2)])
def test_the_column_is_of_orders_that_feel_not_all(k, m):
    run = run_of(k, m)
    with warnings.catch_warnings():
        warnings.simplefilter("error", nv.InputWarning)
        run.advance()
    assert (UNFELT in run.ledger.columns) == (m < k - 1)
    if m < k - 1:
        unfelt, kinetic = run.ledger.column(UNFELT), run.ledger.column("kinetic")
        assert (unfelt > 0).all() and (unfelt < 0.02 * kinetic).all()


def test_of_smooth_motion_it_falls_with_the_fourth_power_of_the_cells():
    sizes = [run_of(2, 0, (n, n)).ledger.start(0.0)[UNFELT] for n in (4, 8)]
    assert 12 < sizes[0] / sizes[1] < 20


def test_motion_within_cells_is_measured_and_said_once():
    """A velocity of edges alone, random."""
    run = run_of(2, 0)
    v = run.rothe_step.state.components[run.rothe_step.layout.names.index("v")]
    values = v.vec.FV().NumPy()
    vertices, count = run.mesh.nv, len(values) // 2
    for i in range(2):
        values[i * count : i * count + vertices] = 0.0
    values[:] += np.random.default_rng(0).uniform(-1, 1, len(values)) * (
        np.arange(len(values)) % count >= vertices
    )
    with pytest.warns(
        nv.InputWarning, match="of the kinetic energy is motion within cells that nothing feels"
    ) as said:
        row = run.ledger.start(0.0)
        run.ledger.state()
    assert len(said) == 1 and 0.1 * row["kinetic"] < row[UNFELT] < row["kinetic"]
