"""Newton's iteration on small problems, its norm, and the condensed solve."""

import math

import numpy as np
import pytest
from ngsolve import H1, BilinearForm, CoefficientFunction, GridFunction, IfPos, atan, dx, exp, grad

from ngvisco import NewtonOptions
from ngvisco.geometries import box
from ngvisco.solver.newton import Newton
from ngvisco.solver.problem import BlockNorm, Problem, Solution, Status

SPACE = H1(box((1, 1), 0.7), order=2)


def newton(start: float, equation, diffusion: float = 1e-2, **options) -> tuple[Newton, GridFunction]:
    """equation(u) = diffusion Laplace u with natural conditions: u constant where equation(u) = 0."""
    u, v = SPACE.TnT()
    form = BilinearForm(SPACE, condense=True)
    form += equation(u) * v * dx + diffusion * grad(u) * grad(v) * dx
    state = GridFunction(SPACE)
    state.Set(start)
    norm = BlockNorm({"u": slice(0, SPACE.ndof)}, {"u": 1.0})
    return Newton(form, state.vec, norm, lambda: None, NewtonOptions(**options)), state


class Posed(Problem):
    """The equation has no parameters."""

    def pose(self) -> None:
        pass


def solve(solver: Newton) -> Solution:
    """Solve from the present state."""
    guess = solver.state.CreateVector()
    guess.data = solver.state
    return solver.solve(Posed(), guess)


def solved(solver: Newton) -> Solution:
    solution = solve(solver)
    assert solution.converged
    return solution


def arc(u: CoefficientFunction) -> CoefficientFunction:
    return atan(u - 1)


def spread(state: GridFunction, value: float) -> float:
    constant = GridFunction(SPACE)
    constant.Set(value)
    return float(np.abs(state.vec.FV().NumPy() - constant.vec.FV().NumPy()).max())


@pytest.mark.parametrize("start", [1.5, 3.0, 10.0, 100.0, -40.0])
def test_damped_newton_converges_from_far_away(start: float) -> None:
    """Undamped Newton steps for atan diverge beyond |u - 1| = 1.39; steps that overshoot are halved."""
    solver, state = newton(start, arc)
    history = solved(solver).history
    assert spread(state, 1.0) < 1e-8
    assert (min(line.damping for line in history) < 1) == (abs(start - 1) > 1.4)


def test_a_factorisation_is_kept_while_newton_contracts() -> None:
    solver, _ = newton(1.2, arc)
    history = solved(solver).history
    assert [line.fresh_jacobian for line in history].count(True) <= 2 < len(history)
    assert solved(solver).history[0].fresh_jacobian is False
    solver.reset()
    assert solved(solver).history[0].fresh_jacobian is True


def test_newton_meets_its_tolerance_in_the_stated_norm() -> None:
    for tolerance in (1e-4, 1e-10):
        solver, state = newton(1.3, arc, tolerance=tolerance)
        history = solved(solver).history
        assert history[-1].increment * history[-1].contraction <= tolerance
        assert history[-2].increment * history[-2].contraction > tolerance
        assert spread(state, 1.0) < tolerance


@pytest.mark.parametrize(
    "equation, start, reason",
    [
        (lambda u: u * u - 1, 0.0, "no factorisation"),  # the Jacobian 2u is zero
        (lambda u: u * u + 1, 0.3, "did not converge"),  # the equation has no root
        (lambda u: exp(u), 0.0, "did not converge"),  # the root is at minus infinity
        (lambda u: u * math.nan, 0.0, "not finite"),
    ],
    ids=["singular", "no root", "root at infinity", "NaN"],
)
def test_a_failed_newton_returns_its_history_and_reason(equation, start: float, reason: str, capfd) -> None:
    solver, _ = newton(start, equation, diffusion=0.0, max_iterations=25)
    solution = solve(solver)
    lines = solution.history
    assert not solution.converged and reason in solution.reason
    assert isinstance(lines, tuple) and len(lines) <= 25
    assert bool(lines) == (reason == "did not converge")
    assert all(math.isfinite(line.increment) for line in lines)
    capfd.readouterr()  # UMFPACK announces a singular matrix on its own


def test_too_many_iterations_are_reported() -> None:
    solver, _ = newton(1.9, arc, max_iterations=2)
    solution = solve(solver)
    assert solution.status is Status.TOO_MANY_ITERATIONS
    assert "too many iterations; after 2 iterations" in solution.reason
    assert len(solution.history) == 2


@pytest.mark.parametrize(("least", "status"), [(1e-3, Status.CONVERGED), (0.9, Status.STALLED)])
def test_min_damping_is_the_smallest_step_tried(least: float, status: Status) -> None:
    """The start is 10, where the first increment for atan overshoots unless it is divided by eight. If
    min_damping is 0.9, the last attempt takes half of the increment."""
    solution = solve(newton(10.0, arc, min_damping=least)[0])
    assert solution.status is status
    assert min(line.damping for line in solution.history) == (0.125 if least == 1e-3 else 0.5)


# --- rounding ------------------------------------------------------------------------------------------


def cancelling(size: float):
    """The equation u - 1 = 0, plus parts of ``size`` that cancel each other up to their rounding error, size
    times 1e-16."""
    return lambda u: (u - 1) + (size * (u + 1) - size * u - size)


# the cancelling parts leave increments of more than 10 and less than 100 tolerances
ROUNDED = {"tolerance": 1e-12, "equation": cancelling(1.5e4)}


def test_rounding_of_cancelling_parts_ends_the_iteration() -> None:
    solver, state = newton(1.3, **ROUNDED)
    history = solved(solver).history
    assert 10e-12 < history[-1].increment * history[-1].contraction <= 100e-12
    assert spread(state, 1.0) < 1e-9


def test_rounding_of_more_than_a_hundred_tolerances_is_a_failure() -> None:
    solver, _ = newton(1.3, cancelling(1e9), tolerance=1e-12)
    assert solve(solver).status is Status.ROUNDING


def test_a_jump_of_the_equation_is_not_taken_for_rounding() -> None:
    """u - 1 + s sign(u - 1) has no root: increments stall at s, and are the same from a perturbed state."""
    s = 2e-11
    solver, _ = newton(1.3, lambda u: u - 1 + IfPos(u - 1, s, -s), tolerance=1e-12)
    solution = solve(solver)
    assert solution.status is Status.STALLED
    assert 10e-12 < solution.history[-1].increment < 100e-12


# --- the norm ----------------------------------------------------------------------------------------


def vectors(*arrays: list[float]):
    space = H1(box((1, 1), 2.0), order=1)  # four coefficients
    result = []
    for array in arrays:
        vector = GridFunction(space).vec.CreateVector()
        vector.FV().NumPy()[:] = array
        result.append(vector)
    return result


BLOCKS = BlockNorm({"v": slice(0, 2), "z": slice(2, 4), "ignored": slice(0, 4)}, {"v": 1.0, "z": 5.0})


@pytest.mark.parametrize("where", range(4))
def test_the_norm_of_a_vector_with_nan_is_nan(where: int) -> None:
    """NaN may be in any block; Python's max would lose it in the second."""
    increment, state = vectors([0.1, 0.1, 0.1, 0.1], [1.0, 1.0, 1.0, 1.0])
    increment.FV().NumPy()[where] = math.nan
    assert math.isnan(BLOCKS(increment, state))
    shared = BlockNorm(BLOCKS.ranges, BLOCKS.units, shared=["z"])
    assert math.isnan(shared(increment, state))
