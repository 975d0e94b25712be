"""The strategies of a step: the list that is tried, its history, and paths of continuation."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from ngsolve import BaseVector, cos, pi, sin, x, y

import ngvisco as nv
from ngvisco.geometries import box
from ngvisco.solver.newton import Newton
from ngvisco.solver.options import SplitOptions
from ngvisco.solver.rothe import Interval
from ngvisco.solver.solution import Solution, Status
from ngvisco.solver.split.solver import Split
from ngvisco.solver.strategies import (
    LENGTHS,
    WIDTHS,
    ContinuationPath,
    Effort,
    FromExtrapolation,
    FromStartValue,
    LengthContinuation,
    Strategy,
    UpwindingContinuation,
)

CONVERGED, FAILED = Solution(Status.CONVERGED), Solution(Status.STALLED, (), "Newton did not converge")
COUPLED = ["coupled", "coupled, wide upwinding", "coupled, growing step"]
SPLIT = ["split, extrapolated start", "split", "split, wide upwinding"]


def simulation(dt=0.05, speed=1.0, solver="coupled", **options):
    model = nv.Model(
        material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1),
        viscosity=nv.StokesViscosity(K_v=0.01, G_v=0.01),
        hyperviscosity=nv.HyperViscosity(mu=1e-3, p=4),
    )
    swirl = (speed * sin(pi * x) * cos(pi * y), -speed * cos(pi * x) * sin(pi * y))
    initial = nv.Initial(velocity=swirl)
    return nv.Simulation(box((1, 1), 0.5), model, dt=dt, initial=initial, solver=solver, **options)


def values(run):
    return run.rothe_step.state.vec.FV().NumPy().copy()


def assert_same(one, other):
    """rho, v and z of two runs, but for what the tolerance leaves."""
    for name in ("v", "rho", "z"):
        a, b = (values(run)[run.rothe_step.layout.ranges[name]] for run in (one, other))
        assert np.linalg.norm(a - b) <= 1e-9 * np.linalg.norm(a), name


def step(run, efforts=Effort.ALL):
    """The history of the next step."""
    return run.integrator.advance(run.t, run.dt, efforts=efforts).history


def only(solves):
    """A solver's ``solve`` that solves the problems for which ``solves(problem, full_steps)`` holds."""

    def solve(self, problem, guess, full_steps=None):
        problem.pose()
        return CONVERGED if solves(problem, full_steps) else FAILED

    return solve


def names(history):
    return list(dict.fromkeys(attempt.strategy for attempt in history))


# --- the contract of both solvers -----------------------------------------------------------------------


@pytest.mark.parametrize("solver", ["coupled", "split"])
def test_a_solver_that_does_not_converge_answers_with_a_reason(solver):
    run = simulation(solver=solver, newton=nv.NewtonOptions(max_iterations=2, tolerance=1e-14))
    problem = run.solver.problem(Interval(0.05, 0.0, 0.05, 0.0, 0.05))
    solution = run.solver.newton.solve(problem, run.rothe_step.state_old.vec)
    assert not solution.converged and solution.status is Status.TOO_MANY_ITERATIONS
    assert len(solution.history) == 2
    assert "did not converge (too many iterations; 2 iterations" in solution.reason


@pytest.mark.parametrize("solver", ["coupled", "split"])
def test_a_solver_answers_a_guess_that_is_no_number(solver):
    run = simulation(solver=solver)
    guess = run.rothe_step.state.vec.CreateVector()
    guess.FV().NumPy()[:] = np.nan
    solution = run.solver.newton.solve(run.solver.problem(Interval(0.05, 0.0, 0.05, 0.0, 0.05)), guess)
    assert solution.status is Status.NOT_FINITE and solution.reason


@pytest.mark.parametrize("solver", ["coupled", "split"])
def test_a_solver_needs_no_call_before_it_is_asked(solver):
    """The problem sets the step's parameters; the solution is the same as the time loop's."""
    run, other = simulation(solver=solver), simulation(solver=solver)
    run.advance()
    start = other.rothe_step.state.vec.CreateVector()
    start.data = other.rothe_step.state.vec
    other.rothe_step.state.vec.FV().NumPy()[:] = 0.0
    problem = other.solver.problem(Interval(0.05, 0.0, 0.05, 0.0, 0.05))
    assert other.solver.newton.solve(problem, start).converged
    assert_same(run, other)


def test_the_split_solver_says_that_it_takes_no_undamped_steps():
    run = simulation(solver="split")
    problem = run.solver.problem(Interval(0.05, 0.0, 0.05, 0.0, 0.05))
    solution = run.solver.newton.solve(problem, run.rothe_step.state_old.vec, full_steps=3)
    assert solution.status is Status.NOT_TRIED and "full steps" in solution.reason


# --- the list -------------------------------------------------------------------------------------------


def test_the_default_lists_end_with_the_coupled_solver():
    assert [one.name for one in simulation().solver.strategies] == COUPLED
    split = simulation(solver="split").solver.strategies
    assert [one.name for one in split] == [*SPLIT, *COUPLED]
    assert [one.effort for one in split[3:]] == [Effort.OTHER_SOLVER] * 3


def test_a_stiff_long_step_is_solved_with_wide_upwinding():
    """By no other means: the history says what failed before, for which problem and why."""
    history = step(simulation(dt=3.0, speed=3.0))
    assert names(history) == COUPLED[:2]
    assert "no step length" in history[0].solution.reason
    widths = [attempt.width for attempt in history if attempt.solution.converged]
    assert widths[-1] == 1 and max(widths) == 1e4
    assert min(attempt.length for attempt in history) < 1
    assert [attempt.solution.converged for attempt in history[-4:]] == [True] * 4


def test_a_list_of_the_user_s_is_honoured():
    """The same step by growing lengths at once, without wide upwinding between."""
    mine = (FromStartValue(name="mine"), LengthContinuation(name="longer and longer"))
    run = simulation(dt=3.0, speed=3.0, strategies=mine)
    history = step(run)
    assert names(history) == ["mine", "longer and longer"]
    lengths = [attempt.length for attempt in history if attempt.solution.converged]
    assert len(lengths) > 1 and lengths == sorted(lengths) and lengths[-1] == 1
    assert {attempt.width for attempt in history} == {1.0}


def test_a_strategy_of_the_user_s_own_kind_is_tried():
    @dataclass(frozen=True, kw_only=True)
    class FromHalf(Strategy):
        def solve(self, task):
            half = task.start.CreateVector()
            half.data = task.start
            half.FV().NumPy()[:] *= 0.5
            return task.attempt(task.problem, half)

    run, plain = simulation(strategies=[FromHalf(name="from half of it")]), simulation()
    assert names(step(run)) == ["from half of it"]
    step(plain)
    assert_same(run, plain)


def test_a_solution_of_another_problem_is_not_the_step_s():
    @dataclass(frozen=True, kw_only=True)
    class StopsHalfWay(Strategy):
        def solve(self, task):
            return task.attempt(task.problem.widened(100.0), task.start)

    history = step(simulation(strategies=[StopsHalfWay(name="wide"), FromStartValue(name="sharp")]))
    assert [attempt.solution.converged for attempt in history] == [True, True]
    assert names(history) == ["wide", "sharp"] and history[-1].width == 1


def test_every_coupled_strategy_is_tried_in_order(monkeypatch):
    run = simulation()
    before = values(run)
    monkeypatch.setattr(Newton, "solve", only(lambda problem, full_steps: False))
    with pytest.raises(nv.StepError, match="Newton did not converge") as error:
        run.advance()
    assert names(error.value.history) == COUPLED
    assert {attempt.solution.reason for attempt in error.value.history} == {FAILED.reason}
    assert np.array_equal(values(run), before)
    assert run.rothe_step.context.eta.Get() == 1e-4 * run.velocity_scale


def test_full_steps_end_a_path_that_folds(monkeypatch):
    run = simulation()
    monkeypatch.setattr(Newton, "solve", only(lambda problem, full_steps: problem.width >= 30 or full_steps))
    history = step(run)
    assert names(history) == COUPLED[:2]
    assert [attempt.width for attempt in history] == pytest.approx([1, 100, 10, 1])


def test_a_growing_step_is_the_last_resort(monkeypatch):
    run = simulation()
    monkeypatch.setattr(
        Newton, "solve", only(lambda problem, full_steps: problem.width == 1 and problem.length < 1)
    )
    with pytest.raises(nv.StepError) as error:
        step(run)
    assert names(error.value.history) == COUPLED
    solved = [attempt for attempt in error.value.history if attempt.solution.converged]
    assert {attempt.strategy for attempt in solved} == {"coupled, growing step"}


@pytest.mark.parametrize(
    ("efforts", "tried"),
    [
        (Effort.DIRECT, ["split"]),
        (Effort.DIRECT | Effort.CONTINUATION, SPLIT[1:]),
        (Effort.OTHER_SOLVER, ["coupled"]),
        (Effort.ALL, [*SPLIT[1:], "coupled"]),
    ],
)
def test_a_caller_chooses_the_efforts(efforts, tried, monkeypatch):
    run = simulation(solver="split")
    monkeypatch.setattr(Split, "solve", only(lambda problem, full_steps: False))
    if Effort.OTHER_SOLVER in efforts:
        history = step(run, efforts)
        assert run.solver.retried == 1
    else:
        with pytest.raises(nv.StepError) as error:
            step(run, efforts)
        history = error.value.history
    assert names(history) == tried


def test_a_step_after_a_retry_begins_with_a_new_tangent(monkeypatch):
    """That of the solver which gave up belongs to none of the run's states."""
    run = simulation(solver="split", halvings=0)
    solve, calls = Split.solve, []

    def fails_after_solving(self, problem, guess, full_steps=None):
        calls.append(self.is_factorised)
        solution = solve(self, problem, guess)
        return FAILED if len(calls) <= 3 else solution

    monkeypatch.setattr(Split, "solve", fails_after_solving)
    run.advance()
    assert run.solver.retried == 1 and len(calls) == 3
    assert "last_tau" not in run.solver.state_dict()[0]
    run.advance()
    assert calls == [False] * 4


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: simulation(strategies=[]), "strategies of different names"),
        (lambda: simulation(strategies=[FromStartValue(name="a")] * 2), "strategies of different names"),
        (lambda: simulation(strategies=["coupled"]), r"strategies = 'coupled': expected a ngvisco.Strategy"),
        (
            lambda: FromStartValue(name="a", solver="direct"),
            "solver = 'direct': expected one of coupled, split",
        ),
        (lambda: FromStartValue(name="a", courant=-1.0), "courant = -1.0: expected a finite number > 0"),
        (lambda: FromExtrapolation(name="a", farthest=0), "farthest = 0: expected a finite number > 0"),
        (lambda: ContinuationPath(starts=(), ratio=2.0), "from which the ratio 2 leads to 1"),
        (lambda: ContinuationPath(starts=(0.5, 3.0), ratio=2.0), "from which the ratio 2 leads to 1"),
        (lambda: ContinuationPath(starts=(0.5,), ratio=1.0), "from which the ratio 1 leads to 1"),
        (lambda: replace(WIDTHS, tries=0), "tries = 0: expected an integer >= 1"),
        (lambda: UpwindingContinuation(name="a", full_steps=0), "full_steps = 0: expected an integer >= 1"),
        (
            lambda: UpwindingContinuation(name="a", solver="split", full_steps=2),
            "only the coupled solver takes undamped steps",
        ),
        (lambda: SplitOptions(direct_up_to=(1, -1)), r"direct_up_to = \(1, -1\): expected 2 integers >= 0"),
        (lambda: SplitOptions(slow=0), "slow = 0: expected an integer >= 1"),
        (lambda: SplitOptions(forcing=-1.0), "SplitOptions.forcing = -1.0: expected a finite number > 0"),
        (
            lambda: nv.NewtonOptions(split="split"),
            "NewtonOptions.split = 'split': expected a ngvisco.SplitOptions",
        ),
    ],
)
def test_what_cannot_be_tried_is_refused(make, message):
    with pytest.raises(nv.ParameterError, match=message):
        make()


# --- paths ----------------------------------------------------------------------------------------------


def followed(path: ContinuationPath, solvable, at_once=None) -> tuple[list[float], Solution]:
    """What a continuation tries and answers where ``solvable(value, solved)`` says what Newton would do."""
    tried, solved = [], []
    state = BaseVector(1)

    def solve(value: float, guess: BaseVector) -> Solution:
        tried.append(value)
        if not solvable(value, solved[-1] if solved else None):
            return FAILED
        solved.append(value)
        return CONVERGED

    return tried, path.follow(solve, state, state, at_once)


def test_continuation_goes_to_one_by_its_ratio() -> None:
    assert followed(LENGTHS, lambda value, solved: True)[0] == [0.25, 1.0]
    assert followed(WIDTHS, lambda value, solved: True)[0] == pytest.approx([1e2, 1e1, 1.0])
    values, solution = followed(LENGTHS, lambda value, solved: solved or value <= 0.01)
    assert values == pytest.approx([0.25, 0.25 / 8, 0.25 / 64, 0.25 / 16, 0.25 / 4, 0.25, 1.0])
    assert solution.converged


def test_continuation_takes_smaller_steps_where_needed() -> None:
    """Only ratios up to 1.5 are solved: it arrives, by such ratios."""
    values, solution = followed(LENGTHS, lambda value, solved: solved is None or value <= 1.5 * solved)
    assert solution.converged and values[-1] == 1.0
    assert len(values) <= LENGTHS.tries


def test_continuation_gives_up_beyond_the_furthest() -> None:
    assert followed(WIDTHS, lambda value, solved: value > 1e4)[1] is FAILED
    values, solution = followed(LENGTHS, lambda value, solved: False)
    assert solution is FAILED
    assert values == pytest.approx([0.25 / 8**i for i in range(6)])


def test_a_path_that_is_too_long_is_a_failure_with_its_reason() -> None:
    """Every value is solved, and two of them do not lead to 1."""
    values, solution = followed(replace(WIDTHS, tries=2), lambda value, solved: True)
    assert values == pytest.approx([1e2, 1e1])
    assert not solution.converged and "does not lead to" in solution.reason


def test_a_path_that_folds_is_left_at_once() -> None:
    """No value below 30 is solved; the problem itself is tried after the first failure, and ends it."""
    tried = []

    def at_once(guess: BaseVector) -> Solution:
        tried.append(1)
        return CONVERGED

    values, solution = followed(WIDTHS, lambda value, solved: value >= 30, at_once)
    assert values == pytest.approx([1e2, 1e1])
    assert tried == [1] and solution.converged
