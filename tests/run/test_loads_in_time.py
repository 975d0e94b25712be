"""What happens within a step counts: the momentum that loads and tractions give, the way that walls move."""

import numpy as np
import pytest
from ngsolve import CF, IfPos, Integrate, x

import ngvisco as nv
from ngvisco.geometries import box

MODEL = {"material": nv.BarotropicFluid(B=1.0, gamma=1.4)}
DT = 0.1


def momentum_of(load, scheme="backward-euler", solver="coupled", steps=1):
    """Of a periodic strip of mass 1 kg along the load, after steps of 0.1 s."""
    model = nv.Model(loads=[nv.Gravity((load, 0))], viscosity=nv.StokesViscosity(K_v=1, G_v=1), **MODEL)
    mesh = box((1, 1), 0.5, periodic=("x",))
    run = nv.Simulation(
        mesh, model, time=nv.TimeSteps(dt=DT, scheme=scheme, velocity_scale=1.0), solver=solver
    )
    ledger = run.run(steps * DT)
    assert np.abs(ledger.column("closure_relative")).max() <= 1e-8
    return Integrate(run.rothe_step.now.rho * run.rothe_step.now.v, run.mesh)[0]


@pytest.mark.parametrize(
    ("load", "expected"),
    [
        (100 * nv.pulse(0.03, 0.01), 1.0),
        (nv.step(0.0), 0.1),
        (nv.step(0.05), 0.05),
        (nv.table([0, 0.03, 0.05], [0, 10, 0]), 0.25),
        (IfPos(nv.time - 0.033, 1, 0) * IfPos(0.034 - nv.time, 1000, 0), 1.0),
    ],
    ids=["pulse", "step", "step within", "table", "conditions"],
)
@pytest.mark.parametrize("scheme", ["backward-euler", "midpoint"])
def test_the_momentum_is_the_loads_impulse(load, expected, scheme):
    """With two Gauss points the pulse gave 0 and the step within 0.1."""
    assert momentum_of(load, scheme) == pytest.approx(expected, rel=1e-8)


def test_the_split_solver_has_the_same_loads():
    assert momentum_of(100 * nv.pulse(0.03, 0.01), solver="split", steps=2) == pytest.approx(1.0, rel=1e-8)


def test_a_traction_counts_by_its_mean():
    """A pulse on one wall and a table on the other give the velocities that constant tractions give."""
    top, bottom = 100 * nv.pulse(0.03, 0.01), nv.table([0, 0.1], [0, 1])
    found = []
    for f, g in ((top, bottom), (10.0, 0.5)):
        model = nv.Model(viscosity=nv.StokesViscosity(K_v=1, G_v=1), **MODEL)
        walls = {"top": nv.Traction(f=(f, 0)), "bottom": nv.Traction(f=(g, 0))}
        mesh = box((1, 1), 0.5, periodic=("x",))
        run = nv.Simulation(mesh, model, time=nv.TimeSteps(dt=DT, velocity_scale=1.0), walls=walls)
        assert abs(run.advance()["closure_relative"]) <= 1e-8
        found.append(run.rothe_step.now.v(mesh(0.3, 0.8)))
    assert found[0] == pytest.approx(found[1], rel=1e-7) and found[1][0] > 1


def test_a_wall_is_displaced_by_what_it_moves_in_a_step():
    """The lid moves for 10 ms at 5 m/s within a step of 0.1 s, 0.5 m/s in the mean, and rests at its end."""
    model = nv.Model(viscosity=nv.StokesViscosity(K_v=1, G_v=1), **MODEL)
    lid = nv.PrescribedTangential((5 * nv.pulse(0.03, 0.01), 0))
    mesh = box((1, 1), 0.5, periodic=("x",))
    run = nv.Simulation(mesh, model, time=nv.TimeSteps(dt=DT, velocity_scale=1.0), walls={"top": lid})
    row = run.advance()
    assert abs(row["closure_relative"]) <= 1e-8 and row["power_wall_top"] > 0
    assert run.rothe_step.now.v(run.mesh(0.3, 1.0))[0] == pytest.approx(0.5, rel=1e-8)


def test_a_load_that_is_not_resolved_is_said_once():
    """A front that crosses the body breaks the load at other times at other places."""
    front = CF((IfPos(x - 10 * nv.time, 1.0, 0.0), 0))
    model = nv.Model(loads=[nv.Gravity(front)], **MODEL)
    run = nv.Simulation(box((1, 1), 1.0), model, time=nv.TimeSteps(dt=0.04, velocity_scale=1.0))
    with pytest.warns(
        nv.InputWarning, match="mean of a load over the step from t = 0 s is known to"
    ) as caught:
        run.run(0.08)
    assert len([w for w in caught if "known to" in str(w.message)]) == 1
