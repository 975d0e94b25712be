"""Walls whose velocities alone determine div v in a corner, and a mesh in which they do not."""

import warnings

import numpy as np
import pytest
from ngsolve import x

import ngvisco as nv
from ngvisco.forms.start.data_checks import warn_of_corners
from ngvisco.geometries import split_corner_cells, structured_box
from tests.verification.setups import lid_driven


def cavity(mesh, lid, **options):
    fluid, velocity = nv.BarotropicFluid(B=20.0, gamma=1.4), (lid, 0.0, 0.0)[: mesh.dim]
    return lid_driven(mesh, fluid, lid=velocity, mu=0.0, dt=0.05, **options)


def warnings_of(run, until):
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        run.run(until)
    return [str(one.message) for one in said if one.category is nv.InputWarning]


def test_a_lid_that_is_fast_in_a_corner_cell_is_reported_with_the_rate_there():
    """Cells of 0.25 m: the lid's velocity falls from 1 m/s to 0 along one of them."""
    (said,) = warnings_of(cavity(structured_box((1, 1), (4, 4)), 1.0), 0.3)
    assert "div v = -4 1/s at (1, 1) m" in said or "div v = 4 1/s at (0, 1) m" in said
    assert "split_corners" in said


def test_nothing_is_said_of_short_runs_slow_corners_and_divided_cells():
    mesh = structured_box((1, 1), (4, 4))
    assert not warnings_of(cavity(mesh, 1.0), 0.1)  # less than e-fold
    assert not warnings_of(cavity(mesh, 0.1 * 16 * x**2 * (1 - x) ** 2), 0.1)
    assert not warnings_of(cavity(split_corner_cells(mesh), 1.0), 0.3)


def test_corners_of_tetrahedra_are_reported():
    mesh = structured_box((1, 1, 1), (2, 2, 2))
    run = cavity(mesh, 1.0)
    with pytest.warns(nv.InputWarning, match="div v"):
        warn_of_corners(run.rothe_step, [0.0, 1.0])
    run = cavity(split_corner_cells(mesh), 1.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_corners(run.rothe_step, [0.0, 1.0])


@pytest.mark.long
@pytest.mark.ci
def test_a_divided_corner_is_held_by_the_pressure():
    """In the corner cell under the lid, of 0.33 m, the density rises e-fold in 0.33 s."""
    change = {}
    for split in (False, True):
        run = cavity(structured_box((1, 1), (3, 3), split_corners=split), 1.0)
        run.run(0.5)
        density = run.sampler.values(run.fields["density"])
        change[split] = np.abs(density - 1).max()
        assert np.abs(run.ledger.column("closure_relative")).max() < 1e-10
    assert change[False] > 1 > 0.4 > change[True]
