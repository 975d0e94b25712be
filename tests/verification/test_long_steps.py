"""What the cases of long steps count: halves as the split solver's own, what it gives up not."""

import time

import pytest

import ngvisco as nv
from ngvisco.solver.split import iteration
from ngvisco.verification.cases import long_steps
from ngvisco.verification.cases.impulsive_starts import released
from ngvisco.verification.cases.long_steps import LongRun, measured, outcome


def short(newton=long_steps.ALONE):
    return released(2.0, 0.02, newton)


def test_a_released_load_is_solved_in_whole_steps():
    """At the second one facets where the flow turns round once stopped the iteration: it was halved."""
    costs = measured(short(), 2)
    assert (costs.own, costs.halved, costs.failure) == (2, 0, "")
    assert len(costs.iterations) == 2 and max(costs.iterations) <= 30
    assert costs.closure <= 1e-12


def test_a_facet_that_increments_go_to_and_fro_across_takes_no_widths(monkeypatch):
    """The eighth step took 26 iterations, 14 of them with widened upwinding."""
    monkeypatch.setattr(iteration, "narrowed", lambda *arguments: pytest.fail("widened"))
    costs = measured(short(), 8)
    assert costs.own == 8 and max(costs.iterations) <= 18


@pytest.mark.long
def test_a_facet_that_comes_out_of_its_jump_takes_no_widths(monkeypatch):
    """The tenth step took 37 iterations, 25 of them with widened upwinding."""
    monkeypatch.setattr(iteration, "narrowed", lambda *arguments: pytest.fail("widened"))
    costs = measured(long_steps.cavity(2.0, 3, None, 0.02, long_steps.ALONE), 10)
    assert costs.own == 10 and max(costs.iterations) <= 18


def test_a_step_that_is_given_up_is_not_its_own_and_named():
    found = outcome(iter([LongRun("of two iterations", "", lambda options: short(few()), 3)]))
    assert found.values["share of the steps that the split solver solves"] == 0.0
    assert found.values["dearest step over the median of its run"] == 1.0
    assert "step 1: " in found.tables[0].rows[0][-1]


def few():
    return nv.NewtonOptions(method="split", retry_seconds=1e-3, max_iterations=2)


def test_costs_are_those_of_whole_steps(monkeypatch):
    """A clock that says 1 s for each step but 5 s for the third."""
    ticks = iter([0.0, 1.0, 10.0, 11.0, 20.0, 25.0])
    run = short()
    monkeypatch.setattr(run, "run", lambda until: None)
    monkeypatch.setattr(time, "process_time", lambda: next(ticks))
    costs = measured(run, 3)
    assert costs.seconds == [1.0, 1.0, 5.0] and costs.dearest == 5.0


@pytest.mark.parametrize("dim", [2, 3])
def test_the_grid_reaches_its_courant_numbers_and_none_above(dim):
    points = list(long_steps.points(dim))
    assert len(set(points)) == len(points) > 10
    fastest = max(points, key=lambda point: point[0] * point[1] * point[3] ** 2)
    elastic = long_steps.elastic_courant(long_steps.block_of("linearised", dim, fastest, long_steps.ALONE))
    assert 85 <= elastic <= 1.01 * long_steps.LARGEST_ELASTIC
