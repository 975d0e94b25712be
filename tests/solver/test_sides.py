"""The velocity that says which side is upstream: extrapolated, and corrected after a start from rest."""

import numpy as np
import pytest

import ngvisco as nv
from ngvisco.geometries import box
from ngvisco.solver import sides
from tests.verification.setups import lid_driven


def cavity(solver):
    """A body at rest under a lid that has full speed at once: Courant number 0.3."""
    of = nv.NeoHookean(K_e=20.0, G_e=0.05, epsilon=0.1, elastic_state="F")
    return lid_driven(box((1, 1), 0.3), of, mu=0.0, dt=0.1, solver=solver)


def velocity(run):
    step = run.rothe_step
    return step.state.vec.FV().NumPy()[step.layout.ranges["v"]].copy()


def moving(run):
    """How much of the step's velocity, where no wall prescribes it, v* has."""
    free = ~run.solver.sides._prescribed
    return np.linalg.norm(run.rothe_step.wind.vec.FV().NumPy()[free]) / np.linalg.norm(velocity(run)[free])


@pytest.mark.parametrize("solver", ["split", "coupled"])
def test_a_start_from_rest_ends_with_the_sides_of_its_own_velocity(solver, monkeypatch):
    run = cavity(solver)
    run.advance()
    assert run.solver.sides.corrections >= 1 and not run.solver.sides._is_wrong()
    assert moving(run) > 0.5
    monkeypatch.setattr(sides, "CORRECTIONS", 0)  # negative control
    monkeypatch.setattr(sides, "SETTLED", np.inf)
    run = cavity(solver)
    run.advance()
    assert moving(run) == 0.0


def test_both_solvers_find_the_same_sides():
    runs = [cavity(solver) for solver in ("split", "coupled")]
    for run in runs:
        run.advance()
    one, other = (velocity(run) for run in runs)
    assert np.linalg.norm(one - other) <= 1e-9 * np.linalg.norm(other)


def test_a_later_step_takes_the_extrapolated_velocity():
    run = cavity("split")
    run.advance()
    first = velocity(run)
    run.advance()
    expected = 2 * first - np.where(run.solver.sides._prescribed, first, 0.0)
    found = run.rothe_step.wind.vec.FV().NumPy()
    assert run.solver.sides.corrections or np.linalg.norm(found - expected) <= 1e-12 * np.linalg.norm(found)
