"""Runs with bodies do not depend on the units: thresholds of interfaces are shares, not lengths or moduli."""

import numpy as np
import pytest
from ngsolve import y

import ngvisco as nv
from ngvisco.geometries import structured_box
from ngvisco.physics.variables import Jacobian
from tests.support import others_by_ci

KINDS = {
    "parts": {"m": 1},
    "outlines": {"m": 1, "sharp": True, "outlines": True},
    "parts, constants in cells": {"m": 0},
    "sharp": {"m": 1, "sharp": True},
}
UNITS = {"steel, in kg, m and s": (1.0, 1e9, 1.0), "a grain, in kg, m and s": (1e-9, 1e-24, 1e-4)}
"""Units of length, m, of mass, kg, and of time, s, in which the numbers of the run are given."""


def driven(kind, length=1.0, mass=1.0, time=1.0):
    """Kinetic and stored energy and mass at the end, in the given units. A body falls and shears in a gas or,
    without ``parts``, in a fluid of its own density and bulk modulus."""
    pressure, density, speed = mass / (length * time**2), mass / length**3, length / time
    parts, m = kind.startswith("parts"), KINDS[kind]["m"]
    bulk, light = ((0.4, 0.2), (2e-3, 1e-3))[m == 0] if parts else (2.0, 1.0)

    def energy(J):
        return bulk * pressure / 2 * (J - 1) * (J - 1) / J

    gas = nv.CustomMaterial(transported=(Jacobian(),), stored_energy=energy)
    solid = nv.ReferentialNeoHookean(K_e=2 * pressure, G_e=0.5 * pressure)
    damped, thin = (
        nv.StokesViscosity(K_v=v * pressure * time, G_v=v * pressure * time) for v in (0.02, 1e-4)
    )
    place = 0.4 * length - y if parts else nv.Ball((0.5 * length, 0.5 * length), 0.27 * length)
    body = {"where": place, "material": solid, "density": density, "viscosity": damped, "parts": parts}
    bodies = [
        nv.Body(name="block", **body),
        nv.Body(name="gas", material=gas, density=light * density, viscosity=thin),
    ]
    pull = (0.2 * y / time**2, -0.5 * speed / time)
    run = nv.Simulation(
        structured_box((0.5 * length, length), (2, 4)),
        nv.Model(bodies=bodies, loads=(nv.Gravity(pull),)),
        dt=0.1 * time,
        discretisation=nv.Discretisation(k=m + 1, **KINDS[kind]),
    )
    ledger = run.run(0.3 * time)
    energies = [ledger.column(name)[-1] / (mass * speed**2 / length) for name in ("kinetic", "stored")]
    return np.array([*energies, ledger.column("mass")[-1] / (mass / length)])


@pytest.mark.long
@pytest.mark.ci
@pytest.mark.parametrize("kind", others_by_ci(KINDS, "parts", "outlines"))
def test_energies_of_runs_with_bodies_do_not_depend_on_the_units(kind):
    expected = driven(kind)
    for units in UNITS.values():
        assert driven(kind, *units) == pytest.approx(expected, rel=1e-9)
