"""A Rothe step: solved from a rough start, or the old state with a typed error."""

import numpy as np
import pytest
from ngsolve import CF, Id, IfPos, OuterProduct, x
from support import MATERIALS, SWIRL, state

from ngvisco import (
    HyperViscosity,
    Initial,
    Model,
    NewtonOptions,
    Simulation,
    StepError,
    StokesViscosity,
    time,
)
from ngvisco.geometries import box
from ngvisco.solver.problem import iterations

JUMP = Id(3) + IfPos(x - 0.4, 0.4, -0.2) * OuterProduct(CF((1, 0, 0)), CF((0.3, 1, 0)))


def simulation(material: str = "neo_hookean", speed: float = 1.0, F=None, dt: float = 0.05, **options):
    model = Model(
        material=MATERIALS[material],
        viscosity=StokesViscosity(K_v=0.01, G_v=0.01),
        hyperviscosity=HyperViscosity(mu=1e-3, p=4),
    )
    velocity = tuple(speed * component for component in SWIRL)
    return Simulation(box((1, 1), 0.5), model, dt=dt, initial=Initial(velocity=velocity, F=F), **options)


@pytest.mark.parametrize("material", ["linear", "neo_hookean"])
def test_first_step_from_a_rough_start_converges(material: str) -> None:
    """A distortion with jumps inside cells, and a velocity that crosses more than a cell in the step."""
    run = simulation(material, speed=10.0, F=JUMP)
    assert run.ledger.start(0.0)["v_max"] * run.dt > min(run.rothe_step.context.h.vec)
    row = run.advance()
    assert abs(row["closure_relative"]) < 1e-10
    assert row["rho_min"] > 0


def test_failed_step_restores_the_state_bitwise() -> None:
    run = simulation(newton=NewtonOptions(max_iterations=2), halvings=0)
    run.ledger.start(0.0)
    before = state(run)
    with pytest.raises(StepError, match=r"step of length 0\.05 s from t = 0 s.*too many iterations") as error:
        run.advance()
    assert np.array_equal(state(run), before)
    assert np.array_equal(run.rothe_step.state_old.vec.FV().NumPy(), before)
    assert (run.t, run.number, time.Get()) == (0.0, 0, 0.0)
    assert len(run.ledger.rows) == 1
    lines = iterations(error.value.history)
    assert len(lines) >= 2
    assert all(line.increment > 0 for line in lines)


def test_step_after_a_failure_equals_one_without() -> None:
    """Nothing of the failed attempt stays: not in the state, the time, the step length or the matrix."""
    clean, failed = simulation(), simulation()
    for run in (clean, failed):
        run.advance()
    sound = failed.solver.newton.options
    failed.solver.newton.options = NewtonOptions(max_iterations=2, tolerance=1e-14)
    with pytest.raises(StepError):
        failed.advance()
    assert (failed.t, time.Get()) == (0.05, 0.05)
    failed.solver.newton.options = sound
    clean.solver.reset()
    rows = [run.advance() for run in (clean, failed)]
    assert np.array_equal(state(clean), state(failed))
    assert rows[0] == rows[1] or {k for k in rows[0] if rows[0][k] != rows[1][k]} <= {"J_min", "J_defect"}


def test_change_of_the_step_length_assembles_anew() -> None:
    run = simulation()
    run.advance()
    assert run.solver.newton.is_factorised
    history = run.integrator.advance(run.t, 0.02).history
    assert history[0].solution.history[0].fresh_jacobian
