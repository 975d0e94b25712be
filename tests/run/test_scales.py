"""Scales are those of the linearised material, and advice stands where a number says so."""

import math

import numpy as np
import pytest
from ngsolve import CF, x

import ngvisco as nv
from ngvisco.geometries import box
from ngvisco.physics.variables import Cofactor, Distortion, Jacobian
from ngvisco.run.scales import moduli, scales, wave_speed
from tests.verification.cases import riemann

NEO_HOOKEAN = nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1)


def test_a_wrapped_material_has_nearly_the_moduli_of_the_wrapped_one():
    soft = nv.Yosida(material=NEO_HOOKEAN, eps=1e-6)
    assert moduli(soft, 2) == pytest.approx(moduli(NEO_HOOKEAN, 2), rel=1e-3)


def found(material=NEO_HOOKEAN, dt=0.01, maxh=0.2, G_m=math.inf, velocity_scale=0.5):
    model = nv.Model(
        material=material, viscosity=nv.StokesViscosity(K_v=0.3, G_v=0.2), creep=nv.Creep(G_m=G_m)
    )
    run = nv.Simulation(
        box((2, 1), maxh),
        model,
        time=nv.TimeSteps(dt=dt, velocity_scale=velocity_scale),
        initial=nv.Initial(density=4.0),
    )
    return scales(run)


def test_numbers_are_those_of_their_definitions():
    s = found(G_m=4.0)
    assert (s.length, s.kinematic_viscosity, s.velocity) == pytest.approx((1, 0.05, 0.5))
    assert s.maxwell == pytest.approx(4 / 20)
    fast, slow = s.speeds
    assert slow == pytest.approx(math.sqrt(10 / 4)) and fast == pytest.approx(math.sqrt((10.1 + 40 / 3) / 4))
    numbers = s.numbers
    assert numbers["Reynolds, rho v L/G_v"] == pytest.approx(4 * 0.5 / 0.2)
    assert numbers["Deborah, Maxwell time v/L"] == pytest.approx(0.1)
    assert numbers["Maxwell time/dt"] == pytest.approx(20)
    assert numbers["Mach of shear waves"] == pytest.approx(0.5 / slow)
    assert numbers["Courant, v dt/h"] == pytest.approx(0.5 * 0.01 / s.cell) and 0.05 < s.cell < 0.25
    assert (
        "Maxwell time/dt" not in found().numbers
        and "Mach of shear waves" not in found(nv.BarotropicFluid(B=2.0, gamma=1.5)).numbers
    )


def test_advice_is_given_where_a_scale_is_missed():
    assert found().advice == []
    (slow,) = found(dt=0.1).advice
    assert "shear waves cross the body in 0.63 s, 6.3 steps" in slow and "dt <= 0.032 s" in slow
    assert any("cells across the body" in line and "maxh" in line for line in found(maxh=0.5).advice)
    (relaxing,) = found(G_m=0.2).advice
    assert "stress relaxes in 0.01 s, 1 steps" in relaxing and "dt <= 0.002 s" in relaxing
    assert any("cells a step" in line for line in found(velocity_scale=50.0).advice)
    assert any("viscous layers" in line for line in found(velocity_scale=10.0).advice)
    sound = found(nv.BarotropicFluid(B=2.0, gamma=1.5), dt=0.2).advice
    assert any("longitudinal waves" in line for line in sound)


def test_advice_names_the_scheme_and_is_not_given_for_the_step_that_it_advises():
    from ngvisco.run.scales import Scales
    from ngvisco.timestepping.scheme import midpoint

    values = {"length": 1.0, "cell": 0.1, "velocity": 0.1, "speeds": (math.sqrt(20.0), math.sqrt(10.0))}
    values |= {"kinematic_viscosity": 0.0, "maxwell": 0.1 * (1 - 1e-9), "dt": 0.02}
    (said,) = Scales(**values).advice
    assert "the scheme backward-euler damps them" in said
    (said,) = Scales(**values, scheme=midpoint()).advice
    assert "the scheme midpoint does not resolve them" in said


def test_advice_foresees_steps_that_are_hard_to_solve():
    """By the moduli's ratio, by the densities', by waves that the midpoint rule leaves ringing."""
    from ngvisco.run.scales import Scales
    from ngvisco.timestepping.scheme import midpoint

    sound = {"length": 1.0, "cell": 0.1, "velocity": 0.1, "speeds": (10.0, 1.0), "kinematic_viscosity": 0.0}
    sound |= {"maxwell": math.inf, "dt": 0.02}
    assert Scales(**sound, scheme=midpoint()).advice == []
    (stiff,) = Scales(**sound | {"speeds": (200.0, 1.0)}).advice
    assert "4e+04 times that of shear" in stiff and "discretisation.k = 3" in stiff
    (ringing,) = Scales(**sound | {"speeds": (80.0, 1.0)}, scheme=midpoint()).advice
    assert "cross 16 cells a step, which midpoint does not damp" in ringing and "dt <= 0.013 s" in ringing
    assert Scales(**sound | {"speeds": (80.0, 1.0)}).advice == []  # backward Euler damps them
    (uneven,) = Scales(**sound, densities=1e5).advice
    assert "densities differ 1e+05 times" in uneven and "a ratio up to 100," in uneven
    assert Scales(**sound, one_bulk_energy=False).advice == []
    *_, unlike = Scales(**sound, densities=1e5, one_bulk_energy=False).advice
    assert "different bulk energies" in unlike and "K_e/2*(J + 1/J - 2)" in unlike


def test_waves_about_a_strained_state_have_the_speed_of_their_lagrangian_law():
    """Uniaxial strain of the Riemann problems' energy: stretch sqrt(P'/rho_0), by F, Cof F and J."""
    model = nv.Model(
        material=nv.CustomMaterial(
            transported=(Distortion(), Cofactor(), Jacobian()), stored_energy=riemann.energy
        )
    )
    step = nv.Simulation(box((1, 1), 0.6), model, dt=0.1).rothe_step
    for stretch in (1.0, 1.3):  # in compression waves across are faster
        F = CF((stretch, 0, 0, 0, 1, 0, 0, 0, 1), dims=(3, 3))
        values = {v.name: v.from_distortion(F) for v in model.material.variables}
        state = np.asarray(CF(model.material.states(2).components(values))(step.mesh(0.3, 0.3)))
        expected = stretch * math.sqrt(riemann._slope(stretch))
        assert wave_speed(step, state, 1 / stretch) == pytest.approx(expected, rel=1e-6)


def test_at_rest_the_velocity_scale_is_that_of_walls_or_of_waves():
    """In units of the problem: nothing else tells how wide the upwinding is smoothed."""
    model = nv.Model(material=NEO_HOOKEAN)
    still = nv.Simulation(box((1, 1), 0.6), model, dt=0.01, initial=nv.Initial(density=4.0))
    speed = math.sqrt(moduli(NEO_HOOKEAN, 2)[0] / 4.0)
    assert still.velocity_scale == pytest.approx(0.1 * speed, rel=1e-5)
    walls = {"top": nv.PrescribedTangential((-3e-3, 0.0))}
    lid = nv.Simulation(box((1, 1), 0.6), model, dt=0.01, walls=walls)
    assert lid.velocity_scale == pytest.approx(3e-3)


def test_a_run_does_not_depend_on_what_ran_before_it():
    """A wall's velocity at the start is that at t = 0, whatever time another run has left."""
    model = nv.Model(material=NEO_HOOKEAN)
    walls = {"top": nv.PrescribedTangential((0.5 + nv.time, 0.0))}
    found = []
    for left in (0.0, 7.0):
        nv.time.Set(left)
        found.append(nv.Simulation(box((1, 1), 0.6), model, dt=0.01, walls=walls).velocity_scale)
    assert found[0] == found[1] == pytest.approx(0.5)


def graded(factor=lambda place: place, dt=0.01):
    """Moduli that grow from left to right by half of their mean about it."""
    s = factor(0.5 + x)
    laws = {
        "material": nv.NeoHookean(K_e=1e6 * s, G_e=1e5 * s, epsilon=0.1),
        "viscosity": nv.StokesViscosity(K_v=20.0, G_v=10 * s),
        "creep": nv.Creep(G_m=1e3 * s),
    }
    return nv.Simulation(box((1, 1), 0.5), nv.Model(**laws), dt=dt)


def test_scales_of_moduli_that_are_functions_of_the_place_are_those_of_its_extremes():
    """The fastest waves, the thinnest layers, the shortest relaxation of the same laws with numbers."""
    run = graded()
    here = scales(run)
    values = [scales(graded(lambda _, c=c: c)) for c in run.rothe_step.ranges["K_e"] / np.float64(1e6)]
    assert here.speeds == pytest.approx(values[1].speeds, rel=1e-6)
    assert here.kinematic_viscosity == pytest.approx(values[0].kinematic_viscosity, rel=1e-6)
    assert here.maxwell == pytest.approx(values[1].maxwell, rel=1e-6)
    assert run.velocity_scale == pytest.approx(0.1 * here.speeds[0], rel=1e-5)
    assert any("waves cross the body" in line for line in here.advice)
    assert any("stress relaxes" in line for line in here.advice)


STIFF = {
    "material": nv.ReferentialNeoHookean(K_e=1000.0, G_e=500.0),
    "viscosity": nv.StokesViscosity(K_v=0.3, G_v=0.2),
    "density": 4.0,
}
SOFT = {
    "material": nv.ReferentialNeoHookean(K_e=10.0, G_e=0.5),
    "viscosity": nv.StokesViscosity(K_v=0.3, G_v=0.02),
    "creep": nv.Creep(G_m=0.01),
    "density": 1.0,
}


def of_bodies(*bodies):
    return nv.Simulation(box((1, 1), 0.4), nv.Model(bodies=bodies), dt=0.01)


def test_scales_of_bodies_are_those_of_each_by_itself():
    """The fastest waves are the stiff body's, however small it is; layers and relaxation the other's."""
    hard, soft = (scales(of_bodies(nv.Body(name="alone", **laws))) for laws in (STIFF, SOFT))
    for radius in (0.25, 0.05):  # the second one is smaller than a cell
        place = nv.Ball((0.45, 0.5), radius)
        run = of_bodies(nv.Body(name="disc", where=place, **STIFF), nv.Body(name="rest", **SOFT))
        here = scales(run)
        assert here.speeds == pytest.approx(hard.speeds, rel=1e-6)
        assert here.kinematic_viscosity == pytest.approx(soft.kinematic_viscosity, rel=1e-6)
        assert here.maxwell == pytest.approx(soft.maxwell, rel=1e-6) and hard.maxwell == math.inf
        assert run.velocity_scale == pytest.approx(0.1 * here.speeds[0], rel=1e-5)


def test_scales_of_a_body_with_moduli_of_the_place_are_those_of_its_own_extremes():
    """Not of values that its modulus has, carried on, in another body."""
    graded = STIFF | {"material": nv.ReferentialNeoHookean(K_e=1000.0, G_e=200 * (1 + x))}
    left = nv.Body(name="left", where=0.5 - x, **graded)
    here = scales(of_bodies(left, nv.Body(name="rest", **SOFT)))
    assert math.sqrt(400 * 1.4 / 4) < here.speeds[1] < math.sqrt(400 * 1.7 / 4)


def test_at_rest_rounding_of_the_energy_is_no_elastic_release():
    """K/2 (J - 1)^2 rounds to 1e-15 K, as of a velocity of 1e-8 c."""
    for size in ((1, 1), (1, 1, 1)):
        run = nv.Simulation(box(size, 0.8), nv.Model(material=NEO_HOOKEAN), dt=0.01)
        assert run.velocity_scale == pytest.approx(0.1 * math.sqrt(moduli(NEO_HOOKEAN, 2)[0]), rel=1e-5)
