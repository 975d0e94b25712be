"""The split solver's iteration on increments of a known kind: what it takes for a solution."""

from types import SimpleNamespace

import numpy as np
import pytest

from ngvisco.solver.options import NewtonOptions
from ngvisco.solver.solution import Status
from ngvisco.solver.split import iteration


class Increments:
    """What ``iterate`` asks of a split solver: increments of given sizes, the unknown is their number."""

    def __init__(self, sizes):
        self.sizes, self.options, self.is_factorised = sizes, NewtonOptions(), True
        self.step = SimpleNamespace(mesh=SimpleNamespace(dim=2))
        self.unknowns = SimpleNamespace(pack=lambda: np.zeros(1))
        self.preconditioner = SimpleNamespace(iterations=1)
        self.residual = SimpleNamespace(put=lambda x: None)
        self.number = -1

    def increment(self, problem, x, last):
        self.number += 1
        return None, np.ones(1), self.sizes(self.number)

    def size(self, f, coarse=False):
        return self.sizes(self.number)


@pytest.fixture
def no_krylov(monkeypatch):
    monkeypatch.setattr(iteration, "newton_krylov", lambda *arguments: Status.STALLED)


def test_a_plateau_below_the_tolerance_is_rounding(no_krylov):
    tolerance = NewtonOptions().tolerance
    found = Increments(lambda n: max(10.0 ** (-3 * n - 1), 0.5 * tolerance))
    assert iteration.iterate(found, None, []) is Status.CONVERGED


def test_slow_convergence_is_not_taken_for_rounding(no_krylov):
    """Increments that fall by 7 % each leave fourteen of them before the solution."""
    tolerance = NewtonOptions().tolerance
    found = Increments(lambda n: 10.0 ** (-3 * n - 1) if n < 3 else 2 * tolerance * 0.93**n)
    assert iteration.iterate(found, None, []) is Status.STALLED


@pytest.mark.parametrize("contraction", [0.1, 0.3, 0.45])
def test_it_ends_where_little_is_left_and_not_later(no_krylov, contraction):
    split = Increments(lambda number: 1e-9 * contraction**number)
    history = []
    assert iteration.iterate(split, None, history) is Status.CONVERGED
    tolerance, margin = split.options.tolerance, split.options.split.margin
    left = history[-1].increment * contraction
    assert left <= margin * tolerance * (1 + 1e-9) and history[-1].increment <= tolerance
    before = history[-2].increment
    assert before > tolerance or before * contraction > margin * tolerance


def test_a_first_increment_tells_no_contraction(no_krylov):
    split = Increments(lambda number: 0.5e-10 if number == 0 else 1e-12)
    history = []
    assert iteration.iterate(split, None, history) is Status.CONVERGED
    assert len(history) == 2
