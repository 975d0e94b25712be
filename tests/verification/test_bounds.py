"""Bounds of verification cases: a physical number has two sides."""

import math

import pytest

from tests.verification.bounds import KINDS, Bound, VerificationError, parsed
from tests.verification.cases import all_cases


def test_a_physical_number_with_a_bound_on_one_side_only_is_refused():
    """A coefficient of restitution of 0.278 once passed, because its bound was '<= 0.95'."""
    for text in ("coefficient of restitution <= 0.95: viscous", "height of the wave, m >= 0.1: it rises"):
        with pytest.raises(VerificationError, match="two sides: 'quantity in"):
            parsed("a case", text)
    (bound,) = parsed("a case", "coefficient of restitution in [0.2, 0.4]: viscous")
    assert [bound.holds(value) for value in (0.19, 0.2, 0.4, 0.41, math.nan)] == [
        False,
        True,
        True,
        False,
        False,
    ]
    assert str(bound) == "- coefficient of restitution in [0.2, 0.4]: viscous" and bound.kind is None
    with pytest.raises(VerificationError, match="least <= largest"):
        parsed("a case", "frequency, Hz in [2, 1]: turned round")


def test_a_negative_error_violates_its_bound():
    """A signed number that is called an error would keep its bound with any negative value."""
    error, rise = Bound("error of v", "<=", 0.1), Bound("largest rise of the energy", "<=", 1e-12)
    assert error.holds(0.0) and error.holds(0.1) and not error.holds(-1e-3)
    assert rise.holds(-5.0) and not rise.holds(-math.inf)


def test_one_sided_bounds_are_of_a_known_kind_and_every_kind_occurs():
    bounds = [bound for case in all_cases() for bound in case.bounds]
    assert all((bound.kind is None) == (bound.relation == "in") for bound in bounds)
    used = {(bound.kind.name, bound.relation) for bound in bounds if bound.kind is not None}
    assert used == {(kind.name, kind.relation) for kind in KINDS}
