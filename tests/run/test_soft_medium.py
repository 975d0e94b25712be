"""A soft light medium stands for the empty space around a body: a clamped bar in it swings as a beam does."""

import numpy as np
import pytest

import ngvisco as nv
from ngvisco.geometries import structured_box
from ngvisco.physics.variables import Jacobian

GRAVITY, UNTIL = 2e-3, 3.0


def drop(modulus):
    """Mean deflection after 3 s of a bar of 1 m x 0.2 m, G = 1 Pa, in a medium of this shear modulus, m."""
    fluid = nv.CustomMaterial(transported=(Jacobian(),), stored_energy=lambda J: 0.1 * (J + 1 / J - 2))
    medium = nv.ReferentialNeoHookean(K_e=0.2, G_e=modulus / 2) if modulus else fluid
    thin = nv.StokesViscosity(K_v=5e-5, G_v=5e-5)
    bodies = [
        nv.Body(
            name="bar",
            where=nv.Block((0.0, 0.3), (1.0, 0.5)),
            material=nv.ReferentialNeoHookean(K_e=2.0, G_e=0.5),
            density=1.0,
        ),
        nv.Body(name="medium", material=medium, viscosity=thin, density=0.02),
    ]
    table = nv.Bodies()
    run = nv.Simulation(
        structured_box((1.25, 0.8), (5, 8)),
        nv.Model(bodies=bodies, loads=[nv.Gravity((0.0, -GRAVITY))]),
        time=nv.TimeSteps(dt=0.5, scheme="midpoint", velocity_scale=1.0),
        walls={"left": nv.NoSlip()},
        observers=[table],
    )
    ledger = run.run(UNTIL)
    assert np.abs(ledger.column("closure_relative")).max() <= 1e-10
    return float(table.column("bar_y")[0] - table.column("bar_y")[-1])


@pytest.mark.long
@pytest.mark.ci
def test_a_bar_in_a_light_fluid_swings_as_in_empty_space_and_an_elastic_medium_holds_it():
    """Beam theory: E' = 2.8 Pa, omega = 3.516 sqrt(E' I/(rho a L^4)), w = q L^4/(20 E' I) (1 - cos omega t).

    The fluid's mass and the bar's shear take up to two fifths of that; a medium a tenth as stiff nearly all.
    """
    flexure = 2.8 * 0.2**3 / 12
    omega = 3.516 * (flexure / 0.2) ** 0.5
    beam = GRAVITY * 0.2 * 0.98 / (20 * flexure) * (1 - np.cos(omega * UNTIL))
    free, held = drop(0.0), drop(0.1)
    assert free == pytest.approx(0.8 * beam, rel=0.25)
    assert held < 0.3 * free
