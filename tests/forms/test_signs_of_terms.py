"""Signs and factors that the energy ledger cannot check, since the form and the column share them.

A body that moves as a whole is pushed for one short step: its momentum changes by the forces of its walls.
"""

import numpy as np
import pytest
from ngsolve import CF, IfPos, Integrate, cos, pi, sin, x, y

import ngvisco as nv
from ngvisco.forms.boundary import wall_terms
from ngvisco.forms.term import PointTerm
from ngvisco.geometries import box
from ngvisco.physics.tensors import inner

SOLID = nv.ReferentialNeoHookean(K_e=10.0, G_e=5.0)
DT = 1e-3


def pushed(left, right, velocity=(0.0, 0.0), density=1.0, model=None, **options):
    """Rate of the momentum, N, of a body between two walls of 1 m, in a box that is periodic in y."""
    model = model or nv.Model(material=SOLID)
    walls = {"left": left, "right": right}
    start = nv.Initial(velocity=velocity, density=density)
    mesh = box((1, 1), maxh=0.6, periodic="y")
    run = nv.Simulation(mesh, model, dt=DT, walls=walls, initial=start, **options)
    run.run(until=DT)
    names = ("momentum_1", "momentum_2")
    return np.array([run.ledger.column(name) for name in names]) @ [-1 / DT, 1 / DT], run


@pytest.mark.parametrize("solver", ["coupled", "split"])
def test_a_pressure_on_an_open_wall_pushes_inward(solver):
    force, _ = pushed(nv.Open(), nv.Open(pressure=0.3, traction=(0.1, 0.2)), solver=solver)
    np.testing.assert_allclose(force, (-0.3 + 0.1, 0.2), rtol=2e-3)


def test_an_impedance_has_factors_for_the_normal_and_the_tangential_velocity():
    V = (2e-3, 1e-3)  # V is small, so that little matter is carried through the wall
    wall = nv.Open(impedance=(2.0, 0.5))
    force, _ = pushed(wall, wall, V)
    np.testing.assert_allclose(force, (-2 * 2.0 * V[0], -2 * 0.5 * V[1]), rtol=0.05)


def test_springs_pull_back_in_proportion_to_the_displacement_of_the_wall():
    V = (2e-4, 1e-4)
    wall = nv.Open(stiffness=(200.0, 50.0))
    force, _ = pushed(wall, wall, V)
    np.testing.assert_allclose(force, (-2 * 200.0 * V[0] * DT, -2 * 50.0 * V[1] * DT), rtol=0.02)


def test_friction_slows_matter_down_and_a_traction_pulls_it():
    V = (0.0, 0.2)
    force, _ = pushed(nv.NavierFriction(0.7), nv.Traction(f=(0.0, 0.3), friction=0.2), V)
    assert force[1] == pytest.approx(-0.7 * V[1] + 0.3 - 0.2 * V[1], rel=0.01)


def test_inflow_brings_its_momentum():
    """Fluid enters a fluid at rest at 0.2 m/s, and brings the momentum rho v^2 per area and time."""
    velocity, density = 0.2, 3.0
    inlet = nv.Inflow(velocity=(velocity, 0.0), density=density)
    _, run = pushed(inlet, nv.Open(), (velocity, 0.0), density)
    carried = run.ledger.column("impulse_carried_left_1")[-1] / DT
    assert carried == pytest.approx(density * velocity**2, rel=1e-3)


@pytest.mark.parametrize("load", ["gravity", "force", "central"])
def test_loads_accelerate_matter_in_their_direction(load):
    loads = {
        "gravity": (nv.Gravity((0.3, -0.2)), (3 * 0.3, 3 * -0.2)),
        "force": (nv.BodyForce((0.3, -0.2)), (0.3, -0.2)),
        "central": (nv.CentralGravity(strength=0.5, radius=1.0, exponent=1, centre=(-5.0, 0.5)), None),
    }
    given, expected = loads[load]
    force, _ = pushed(nv.Open(), nv.Open(), density=3.0, model=nv.Model(material=SOLID, loads=[given]))
    if expected is None:  # the load points towards its centre
        assert force[0] < -1.0
    else:
        np.testing.assert_allclose(force, expected, rtol=1e-3)


def test_the_density_is_carried_along_by_the_flow():
    """A soft body moves as a whole. A density transported in the wrong direction would not change the
    ledger's mass."""
    model = nv.Model(material=nv.LinearElastic(K_e=1e-3, G_e=1e-3))
    start = nv.Initial(density=1 + 0.3 * sin(2 * pi * x), velocity=(1.0, 0.0))
    mesh = box((1, 1), maxh=0.2, periodic="xy")
    run = nv.Simulation(mesh, model, dt=0.02, initial=start, scheme="midpoint", solver="split")
    run.run(until=0.1)
    rho, exact = run.fields["density"], 1 + 0.3 * sin(2 * pi * (x - 0.1))
    error, moved = (Integrate((f - exact) ** 2, mesh) for f in (rho, 1 + 0.3 * sin(2 * pi * x)))
    assert error < 0.1**2 * moved


def test_damping_of_the_velocity_slows_matter_down():
    law = nv.Regularisation(epsilon=0.4, p=3.0)
    V = (0.0, 0.2)
    force, run = pushed(nv.Slip(), nv.Slip(), V, model=nv.Model(material=SOLID, regularisation=law))
    lost = run.ledger.column("dissipation_epsilon")[-1]
    assert lost == pytest.approx(0.4 * V[1] ** 3, rel=0.01)
    assert force[1] == pytest.approx(-lost / V[1], rel=0.01)


def test_the_pressure_that_laws_read_is_that_of_the_stress():
    """The pressure is -tr T/3, in a body that is compressed and stretched."""
    F = CF((0.9, 0.1, 0, 0, 1.2, 0, 0, 0, 1), dims=(3, 3))
    run = nv.Simulation(box((1, 1), 0.7), nv.Model(material=SOLID), dt=0.1, initial=nv.Initial(F=F))
    step = run.rothe_step
    run.rothe_step.local_unknowns.update()
    read = step.context.rates.pressure(step.now)
    J = 0.9 * 1.2
    p = -10.0 * (J - 1)  # p = -U'(J) with U = K/2 (J - 1)^2
    at = run.mesh(0.3, 0.4)
    assert run.fields["pressure"](at) == pytest.approx(p, rel=1e-10)
    assert read(at) == pytest.approx(p, rel=1e-10)


def test_plastic_strain_grows_by_the_equivalent_rate():
    """dk/dt = sqrt(2/3) |Pi| in one step of a sheared body that yields; Pi is the creep rate of the run."""
    rule = nv.Perzyna(G_m=0.5, sigma_Y=0.1, H=2.0)
    E = CF((0, 0.3, 0, 0.3, 0, 0, 0, 0, 0), dims=(3, 3))
    model = nv.Model(material=nv.LinearElastic(K_e=10.0, G_e=5.0), creep=rule)
    run = nv.Simulation(box((1, 1), 0.7), model, dt=0.01, initial=nv.Initial(values={"E": E}))
    run.run(until=0.01)
    at, step = run.mesh(0.3, 0.4), run.rothe_step
    (Pi,) = step.context.rates.creep(step.now)
    rate = np.sqrt(inner(Pi, Pi)(at))
    assert rate > 0.1
    assert run.fields["plastic_strain"](at) == pytest.approx(np.sqrt(2 / 3) * rate * 0.01, rel=0.02)


def test_a_temperature_rise_causes_the_thermal_pressure():
    """The pressure is Gamma c (theta - theta_R) = K alpha (theta - theta_R) as long as nothing has moved."""
    material = nv.Thermal(material=SOLID, c=2.0, theta_R=300.0, expansion=1e-3)
    start = nv.Initial(temperature=350.0)
    run = nv.Simulation(box((1, 1), 0.7), nv.Model(material=material), dt=0.1, initial=start)
    assert run.fields["pressure"](run.mesh(0.3, 0.4)) == pytest.approx(10.0 * 1e-3 * 50.0, rel=1e-9)


class Feeding(PointTerm):
    """A drag by a wind that is faster than the body on the right, and slower elsewhere."""

    def cells(self, u, w):
        return [u.context.given(STRENGTH) * inner(u.v, w.v)]

    def dissipated(self, u):
        return {"dissipation_feeding": u.context.given(STRENGTH) * inner(u.v, u.v)}


STRENGTH = IfPos(x - 0.8, -0.1, 1.0)


@pytest.mark.parametrize("solver", ["coupled", "split"])
def test_a_dissipation_that_gives_energy_at_a_point_is_named(solver):
    """The ledger closes, since form and column have the same law, and the dissipation in sum is positive."""
    start = nv.Initial(velocity=(0.0, 0.1))
    options = {"initial": start, "terms": [Feeding()], "solver": solver}
    run = nv.Simulation(box((1, 1), 0.4, periodic="y"), nv.Model(material=SOLID), dt=DT, **options)
    match = r"dissipation_feeding is negative \(-0.001.* at \((0.[89]|1).* and produces energy"
    with pytest.warns(nv.DissipationWarning, match=match) as caught:
        ledger = run.run(until=2 * DT)
    assert len([w for w in caught if w.category is nv.DissipationWarning]) == 1
    assert abs(ledger.column("closure_relative")).max() < 1e-10
    assert ledger.column("dissipation_feeding")[-1] > 0


def test_a_wall_that_gives_energy_is_named(monkeypatch):
    along_and_across = wall_terms.along_and_across
    monkeypatch.setattr(wall_terms, "along_and_across", lambda *given: -along_and_across(*given))
    with pytest.warns(
        nv.DissipationWarning, match=r"dissipation_impedance_right is negative \(-.* and produces energy"
    ):
        pushed(nv.Open(), nv.Open(impedance=(1.0, 0.5)), (0.2, 0.1))


def test_dissipation_of_anisotropic_viscosities_is_judged_by_its_sum():
    """In an anisotropic viscosity, the dissipation of the volumetric part alone may be negative."""
    D = np.diag([1.0, 0.1, 0.1, 0.1, 0.1, 0.1])
    law = nv.LinearViscosity(D=D, notation="mandel")
    start = nv.Initial(velocity=(0.1 * sin(pi * x) * cos(pi * y), -0.2 * cos(pi * x) * sin(pi * y)))
    run = nv.Simulation(box((1, 1), 0.5), nv.Model(material=SOLID, viscosity=law), dt=DT, initial=start)
    ledger = run.run(until=DT)
    assert ledger.column("dissipation_stokes_bulk")[-1] < -1e-4
