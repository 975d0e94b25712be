"""A failed iteration names the terms that stand against it."""

from dataclasses import replace

import numpy as np
import pytest

import ngvisco as nv
from ngvisco.forms.term_rows import LINEAR, TermRows
from ngvisco.geometries import box
from ngvisco.reduced.rows_by_terms import REST, by_terms
from ngvisco.solver.options import SplitOptions
from ngvisco.solver.problem import Interval
from ngvisco.solver.solution import Status
from ngvisco.solver.split.resistance import resistance

LID = {"top": nv.PrescribedTangential((1.0, 0.0)), ("left", "right", "bottom"): nv.NoSlip()}


def cavity(mu=1e-5, p=4, **split):
    """A body at rest under a lid that moves."""
    model = nv.Model(
        material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1, elastic_state="F"),
        viscosity=nv.StokesViscosity(K_v=0.1, G_v=0.1),
        hyperviscosity=nv.HyperViscosity(mu=mu, p=p),
    )
    split = {"forcing": 1e-3, "coupled_up_to": (1, 1)} | split  # linear systems are solved
    options = nv.NewtonOptions(max_iterations=4, split=SplitOptions(**split))
    return nv.Simulation(
        box((1, 1), 0.3), model, dt=0.02, walls=LID, solver="split", newton=options, halvings=0
    )


def first_step(run):
    return run.solver.problem(Interval(run.dt, 0.0, run.dt, 0.0, run.dt))


def best(run):
    """The best evaluation and its increment of a first step that is given up."""
    solution = run.solver.newton.solve(first_step(run), run.rothe_step.state.vec)
    assert solution.status is Status.TOO_MANY_ITERATIONS
    return run.solver.newton._best[:2]


def test_the_terms_rows_are_those_of_the_residual():
    """All of them, without walls by multipliers; of the derivative too."""
    run = cavity()
    split = run.solver.newton
    at, _ = best(run)
    at = split.residual(at.x)
    parts = by_terms(split.residual, at)
    whole = np.concatenate(at.residual.parts())
    assert np.abs(parts.pop(REST)).max() <= 1e-12 * max(np.abs(part).max() for part in parts.values())
    assert np.abs(sum(parts.values()) - whole).max() <= 1e-11 * np.abs(whole).max()
    assert {"hyperviscosity", "elastic force", "elastic force across facets", "kinematics"} <= set(parts)


@pytest.mark.parametrize(("mu", "p", "named"), [(10.0, 4, True), (1e-9, 2, False)])
def test_a_strong_power_of_the_hyperviscosity_is_named(mu, p, named):
    run = cavity(mu, p)
    sizes = resistance(run.solver.newton, *best(run))
    assert (max(sizes, key=sizes.get) == "hyperviscosity") == named


def test_a_linear_system_that_is_not_solved_is_named():
    run = cavity(1e-9, 2, forcing=0.9)
    sizes = resistance(run.solver.newton, *best(run))
    assert max(sizes, key=sizes.get) == LINEAR


def test_the_error_and_the_report_name_the_term():
    with pytest.raises(nv.StepError, match=r"against it stand, .*: hyperviscosity \(0\.") as caught:
        cavity(mu=10.0).advance()
    assert "hyperviscosity (0." in str(caught.value.report)


def coupled(mu, p, **options):
    """The same by the coupled solver."""
    model = replace(cavity(mu, p).model, hyperviscosity=nv.HyperViscosity(mu=mu, p=p))
    newton = nv.NewtonOptions(method="coupled", **options)
    return nv.Simulation(box((1, 1), 0.5), model, dt=0.02, walls=LID, newton=newton)


def test_the_terms_forms_add_up_to_the_residual():
    """And what Newton's increment leaves of them to what it leaves of it, to the slopes' rounding."""
    run = coupled(1e-3, 4)
    step = run.rothe_step
    newton, problem = run.solver.newton, first_step(run)
    problem.pose()
    step.eliminate()
    u, f, whole = (step.state.vec.CreateVector() for _ in range(3))
    u.data = step.state.vec
    step.residual.Apply(u, whole)
    newton.factorise(problem)
    newton.jacobian.solve(whole, f)
    rows = TermRows(step)
    parts = rows(u)
    largest = max(part.Norm() for part in parts.values())
    for part in parts.values():
        whole.data -= part
    assert whole.Norm() <= 1e-12 * largest
    size = newton.norm(f, u)
    left = rows.left_by(u, f, size)
    newton.jacobian.solve(left[LINEAR], f)  # its rows of walls are reactions
    assert newton.norm(f, u) <= 1e-6 * size
    u.data = step.state.vec
    step.residual.Apply(u, whole)
    for part in left.values():
        whole.data -= part
    assert whole.Norm() <= 1e-12 * largest


@pytest.mark.parametrize(("mu", "p", "named"), [(10.0, 4, True), (1e-9, 2, False)])
def test_the_coupled_solver_names_its_terms_too(mu, p, named):
    """On a mesh that it alone takes, by one more factorisation."""
    run = coupled(mu, p, max_iterations=1)
    with pytest.raises(nv.StepError, match="against it stand, in units of the smallest increment") as caught:
        run.advance()
    assert ("increment: hyperviscosity" in str(caught.value)) == named
