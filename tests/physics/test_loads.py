"""Forces on matter against their formulas."""

import numpy as np
import pytest
from support import one_triangle

import ngvisco as nv


@pytest.mark.parametrize("exponent", [1.0, 0.5, -2.0])
def test_central_gravity_is_a_power_of_the_distance_to_the_centre(exponent):
    """g = -strength (r/radius)^exponent e_r."""
    load = nv.CentralGravity(strength=3.0, centre=(0.7, -0.4), radius=2.0, exponent=exponent)
    offset = np.array([0.3 - 0.7, 0.2 + 0.4])
    r = np.linalg.norm(offset)
    found = np.array(load.g(one_triangle()(0.3, 0.2)))
    assert found == pytest.approx(-3.0 * (r / 2.0) ** exponent * offset / r, rel=1e-12)
