"""First steps of impulsive starts: their iterations, and what the case counts of them."""

import pytest

import ngvisco as nv
from ngvisco.solver.solution import Attempt, NewtonIteration, Solution, Status
from ngvisco.verification.cases import impulsive_starts
from ngvisco.verification.cases.impulsive_starts import DT, MOST, Start, first_step, outcome, released

LINE = NewtonIteration(increment=1.0, contraction=1.0, damping=1.0, fresh_jacobian=True)


@pytest.mark.parametrize(("name", "most"), [("p = 2", 13), ("p = 4", 18)])
def test_a_lid_of_full_speed_starts_by_the_split_solver_in_a_whole_step(name, most):
    """230 triangles: 10 and 15 iterations; 218 and the coupled solver were reported once."""
    starts = {start.name: start for start in impulsive_starts.starts()}
    found = first_step(starts[f"lid, h = 0.1, {name}"].make())
    assert (found.parts, found.retries, found.rejected, found.failure) == (1, 0, 0, "")
    assert 0 < found.iterations <= most < MOST
    assert found.closure <= 1e-12


def test_what_was_rejected_counts_beside_the_parts(monkeypatch):
    """The whole step is given up after seven iterations: its halves are solved."""
    run = released(2.0, DT, nv.NewtonOptions())
    advance, lengths = run.integrator.advance, []

    def stalls_at_first(t, tau, *others):
        lengths.append(tau)
        if len(lengths) == 1:
            raise nv.StepError("it stalls", [Attempt("split", Solution(Status.STALLED, (LINE,) * 7))])
        return advance(t, tau, *others)

    monkeypatch.setattr(run.integrator, "advance", stalls_at_first)
    found = outcome([Start("in halves", lambda: run, of_lid=False)])
    whole, rejected, parts = found.tables[0].rows[0][2:5]
    assert lengths == [DT, DT / 2, DT / 2] and (rejected, parts) == (7, 2)
    assert whole == 7 + run.ledger.column("newton_iterations").sum() > 7
    assert found.values["most iterations of another first step"] == whole
    assert found.values["most iterations of a first step under a lid"] == 0
    assert found.values["first steps that are not solved"] == 0


def hopeless():
    """Two iterations at most, and no coupled solver."""
    return released(2.0, DT, nv.NewtonOptions(method="split", retry_seconds=1e-3, max_iterations=2))


def test_a_start_that_is_not_solved_is_counted_and_named():
    found = outcome([Start("of two iterations", hopeless)])
    assert found.values["first steps that are not solved"] == 1
    assert found.values["most iterations of a first step under a lid"] >= 2 * 4
    assert "was not tried" in found.tables[0].rows[0][-1]
