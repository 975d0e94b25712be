"""The split solver's iteration on increments of a known kind: what it takes for a solution."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from ngvisco.solver.options import NarrowingOptions, NewtonOptions, SplitOptions
from ngvisco.solver.solution import Problem, Status
from ngvisco.solver.split import iteration
from ngvisco.solver.split.successive import Successive


class Increments:
    """What ``iterate`` asks of a split solver: increments of given sizes, the unknown is their number."""

    def __init__(self, sizes):
        self.sizes, self.options, self.is_factorised = sizes, NewtonOptions(), True
        self.step = SimpleNamespace(mesh=SimpleNamespace(dim=2))
        self.unknowns = SimpleNamespace(pack=lambda: np.zeros(1), scales=lambda x, exchange: np.ones_like(x))
        self.preconditioner = SimpleNamespace(iterations=1)
        self.norm = SimpleNamespace(shared=())
        exchange = SimpleNamespace(products=np.matmul)
        self.residual = SimpleNamespace(put=lambda x: None, start=lambda: None, exchange=exchange)
        self.number = -1

    def increment(self, problem, x, last):
        self.number += 1
        return None, np.ones(1), self.sizes(self.number)

    def size(self, f, coarse=False):
        return self.sizes(self.number)


class Posed(Problem):
    """Equations without parameters."""

    def pose(self):
        pass


@dataclass(frozen=True)
class Jump(Problem):
    """x + c x/sqrt(x^2 + eta^2) + b = 0: an elastic force that jumps by 2 c where the flow turns round."""

    c: float
    b: float
    eta: float
    width: float = 1.0

    def widened(self, width):
        return replace(self, width=width)

    def pose(self):
        pass

    def increment(self, x):
        root = np.sqrt(x * x + (self.width * self.eta) ** 2)
        return (x + self.c * x / root + self.b) / (1 + self.c * (1 - (x / root) ** 2) / root)


class Newton(Increments):
    """Newton's increments of a ``Jump`` from x = ``start``, their sizes relative to 1."""

    def __init__(self, start, **narrowing):
        options = SplitOptions(narrowing=NarrowingOptions(**narrowing))
        super().__init__(None)
        self.options, self.x = NewtonOptions(split=options), None
        self.unknowns.pack = lambda: np.array([start])
        self.residual.put = lambda x: setattr(self, "x", x)

    def increment(self, problem, x, last):
        f = problem.increment(x)
        return None, f, self.size(f)

    def size(self, f, coarse=False):
        return float(abs(f[0]))

    def reset(self):
        pass


@pytest.fixture
def no_krylov(monkeypatch):
    monkeypatch.setattr(iteration, "newton_krylov", lambda *arguments: Status.STALLED)


def test_a_plateau_below_the_tolerance_is_rounding(no_krylov):
    tolerance = NewtonOptions().tolerance
    found = Increments(lambda n: max(10.0 ** (-3 * n - 1), 0.5 * tolerance))
    assert iteration.iterate(found, Posed(), []) is Status.CONVERGED


def test_slow_convergence_is_not_taken_for_rounding(no_krylov):
    """Increments that fall by 7 % each leave fourteen of them before the solution."""
    tolerance = NewtonOptions().tolerance
    found = Increments(lambda n: 10.0 ** (-3 * n - 1) if n < 3 else 2 * tolerance * 0.93**n)
    assert iteration.iterate(found, Posed(), []) is Status.STALLED


@pytest.fixture
def no_widths(monkeypatch):
    monkeypatch.setattr(iteration, "narrowed", lambda *arguments: None)


@pytest.fixture
def no_directions(monkeypatch):
    """Increments in a row that neither lead on nor back."""
    neither = SimpleNamespace(lead_on=False, are_opposed=False)
    monkeypatch.setattr(iteration.Successive, "of", lambda *arguments: neither)


@pytest.mark.parametrize("c", [1e-4, 1e-3])
def test_a_jump_that_increments_step_over_is_solved_by_widths(no_krylov, no_directions, c):
    """Of 100 and 1000 widths: Newton's own increments go to and fro between its sides."""
    problem = Jump(c=c, b=0.3 * c, eta=1e-6)
    found = Newton(start=2 * c)
    history = []
    assert iteration.iterate(found, problem, history) is Status.CONVERGED
    assert len(history) <= 40
    root = np.sqrt(found.x[0] ** 2 + problem.eta**2)
    assert found.x[0] + c * found.x[0] / root + problem.b == pytest.approx(0, abs=1e-12)


def test_without_widths_such_a_jump_is_not_solved(no_krylov, no_directions, no_widths):
    """Negative control, also of what follows."""
    found = Newton(start=2e-4)
    assert iteration.iterate(found, Jump(c=1e-4, b=3e-5, eta=1e-6), []) is Status.STALLED


@pytest.mark.parametrize("c", [1e-5, 1e-4])
def test_secants_lead_to_a_solution_within_a_jump(no_krylov, no_widths, c):
    """Of 10 and 100 widths."""
    problem = Jump(c=c, b=0.3 * c, eta=1e-6)
    found, history = Newton(start=2 * c), []
    assert iteration.iterate(found, problem, history) is Status.CONVERGED
    assert len(history) <= 20
    assert problem.increment(found.x) == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("start", [-3e-6, 3e-6])
def test_an_increment_out_of_a_jump_may_be_longer(no_krylov, no_widths, start):
    """A force of the wrong sign drives the flow out of the jump: the next increment is much longer."""
    problem = Jump(c=-1e-3, b=1e-4, eta=1e-6)
    found, history = Newton(start), []
    assert iteration.iterate(found, problem, history) is Status.CONVERGED
    assert len(history) == 4 and history[1].increment > 20 * history[0].increment
    assert problem.increment(found.x) == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("start", [-3e-6, 3e-6])
def test_without_its_direction_such_an_increment_is_refused(no_krylov, no_directions, no_widths, start):
    """Negative control."""
    history = []
    iteration.iterate(Newton(start), Jump(c=-1e-3, b=1e-4, eta=1e-6), history)
    assert len(history) > 6


def test_secants_that_gain_nothing_end(no_krylov, no_widths):
    """Increments of one length to and fro: a window of secants, then new starts, then Newton-Krylov."""
    found = Increments(lambda number: 1e-3)
    found.increment = lambda problem, x, last: (None, np.sign(x - 0.1) * np.full(1, 1e-3), 1e-3)
    history = []
    assert iteration.iterate(found, Posed(), history) is Status.STALLED
    assert len(history) < found.options.max_iterations


def test_a_secant_is_exact_for_a_linear_increment_along_the_line():
    """f = A (x - s) with s between two iterates: A takes increments too far."""
    rng = np.random.default_rng(1)
    solution, along = rng.standard_normal((2, 5))
    x, before = solution + 0.4 * along, -1.7 * along  # from x + before, where f has to be before
    slope = 1.7 / 1.3
    of = Increments(None)
    of.unknowns.scales = lambda x, exchange: np.array([1.0, 1e3, 1.0, 1e-3, 1.0])
    two = Successive.of(of, x, slope * 0.4 * along, before)
    assert two.are_opposed and not two.lead_on
    found, increment = two.secant()
    assert found == pytest.approx(solution) and increment == pytest.approx(0, abs=1e-14)


@pytest.mark.parametrize("contraction", [0.1, 0.3, 0.45])
def test_it_ends_where_little_is_left_and_not_later(no_krylov, contraction):
    split = Increments(lambda number: 1e-9 * contraction**number)
    history = []
    assert iteration.iterate(split, Posed(), history) is Status.CONVERGED
    tolerance, margin = split.options.tolerance, split.options.split.margin
    left = history[-1].increment * contraction
    assert left <= margin * tolerance * (1 + 1e-9) and history[-1].increment <= tolerance
    before = history[-2].increment
    assert before > tolerance or before * contraction > margin * tolerance


def test_a_first_increment_tells_no_contraction(no_krylov):
    split = Increments(lambda number: 0.5e-10 if number == 0 else 1e-12)
    history = []
    assert iteration.iterate(split, Posed(), history) is Status.CONVERGED
    assert len(history) == 2


class Domain(Increments):
    """Increments of which one leads to where there is no number, by what is left of it."""

    def __init__(self, sizes, outside):
        super().__init__(sizes)
        self.outside, self.at = outside, []

    def increment(self, problem, x, last):
        self.at.append(x.copy())
        _, f, size = super().increment(problem, x, last)
        return None, f * (self.number + 1), np.inf if self.number == self.outside else size

    def reset(self):
        """The tangent is not asked for."""


def test_where_there_is_no_number_the_last_increment_is_halved():
    """Not that of the best iterate, which is the start."""
    split = Domain(lambda n: (0.6, 0.9, 0.0, 0.1, 1e-3, 1e-6, 1e-12, 1e-14)[n], outside=2)
    history = []
    assert iteration.iterate(split, Posed(), history) is Status.CONVERGED
    start, first, outside, again = (float(x[0]) for x in split.at[:4])
    assert (start, first, outside) == (0.0, -1.0, -3.0) and again == -2.0


@pytest.mark.parametrize(("smallest", "restarts"), [(0.02, 0), (0.009, 1)])
def test_increments_may_grow_more_far_from_the_solution(smallest, restarts):
    """Three times the smallest one, above and below 1e-2."""
    sizes = (0.3, smallest, 3 * smallest, 1e-3, 1e-6, 1e-12, 1e-14, 1e-15)
    split = Domain(lambda n: sizes[n], outside=None)
    split.options = replace(NewtonOptions(), split=SplitOptions(narrowing=NarrowingOptions(largest=1e-3)))
    split.resets = 0
    split.reset = lambda: setattr(split, "resets", split.resets + 1)
    assert iteration.iterate(split, Posed(), []) is Status.CONVERGED
    assert split.resets == restarts
