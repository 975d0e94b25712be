"""Whether the side of upwinding that a step began with is wrong, which is asked of some cells only."""

import numpy as np
import pytest
from support import swirling

import ngvisco as nv
from ngvisco.geometries import box


@pytest.mark.parametrize("m", [0, 1])
def test_a_side_is_wrong_where_the_flow_has_turned(m):
    """As all cells say; not where the velocity is that of the side, or next to it."""
    run = swirling(box((1, 1), 0.25), dt=0.3, discretisation=nv.Discretisation(m=m), solver="coupled")
    sides, step = run.solver.sides, run.rothe_step
    step.context.set_step(0.3, 0.3, 0.0, 0.3)
    v = step.state.vec.FV().NumPy()[step.layout.ranges["v"]].copy()
    found = []
    for share in (0.0, 0.3, 0.5, 0.7, 0.9, 0.95, 1.1):  # of the largest, above which coefficients are turned
        sides.choose(np.where(abs(v) >= share * abs(v).max(), -v, 0.999 * v))
        found.append(sides._is_wrong())
        assert found[-1] == (step.quadrature.integrate_facets(sides._wrong) > 0)
    assert found[0] and found[2] and not found[-1]
