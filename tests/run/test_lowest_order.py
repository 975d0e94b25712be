"""Linear velocities and constant variables, k = 1 and m = 0: the stable pair of lowest order."""

import math

import numpy as np
import pytest
from ngsolve import CF, x
from ngsolve import sin as sine

import ngvisco as nv
from ngvisco.errors import ParameterError
from ngvisco.forms.unfelt import UNFELT
from ngvisco.geometries import disc, structured_box

LOWEST = nv.Discretisation(k=1, m=0)
K, G, LENGTH = 10.0, 2.0, 4.0
OMEGA = math.pi / LENGTH * math.sqrt(K + 4 / 3 * 2 * G)
"""The frequency of the longest compression wave between walls, 1/s, with a density of 1 kg/m^3."""


def wave(cells: tuple[int, int], amplitude: float, steps: int, **options) -> nv.Simulation:
    """A run of half a period of the wave, in ``steps`` steps."""
    options = {"time": nv.TimeSteps(dt=math.pi / OMEGA / steps, scheme="midpoint")} | options
    return nv.Simulation(
        structured_box((LENGTH, 1.0), cells),
        nv.Model(material=nv.ReferentialNeoHookean(K_e=K, G_e=G)),
        discretisation=LOWEST,
        initial=nv.Initial(velocity=CF((amplitude * sine(math.pi * x / LENGTH), 0.0))),
        **options,
    )


def phase(cells: tuple[int, int], steps: int) -> float:
    """The error of the wave's phase, an angle, after a quarter of a period, when the velocity should be 0."""
    run, w = wave(cells, 1e-4, steps), sine(math.pi * x / LENGTH)
    integrate = run.rothe_step.quadrature.integrate_cells
    before = integrate(run.fields["velocity"][0] * w)
    run.run(math.pi / OMEGA / 2)
    return float(integrate(run.fields["velocity"][0] * w) / before)


def test_the_speed_of_a_wave_converges_at_second_order():
    """With half the cell size a quarter of the error is left."""
    coarse, fine = (abs(phase((n, n // 4), n)) for n in (8, 16))
    assert 1e-4 < fine < 0.02
    assert 3.0 < coarse / fine < 5.0


def test_at_lowest_order_every_motion_changes_a_variable_and_the_energy_falls():
    run = wave((8, 2), 0.1, 8, time=nv.TimeSteps(dt=0.1))
    run.run(0.8)
    total = run.ledger.column("kinetic") + run.ledger.column("stored")
    assert UNFELT not in run.ledger.columns
    assert (np.diff(total) < 0).all()
    assert abs(run.ledger.column("closure")[1:]).max() < 1e-9


def test_both_solvers_agree_at_lowest_order():
    ends = []
    for solver in ("coupled", "split"):
        run = wave((8, 2), 0.1, 8, solver=solver)
        run.run(math.pi / OMEGA / 4)
        ends.append(
            np.asarray(run.rothe_step.state.vec.FV().NumPy()[: run.rothe_step.layout.ranges["v"].stop])
        )
    assert abs(ends[0] - ends[1]).max() < 1e-7


def test_hyperviscosity_is_refused_at_lowest_order():
    law = nv.HyperViscosity(mu=0.1, p=4.0)
    model = nv.Model(material=nv.ReferentialNeoHookean(K_e=K, G_e=G), hyperviscosity=law)
    with pytest.raises(ParameterError, match=r"hyperviscosity.*None with nv\.Discretisation\(k=1\)"):
        nv.Simulation(structured_box((1.0, 1.0), (2, 2)), model, dt=0.1, discretisation=LOWEST)


def test_oblique_walls_are_refused():
    model = nv.Model(material=nv.ReferentialNeoHookean(K_e=K, G_e=G))
    with pytest.raises(ParameterError, match=r"Discretisation\.k.*2 or 3, .*the oblique or curved walls"):
        nv.Simulation(disc(1.0, 0.6), model, dt=0.1, discretisation=LOWEST)
