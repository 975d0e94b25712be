"""Impact and expansion of an elastic solid on a coarse strip; the verification case has a fine strip."""

import numpy as np
import pytest

from tests.verification.cases.riemann import SOUND, solved, star_of_expansion, star_of_impact, stars


def test_weak_waves_are_acoustic():
    """Both star states are 1 -+ U/c to first order. The tolerance is larger than the terms of second
    order."""
    U = 1e-4 * SOUND
    assert star_of_impact(U) == pytest.approx(1 - 1e-4, abs=1e-7)
    assert star_of_expansion(U) == pytest.approx(1 + 1e-4, abs=1e-7)


@pytest.mark.long
@pytest.mark.ci
def test_star_states_of_impact_and_expansion_are_right_to_two_per_cent():
    run = solved(0.2, 40)
    assert run.ledger.column("rejections").sum() == 0
    assert np.abs(run.ledger.column("closure_relative")).max() <= 1e-10
    for star in stars(run, 0.2):
        assert max(star.errors.values()) < 0.02
        # the drift is an error in time, which the midpoint rule does not have
        assert 1e-4 < abs(star.drift) < 0.02
