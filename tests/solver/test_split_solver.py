"""The split solver by itself: messages of failures, the choice of the solver, and its parts."""

from dataclasses import replace

import numpy as np
import pytest
from ngsolve import CF, cos, pi, sin, x, y
from ngsolve.meshes import MakeStructured2DMesh
from scipy.sparse.linalg import LinearOperator, gmres
from support import SWIRL, by_ci, state

import ngvisco as nv
from ngvisco.algebra import precision
from ngvisco.algebra.factorised import DirectSolver, TwoLevelSolver
from ngvisco.forms.term import Integrand
from ngvisco.geometries import box, disc
from ngvisco.solver.options import SplitOptions
from ngvisco.solver.problem import Status
from ngvisco.solver.rothe import Interval
from ngvisco.solver.split import solver as split_solver
from ngvisco.solver.split.hyperviscosity import hyper_matrix
from ngvisco.solver.split.solver import Split
from ngvisco.solver.split.transport import LEAST


def simulation(maxh=0.4, mesh=None, hyperviscosity=None, regularisation=None, speed=0.0, **options):
    mesh = mesh or box((1, 1), maxh=maxh)
    model = nv.Model(
        material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1, elastic_state="F"),
        viscosity=nv.StokesViscosity(K_v=0.1, G_v=0.1),
        hyperviscosity=hyperviscosity or nv.HyperViscosity(mu=1e-4, p=4),
        creep=nv.Creep(G_m=2.0),
        loads=[nv.Gravity((0.0,) * (mesh.dim - 1) + (-1.0,))],
        regularisation=regularisation,
    )
    velocity = (*SWIRL, CF(0))[: mesh.dim]
    if speed:
        velocity = (speed + 0.3 * sin(2 * pi * y), 0.3 * sin(2 * pi * x) * sin(2 * pi * y))
    options = {"solver": "split", "dt": 0.02, "initial": nv.Initial(velocity=velocity)} | options
    return nv.Simulation(mesh, model, **options)


TWO_LEVELS = nv.NewtonOptions(split=SplitOptions(direct_up_to=(0, 0)))


def taken(run):
    """Take a step of a run, and return the attempts."""
    advance, steps = run.integrator.advance, []
    run.integrator.advance = lambda *arguments: steps.append(advance(*arguments)) or steps[-1]
    run.advance()
    del run.integrator.advance
    return steps[-1].history


def first_step(run):
    """The problem of a run's first step."""
    return run.solver.problem(Interval(run.dt, 0.0, run.dt, 0.0, run.dt))


@pytest.mark.usefixtures("double_precision")
@pytest.mark.parametrize(("k", "p"), [(2, 4.0), (3, 4.0), (2, 2.0), (2, 3.5)])
def test_the_derivative_of_the_hyperviscosity_equals_differences_of_its_rows(k, p):
    """The derivative of the penalty is integrated by a rule of its own. This rule is not exact if the
    derivative is not a polynomial."""
    run = simulation(hyperviscosity=nv.HyperViscosity(mu=1e-3, p=p), discretisation=nv.Discretisation(k=k))
    run.advance()
    split = run.solver.newton
    hyper, derivative = split.residual.hyper, split.preconditioner.operator.derivative
    now = split.residual(split.unknowns.pack()).coefficients
    rng = np.random.default_rng(1)
    dv, da = rng.standard_normal(now["v"].shape), rng.standard_normal(now["a"].shape)
    # v has curvature, so that its jumps are not much larger than the curvature
    v, a, z = now["v"] + 1e-3 * dv, now["a"], now["z"]
    derivative.update(hyper(v, a, z))
    expected = derivative(np.concatenate([dv, da], axis=1))
    rows = [hyper(v + h * dv, a + h * da, z).rows for h in (1e-6, -1e-6)]
    quotient = (rows[0] - rows[1]) / 2e-6
    bound = 1e-4 if p == 3.5 else 1e-8  # a rule of degree 4 is right for (P_1 jumps)^4
    assert np.linalg.norm(quotient - expected) <= bound * np.linalg.norm(quotient)
    # the tangent of small meshes has the same derivative as a matrix
    product = hyper_matrix(derivative, dv.size)() @ np.concatenate([dv.ravel(), da.ravel()])
    of_v, of_a = np.split(expected, [dv.shape[1]], axis=1)
    both = np.concatenate([of_v.ravel(), of_a.ravel()])
    assert np.linalg.norm(product - both) <= 1e-12 * np.linalg.norm(both)


def test_normal_derivatives_in_the_tangent_save_directions(monkeypatch):
    counts = []
    for is_joined in (True, False):
        if not is_joined:
            monkeypatch.setattr("ngvisco.solver.split.preconditioner.JOINED", 0)
        run = simulation(maxh=0.2)
        solver, directions = run.solver.newton.preconditioner, []
        solve = solver._flow

        def counted(*arguments, solver=solver, solve=solve, directions=directions):
            result = solve(*arguments)
            directions.append(solver.iterations)
            return result

        solver._flow = counted
        for _ in range(3):
            run.advance()
        counts.append(sum(directions))
    assert counts[0] <= 0.75 * counts[1]


@pytest.mark.long
@pytest.mark.ci
@pytest.mark.parametrize("speed", [1.0, 3e3])
def test_single_precision_takes_as_many_iterations_as_double_precision(speed, monkeypatch):
    """One body moves fast as a whole, so that jumps and strains are small differences of large velocities."""

    def iterations():
        run = simulation(
            maxh=0.2, mesh=box((1, 1), maxh=0.2, periodic="x"), speed=speed, dt=0.02 if speed == 1.0 else 5e-5
        )
        taken = [run.advance()["newton_iterations"] for _ in range(3)]
        return sum(taken)

    single = iterations()
    monkeypatch.setattr(precision, "SINGLE", np.float64)
    assert single <= iterations() + 1


def in_units_of(length, density, seconds, newton=None):
    """The swirl in a box of size 1, in the given units."""
    modulus = density * (length / seconds) ** 2
    model = nv.Model(
        material=nv.NeoHookean(
            K_e=10.0 * modulus, G_e=5.0 * modulus, epsilon=0.1 * modulus, elastic_state="F"
        ),
        viscosity=nv.StokesViscosity(K_v=0.1 * modulus * seconds, G_v=0.1 * modulus * seconds),
        hyperviscosity=nv.HyperViscosity(mu=1e-4 * modulus * length**4 * seconds**3, p=4),
        creep=nv.Creep(G_m=2.0 * modulus * seconds),
        loads=[nv.Gravity((0.0, -length / seconds**2))],
    )
    X, Y = pi * x / length, pi * y / length
    speed = length / seconds
    swirl = nv.Initial(velocity=(speed * sin(X) * cos(Y), -speed * cos(X) * sin(Y)), density=density)
    mesh = MakeStructured2DMesh(quads=False, nx=4, ny=4, mapping=lambda X, Y: (length * X, length * Y))
    return nv.Simulation(mesh, model, dt=0.02 * seconds, initial=swirl, newton=newton, solver="split")


LARGE, SMALL, SMALLER = (1e5, 9e20, 3e10), (1e-6, 1e3, 1e-9), (1e-8, 1e3, 1e-11)


@pytest.mark.parametrize(
    ("units", "levels"),
    [
        (LARGE, 1),
        pytest.param(SMALLER, 2, marks=[pytest.mark.long, pytest.mark.ci]),
        *(
            pytest.param(*case, marks=pytest.mark.long)
            for case in ((LARGE, 2), (SMALL, 1), (SMALL, 2), (SMALLER, 1))
        ),
    ],
)
def test_single_precision_does_not_depend_on_the_units(units, levels):
    """With 1e10 Pa, 100 km and a thousand years mu is 1e57, which exceeds single precision."""
    newton = TWO_LEVELS if levels == 2 else None
    one, other = in_units_of(1.0, 1.0, 1.0, newton=newton), in_units_of(*units, newton=newton)
    for run in (one, other):
        run.run(0.06 * (1.0 if run is one else units[2]))
    assert np.abs(other.ledger.column("closure_relative")).max() <= 1e-12
    iterations = [run.ledger.column("newton_iterations") for run in (one, other)]
    assert np.abs(iterations[0] - iterations[1]).max() <= 1
    where = one.rothe_step.layout.ranges["v"]
    here, there = state(one)[where], state(other)[where] * units[2] / units[0]
    assert np.linalg.norm(here - there) <= 1e-8 * np.linalg.norm(here)


def test_auto_chooses_by_dimension_and_size():
    small, large = simulation(solver="auto"), simulation(maxh=0.05, solver="auto")
    assert small.mesh.ne < SplitOptions().chosen_from[0] <= large.mesh.ne
    assert not isinstance(small.solver.newton, Split)
    assert isinstance(large.solver.newton, Split)


def test_quadrilaterals_need_the_coupled_solver():
    mesh = MakeStructured2DMesh(quads=True, nx=2, ny=2)
    assert not isinstance(simulation(mesh=mesh, solver="auto").solver.newton, Split)
    with pytest.raises(nv.ParameterError, match="triangles or tetrahedra"):
        simulation(mesh=mesh)


class Source:
    """A term made by a function of the unknowns and the tests."""

    def __init__(self, integrand):
        self.integrand = integrand

    def form(self, u, w):
        return [self.integrand(u, w)]

    def entries(self, u):
        return []


REFUSED = {
    "a source reads the unknown v": lambda u, w: Integrand(u.v * w.v),
    "a source reads the unknown rho": lambda u, w: Integrand(u.grad_rho[0] * w.rho),
    "a source has a row of zeta": lambda u, w: Integrand(w.zeta[0]),
    "a source has a row of z_hat": lambda u, w: Integrand(facets=w.z_hat[0]),
}


@pytest.mark.parametrize("reason", REFUSED)
def test_sources_in_the_rows_of_derived_unknowns_need_the_coupled_solver(reason):
    source = Source(REFUSED[reason])
    with pytest.raises(nv.ParameterError, match=reason):
        simulation(sources=source)
    assert not isinstance(simulation(maxh=0.05, sources=source, solver="auto").solver.newton, Split)


@pytest.mark.parametrize("k", [2, by_ci(3)])
def test_two_levels_give_the_solution_of_the_direct_solver(k):
    order = nv.Discretisation(k=k)
    direct = simulation(discretisation=order)
    two_level = simulation(discretisation=order, newton=TWO_LEVELS)
    assert isinstance(two_level.solver.newton.preconditioner.solver, TwoLevelSolver)
    for run in (direct, two_level):
        run.run(0.04)
    assert np.linalg.norm(state(two_level) - state(direct)) <= 1e-9 * np.linalg.norm(state(direct))


@pytest.mark.long
@pytest.mark.ci
def test_increments_are_solved_only_as_exactly_as_the_iteration_needs(monkeypatch):
    """The last increments take fewer directions. The number of iterations stays, and the solution is as exact
    as required."""
    loosest, runs = split_solver._LOOSEST, []
    for bound, tolerance in ((loosest, 1e-10), (0.0, 1e-10), (0.0, 1e-13)):
        monkeypatch.setattr(split_solver, "_LOOSEST", bound)
        options = replace(TWO_LEVELS, tolerance=tolerance)
        run = simulation(mesh=box((1, 1, 1), maxh=0.5), newton=options)
        used, newton = systems(run), run.solver.newton
        runs.append((run.advance(), newton.unknowns.pack(), *zip(*used, strict=True)))
    (row, state, loose, directions), (strict_row, _, strict, more), (_, solution, _, _) = runs
    assert row["newton_iterations"] == strict_row["newton_iterations"]
    assert loose[:3] == strict[:3] and loose[:3] == (split_solver._FORCING[True],) * 3
    assert strict[-1] < loose[-1] <= 0.03
    assert all(abs(few - many) <= 1 for few, many in zip(directions[:3], more[:3], strict=True))
    assert sum(directions) <= sum(more) - 3
    assert newton.size(state - solution) <= 3e-11  # 3e-11 is a third of the tolerance
    assert abs(row["closure_relative"]) <= 1e-12


def systems(run):
    """Tolerances of the flow's linear systems, and the directions that they take."""
    preconditioner, used = run.solver.newton.preconditioner, []

    class Noted(type(preconditioner)):
        def __call__(self, at, tolerance, *more):
            increment = super().__call__(at, tolerance, *more)
            used.append((tolerance, self.iterations))
            return increment

    preconditioner.__class__ = Noted
    return used


@pytest.mark.long
@pytest.mark.ci
def test_the_whole_tangent_is_factorised_if_two_levels_fail():
    """The whole tangent is factorised for the rest of the step if it is small enough. The next step begins
    with two levels again."""
    few = SplitOptions(direct_up_to=(0, 0), flow_iterations=3)
    runs = [
        simulation(newton=nv.NewtonOptions(split=options))
        for options in (SplitOptions(), few, replace(few, direct_at_most=(10, 10)))
    ]
    used = [updates(run) for run in runs]
    for run in runs:
        run.advance()
    whole, *others = (state(run) for run in runs)
    for other in others:
        assert np.linalg.norm(other - whole) <= 1e-9 * np.linalg.norm(whole)
    took = [run.ledger.column("newton_iterations")[-1] for run in runs]
    assert took[1] < took[2]
    assert set(used[0]) == {DirectSolver} and set(used[2]) == {TwoLevelSolver}
    first = used[1].index(DirectSolver)
    assert first > 0 and set(used[1][:first]) == {TwoLevelSolver} and set(used[1][first:]) == {DirectSolver}
    assert not runs[1].solver.newton.is_factorised
    used[1].clear()
    runs[1].advance()
    assert used[1][0] is TwoLevelSolver


def updates(run):
    """The kinds of solver of the velocity tangent, one for each time that the tangent is formed."""
    preconditioner, kinds = run.solver.newton.preconditioner, []
    update = preconditioner.update

    def noted(*arguments):
        kinds.append(type(preconditioner.solver))
        update(*arguments)

    preconditioner.update = noted
    return kinds


@pytest.mark.long
@pytest.mark.ci
def test_two_levels_take_as_many_iterations_on_finer_meshes():
    counts = []
    for maxh in (0.3, 0.15, 0.075):
        run = simulation(maxh=maxh, newton=TWO_LEVELS)
        run.advance()
        split = run.solver.newton
        p, at, steps = split.preconditioner, split.residual(split.unknowns.pack()), []
        p.linearise(at, True)
        matrix = p.operator.tangent(at, p.hyper_tangent)
        p.solver.factorise(matrix)
        r = np.where(p.free, np.random.default_rng(0).standard_normal(len(p.free)), 0.0)
        operator = LinearOperator(
            (len(r), len(r)), lambda x, p=p, A=matrix: p.solver(np.where(p.free, A @ x, x))
        )
        gmres(operator, p.solver(r), rtol=1e-6, restart=100, callback=steps.append, callback_type="pr_norm")
        counts.append(len(steps))
    assert counts[2] <= 1.3 * counts[0]


@pytest.mark.long
@pytest.mark.ci
def test_wall_stresses_add_few_iterations_to_the_solver_with_two_levels():
    """If the coarse problem lacks the walls' velocities, steps take twice as many iterations."""

    def iterations(newton):
        run = simulation(mesh=disc(1.0, maxh=0.3), newton=newton)
        preconditioner, counts = run.solver.newton.preconditioner, []
        flow = preconditioner._flow

        def counted(*arguments):
            increment = flow(*arguments)
            counts.append(preconditioner.iterations)
            return increment

        preconditioner._flow = counted
        run.advance()
        return sum(counts)

    assert iterations(TWO_LEVELS) <= 1.4 * iterations(None)


@pytest.mark.long
@pytest.mark.ci
def test_the_number_of_sweeps_grows_with_the_courant_number_and_no_step_is_retried():
    """At large Courant numbers increments need more than three sweeps of the transport, and solutions of the
    systems of the fields."""
    run = simulation(mesh=box((1, 1), maxh=0.2, periodic="x"), speed=300.0, dt=1e-3)
    rows = [run.advance() for _ in range(2)]
    assert rows[0]["cfl"] > 1.9 and min(row["cfl"] for row in rows) > 1.5
    assert max(row["rejections"] for row in rows) == 0
    assert max(row["newton_iterations"] for row in rows) <= 25
    assert max(abs(row["closure_relative"]) for row in rows) <= 1e-12
    assert run.solver.newton.preconditioner.sweep.sweeps > LEAST


@pytest.mark.parametrize("speed", [1e20, 1e40])
def test_a_diverging_iterate_gives_a_status_and_no_warning(speed):
    run = simulation()
    guess = run.rothe_step.state_old.vec.CreateVector()
    guess.data = run.rothe_step.state_old.vec
    velocity = guess.FV().NumPy()[run.solver.newton.unknowns.ranges["v"]]
    velocity += speed * np.random.default_rng(1).standard_normal(velocity.shape)
    solution = run.solver.newton.solve(first_step(run), guess)
    assert solution.status is not Status.CONVERGED
