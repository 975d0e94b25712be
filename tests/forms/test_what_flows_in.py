"""Bodies and heat that cross walls: their balances close, and what comes in is what was given."""

import numpy as np
import pytest
from ngsolve import Integrate, cos, pi, sin, x, y
from support import assert_balanced

import ngvisco as nv
from ngvisco.geometries import box, structured_box
from ngvisco.physics.variables import Jacobian

FLUID = nv.CustomMaterial(transported=(Jacobian(),), stored_energy=lambda J: 5 * (J + 1 / J - 2))
ELASTIC = nv.ReferentialNeoHookean(K_e=10.0, G_e=1.0)
VISCOUS = nv.StokesViscosity(K_v=0.1, G_v=0.1)
WARM = nv.Thermal(material=ELASTIC, c=2.0, expansion=1e-3, theta_R=300.0)


def stream(*observers, **options):
    """A soft disc of density 2 in a medium of 1 that flows through at 1 m/s."""
    what = {"viscosity": VISCOUS}
    disc = nv.Body(name="disc", where=nv.Ball((0.5, 0.5), 0.2), material=ELASTIC, density=2.0, **what)
    model = nv.Model(bodies=[disc, nv.Body(name="medium", material=FLUID, density=1.0, **what)])
    walls = {
        "left": nv.Inflow(velocity=(1.0, 0.0), amounts={"medium": 1.0}),
        "right": nv.Open(amounts={"medium": 1.0}, stiffness=(2.0, 1.0), impedance=(0.5, 0.5)),
    }
    options = {"initial": nv.Initial(velocity=(1.0, 0.0)), "walls": walls, "observers": observers, **options}
    return nv.Simulation(box((1.5, 1.0), 0.2), model, dt=0.02, **options)


def test_bodies_are_carried_through_a_window_and_keep_their_masses():
    states = []
    for solver in ("split", "coupled"):
        table = nv.Bodies()
        run = stream(table, solver=solver)
        ledger = run.run(0.12)
        assert_balanced(ledger)
        disc, medium = (table.column(f"{name}_mass") for name in ("disc", "medium"))
        assert abs(disc / disc[0] - 1).max() < 1e-6  # it is far from the walls
        came = 0.02 * sum(ledger.column(f"inflow_{wall}") for wall in ("left", "right")).cumsum()
        assert came[-1] > 0.005  # a body on springs holds back
        assert np.allclose(disc + medium - disc[0] - medium[0], came, atol=1e-12)
        moved = table.column("disc_x")[-1] - 0.5
        assert 0.08 < moved < 0.12
        states.append(run.rothe_step.state.vec.FV().NumPy().copy())
    assert abs(states[0] - states[1]).max() < 1e-9 * abs(states[0]).max()


@pytest.mark.parametrize("solver", ["split", "coupled"])
def test_heat_is_carried_through(solver):
    walls = {
        "left": nv.Inflow(velocity=(1.0, 0.0), density=1.0, temperature=330.0),
        "right": nv.Open(density=1.0, impedance=(1.0, 1.0)),
    }
    model = nv.Model(material=WARM, viscosity=VISCOUS, heat=nv.Heat(conductivity=0.05))
    start = nv.Initial(density=1.0, velocity=(1.0, 0.0), temperature=300.0)
    run = nv.Simulation(box((1, 1), 0.5), model, dt=0.2, walls=walls, initial=start, solver=solver)
    ledger = run.run(3.0)
    assert abs(ledger.column("closure_relative")).max() < 1e-10
    rates = [name for name in ledger.columns if name.startswith("entropy_")]
    assert "entropy_supply_left_carried" in rates and "entropy_supply_right_carried" in rates
    supplied = ledger.column("dt") * sum(ledger.column(name) for name in rates)
    entropy = ledger.column("entropy")
    assert abs(np.diff(entropy) - supplied[1:]).max() < 1e-11 * abs(entropy).max()
    theta = run.fields["temperature"]
    assert abs(Integrate(theta, run.mesh) - 330.0) < 0.3  # three times what was there has left


@pytest.mark.parametrize(
    ("wall", "message"),
    [
        ({}, r"amounts = \{\}: expected which of the bodies flows in"),
        ({"amounts": {"medium": 1.0}, "density": 1.0}, "density = 1.0: expected none with bodies"),
        ({"amounts": {"medium": -1.0}}, r"amounts.*expected the sum of the amounts > 0|>= 0"),
        ({"amounts": {"medium": 1.0, "disc": -0.1}}, r"amounts\['disc'\] = .*>= 0"),
        ({"amounts": {"medium": 1.0}, "values": {"n_disc": 0.1}}, r"'disc' in walls"),
        ({"amounts": {"medium": 1.0}, "temperature": 300.0}, "temperature = 300.0: expected None"),
    ],
)
def test_bodies_that_flow_in_are_looked_at(wall, message):
    with pytest.raises(nv.ParameterError, match=r"walls\['right'\]\." + ".*(" + message + ")"):
        stream(walls={"right": nv.Open(**wall)})


def test_an_unknown_body_that_flows_in_is_named():
    with pytest.raises(nv.UnknownNameError, match="did you mean 'medium'"):
        stream(walls={"right": nv.Open(amounts={"medum": 1.0})})


def test_backflow_is_a_dissipation_in_every_step_whatever_side_was_expected():
    swirl = (0.3 * sin(pi * x) * cos(pi * y), -0.3 * cos(pi * x) * sin(pi * y))
    walls = {"left": nv.Open(density=1.0), "right": nv.Open(density=1.0, impedance=(1.0, 0.5))}
    model = nv.Model(material=FLUID, viscosity=VISCOUS)
    initial, orders = nv.Initial(velocity=swirl), nv.Discretisation(m=0)
    run = nv.Simulation(
        structured_box((1, 1), (3, 3)), model, dt=0.02, walls=walls, initial=initial, discretisation=orders
    )
    ledger = run.run(0.1)
    assert abs(ledger.column("closure_relative")).max() < 1e-10
    taken = np.concatenate([ledger.column(f"dissipation_backflow_{wall}")[1:] for wall in walls])
    assert taken.min() >= 0 and taken.max() > 1e-5
