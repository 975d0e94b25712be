"""What a run is given of time: one object, or its parameters themselves."""

import pytest

import ngvisco as nv
from ngvisco.geometries import box

MODEL = nv.Model(material=nv.LinearElastic(K_e=1.0, G_e=1.0))
ADAPTIVE = nv.AdaptiveSteps(dt_min=0.01, dt_max=0.2)


def simulation(**options):
    return nv.Simulation(box((1, 1), 1.0), MODEL, **options)


def test_parameters_of_time_steps_stand_for_them():
    steps = nv.TimeSteps(
        dt=0.1, scheme="midpoint", startup=2, limiter=False, velocity_scale=3.0, adaptive=ADAPTIVE
    )
    new = simulation(time=steps)
    short = simulation(
        dt=0.1, scheme="midpoint", startup=2, adaptive=ADAPTIVE, limiter=False, velocity_scale=3
    )
    for run in (new, short):
        assert (run.dt, run.velocity_scale, run.is_adaptive, run.scheme.name) == (0.1, 3.0, True, "midpoint")
        assert run.integrator.startup == 2 and run.bounds.limits is False


def test_time_is_given_once():
    steps = nv.TimeSteps(dt=0.1)
    for twice in ({"dt": 0.1}, {"scheme": "midpoint"}, {"halvings": 1}):
        with pytest.raises(nv.ParameterError, match=r"Simulation\.time = .*None beside"):
            simulation(time=steps, **twice)
    with pytest.raises(nv.ParameterError, match=r"TimeSteps\.dt = None"):
        simulation()
    with pytest.raises(nv.ParameterError, match=r"Simulation\.time = 0\.1: expected a ngvisco.TimeSteps"):
        simulation(time=0.1)
    with pytest.raises(TypeError, match=r"Simulation\(\): .* argument 'shceme'; did you mean 'scheme'"):
        simulation(dt=0.1, shceme="midpoint")
