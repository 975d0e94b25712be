"""Means over time: they are exact to their tolerance for any function in the interval, and loads in runs
take them."""

import math

import numpy as np
import pytest
from ngsolve import CF, IfPos, Integrate, cos, exp, sin, sqrt, x

import ngvisco as nv
from ngvisco.forms.time_means import TOLERANCE, mean_in_cells
from ngvisco.geometries import box
from ngvisco.physics.signals import may_read_time

T = nv.time
MESH = box((1, 1), 0.5)

MEANS = {
    "smooth": (sin(3 * T), (1 - math.cos(0.3)) / 0.3),
    "five periods": (sin(300 * T), (1 - math.cos(30)) / 30),
    "a bump of 3 %": (exp(-(((T - 0.05) / 0.003) ** 2)), 0.03 * math.sqrt(math.pi)),
    "a kink": (sqrt((T - 0.033) ** 2), (0.033**2 + 0.067**2) / 0.2),
    "a condition": (IfPos(T - 0.0333, 1.0, 0.0), 0.667),
    "many conditions": (IfPos(cos(200 * T), 1.0, 0.0), (20 - 3 * math.pi) / 20),
    "step": (nv.step(0.07), 0.3),
    "pulse": (nv.pulse(0.03, 0.01), 0.1),
    "pulse of a millionth": (1e6 * nv.pulse(0.03, 1e-7), 1.0),
    "table": (nv.table([0.01, 0.02, 0.5], [1, 5, 2]), 4.2),
}
"""Over [0, 0.1] s."""


def mean(value, begin=0.0, length=0.1):
    function, average = mean_in_cells(CF(value), MESH, 6)
    error = average.update(begin, length)
    return function(MESH(0.3, 0.4)), error


@pytest.mark.parametrize("value", [CF(T), 2 * T, -T, T / 2, 3 * sin(T), x * (2 * T), CF((2 * T, 0.0))])
def test_the_dependence_of_a_function_on_time_is_detected(value):
    """NGSolve shortens the name of a multiple of the time: 2 t was taken for a constant, and not
    averaged."""
    assert may_read_time(value) and not may_read_time(2 * x)


@pytest.mark.parametrize("name", MEANS)
def test_means_are_exact_to_the_tolerance(name):
    """The admitted error is the tolerance, or ten roundings of the time over the length of the pulse if this
    is larger."""
    value, exact = MEANS[name]
    found, error = mean(value)
    assert error <= TOLERANCE
    assert found == pytest.approx(exact, rel=10 * TOLERANCE)


@pytest.mark.parametrize("tilt", [-0.2, 0.5])
def test_a_tilted_mean_of_a_function_linear_in_time_is_its_value(tilt):
    """The mean of a pulse is its share of the step, a tenth, times the weight at its place, 1 + 12 tilt
    (0.35 - 0.5)."""
    found = []
    for value in (3 * T - 0.1, nv.pulse(0.03, 0.01)):
        function, average = mean_in_cells(CF(value), MESH, 6)
        assert average.update(0.0, 0.1, tilt) <= 10 * TOLERANCE
        found.append(function(MESH(0.3, 0.4)))
    assert found[0] == pytest.approx(3 * (0.05 + 0.1 * tilt) - 0.1, rel=10 * TOLERANCE)
    assert found[1] == pytest.approx(0.1 * (1 - 1.8 * tilt), rel=10 * TOLERANCE)


def test_a_moving_front_is_reported_as_unresolved():
    """The function jumps at a different time at each place. The reported error is that of 50 panels."""
    front = IfPos(x - 10 * T, 1.0, 0.0)
    found, error = mean(front)
    assert TOLERANCE < error < 0.02
    # within a cell, a polynomial of third degree stands for a function with jumps
    assert abs(found - 0.3) <= 0.1


def test_a_table_of_time_is_read_from_a_file(tmp_path):
    path = tmp_path / "load.csv"
    path.write_text("time, east, north\n0, 1, 0\n\n0.5, 3, 1\n2, 0, 1\n")
    load = nv.table(path)
    assert load.dim == 2
    for t, expected in (
        (-1, (1, 0)),
        (0.25, (2, 0.5)),
        (0.5, (3, 1)),
        (1.25, (1.5, 1)),
        (2, (0, 1)),
        (9, (0, 1)),
    ):
        T.Set(t)
        assert load(MESH(0.1, 0.1)) == pytest.approx(expected)
    T.Set(0.0)
    path.write_text("0,1\n1,x\n")
    with pytest.raises(nv.ParameterError, match="line 2"):
        nv.table(path)
    path.write_text("0,1\n1,2,3\n")
    with pytest.raises(nv.ParameterError, match="line 2"):
        nv.table(path)


MODEL = {"material": nv.BarotropicFluid(B=1.0, gamma=1.4)}
DT = 0.1


def momentum_of(load, scheme="backward-euler", solver="coupled", steps=1):
    """Momentum of a periodic strip of mass 1 kg along the load, after steps of 0.1 s."""
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
@pytest.mark.parametrize("scheme", ["backward-euler", "midpoint", "sdirk2"])
def test_the_gained_momentum_is_the_impulse_of_the_load(load, expected, scheme):
    """Two Gauss points per step would give an impulse of 0 for the pulse, and an error of 0.1 for the step
    function. Loads at the times of the stages would be as wrong for SDIRK2."""
    assert momentum_of(load, scheme) == pytest.approx(expected, rel=1e-8)


def test_the_split_solver_also_applies_the_whole_impulse_of_a_load():
    assert momentum_of(100 * nv.pulse(0.03, 0.01), solver="split", steps=2) == pytest.approx(1.0, rel=1e-8)


def test_a_traction_acts_by_its_mean_over_the_step():
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


def test_an_unresolved_load_is_warned_of_once():
    """A front crosses the body, so that the load jumps at a different time at each place."""
    front = CF((IfPos(x - 10 * nv.time, 1.0, 0.0), 0))
    model = nv.Model(loads=[nv.Gravity(front)], **MODEL)
    run = nv.Simulation(box((1, 1), 1.0), model, time=nv.TimeSteps(dt=0.04, velocity_scale=1.0))
    with pytest.warns(
        nv.InputWarning, match="mean of a load over the step from t = 0 s has an error of"
    ) as caught:
        run.run(0.08)
    assert len([w for w in caught if "has an error of" in str(w.message)]) == 1
