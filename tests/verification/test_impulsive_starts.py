"""First steps of impulsive starts: their iterations, and what the case counts of them."""

from functools import partial

import pytest

import ngvisco as nv
from ngvisco.verification.cases import impulsive_starts
from ngvisco.verification.cases.impulsive_starts import DT, MOST, Start, first_step, outcome, released


@pytest.mark.parametrize(("name", "most"), [("p = 2", 13), ("p = 4", 18)])
def test_a_lid_of_full_speed_starts_by_the_split_solver_in_a_whole_step(name, most):
    """230 triangles: 10 and 15 iterations; 218 and the coupled solver were reported once."""
    starts = {start.name: start for start in impulsive_starts.starts()}
    found = first_step(starts[f"lid, h = 0.1, {name}"].make())
    assert (found.parts, found.retries, found.rejected, found.failure) == (1, 0, 0, "")
    assert 0 < found.iterations <= most < MOST
    assert found.closure <= 1e-12


def few(iterations):
    """A released load, which takes 14 iterations, with so many at most and without a coupled solver."""
    options = nv.NewtonOptions(method="split", retry_seconds=1e-3, max_iterations=iterations)
    return released(2.0, DT, options)


def test_what_was_rejected_counts_beside_the_step_that_is_solved():
    """With twelve iterations its halves fail too: it is solved at last with upwinding that is narrowed."""
    found = outcome([Start("of twelve iterations", partial(few, 12), of_lid=False)])
    whole, rejected = found.tables[0].rows[0][2:4]
    assert whole - 12 > rejected >= 3 * 12
    assert found.values["most iterations of another first step"] == whole
    assert found.values["most iterations of a first step under a lid"] == 0
    assert found.values["first steps that are not solved"] == 0


def test_a_start_that_is_not_solved_is_counted_and_named():
    found = outcome([Start("of two iterations", partial(few, 2))])
    assert found.values["first steps that are not solved"] == 1
    assert found.values["most iterations of a first step under a lid"] >= 2 * 4
    assert "was not tried" in found.tables[0].rows[0][-1]
