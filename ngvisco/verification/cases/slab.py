"""A viscoelastic slab bends under its weight in a weak medium, and recovers its shape without gravity.

After T. Gerya, Introduction to Numerical Geodynamic Modelling (2010), the recovery of the shape of a
viscoelastic slab: 4.5 km x 0.5 km, held at one side of a box of 7.5 km x 5 km.  Its Maxwell time,
1e24 Pa s/1e10 Pa, is 3 Myr, that of the medium, 1e18 Pa s/1e11 Pa, four months: in steps of thousands of
years the one is elastic and the other a fluid of 1e18 Pa s, and so it is taken here.  Inertia stays in the
equations; it is nothing, 1e-20 of the stored energy, and an implicit step does not see its waves.

What bends is q = drho g a, the weight in the medium per length.  Its elastic end is the beam's,

    mean w = q L^4/(20 E' I) + q L^2/(3 kappa G a),      E' = 4 G, I = a^3/12, kappa = 5/6 (incompressible),

which the medium lets it approach slowly.  While deflections are small all is linear in the load: with Y(t)
the answer to a weight that acts from t = 0, that to one which ends at t_1 is Y(t) - Y(t - t_1).
"""

from __future__ import annotations

from functools import cache

import numpy as np
from ngsolve import CF, IfPos

from ngvisco.geometries import structured_box
from ngvisco.physics.bodies import Body
from ngvisco.physics.materials import CustomMaterial, OldroydB
from ngvisco.physics.model import Gravity, Model
from ngvisco.physics.rheology import Creep, StokesViscosity
from ngvisco.physics.time import time
from ngvisco.physics.variables import Jacobian
from ngvisco.physics.walls import NoSlip
from ngvisco.run.bodies import Bodies
from ngvisco.run.simulation import Simulation
from ngvisco.shapes.solids import Block
from ngvisco.verification.case import Bound, Case, Curve, Outcome, Plot, Table
from ngvisco.verification.setups import closure

KYR = 3.15576e10
SIZE, CELLS = (7500.0, 5000.0), (5, 20)
LENGTH, THICKNESS = 4500.0, 500.0
SHEAR, BULK = 1e10, 1e12
"""Pa; the bulk modulus is both bodies', and makes them nearly incompressible."""
OF_SLAB, OF_MEDIUM = 1e24, 1e18
"""Viscosities, Pa s."""
HEAVY, LIGHT, GRAVITY = 3300.0, 2800.0, 10.0
TAU, LOADED, END = 5.0, 20.0, 50.0
"""kyr."""
FLEXURE = 4 * SHEAR * THICKNESS**3 / 12
WEIGHT = (HEAVY - LIGHT) * GRAVITY * THICKNESS
AT_REST = WEIGHT * LENGTH**4 / (20 * FLEXURE) + WEIGHT * LENGTH**2 / (3 * 5 / 6 * SHEAR * THICKNESS)
"""The mean deflection of the beam under its weight, m."""


@cache
def _slab(loaded: float, end: float) -> tuple[Simulation, Bodies]:
    """Until ``end``, with gravity until ``loaded``, kyr."""
    fluid = CustomMaterial(transported=(Jacobian(),), stored_energy=lambda J: BULK / 2 * (J + 1 / J - 2))
    middle = SIZE[1] / 2
    slab = Body(
        name="slab",
        where=Block((-SIZE[0], middle - THICKNESS / 2), (LENGTH, middle + THICKNESS / 2)),
        material=OldroydB(K_e=BULK, G_e=SHEAR / 2),
        creep=Creep(G_m=2 * OF_SLAB),
        density=HEAVY,
    )
    medium = Body(
        name="medium", material=fluid, viscosity=StokesViscosity(K_v=0.0, G_v=OF_MEDIUM), density=LIGHT
    )
    gravity = CF((0.0, -GRAVITY)) * IfPos(loaded * KYR - time, 1.0, 0.0)
    table = Bodies()
    run = Simulation(
        structured_box(SIZE, CELLS),
        Model(bodies=[slab, medium], loads=[Gravity(gravity)]),
        dt=TAU * KYR,
        walls={"left": NoSlip()},
        solver="coupled",
        velocity_scale=1e-9,
        observers=[table],
    )
    run.run(end * KYR)
    return run, table


def _bending() -> Outcome:
    (released, of_released), (held, of_held) = _slab(LOADED, END), _slab(END, 2 * LOADED)
    times = np.round(of_released.column("time") / KYR, 6)
    one, other = (table.column("slab_y")[0] - table.column("slab_y") for table in (of_released, of_held))
    n, both = round(LOADED / TAU), len(other)
    expected = other.copy()
    expected[n:] -= other[: both - n]
    bent, last = float(one[n]), float(one[-1])
    at_end = float(
        other[n] ** 2 / (2 * other[n] - other[2 * n])
    )  # of a + b exp(-t/T) through 0, t_1 and 2 t_1
    stored = released.ledger.column("stored")
    kinetic = float(released.ledger.column("kinetic").max() / stored[n])
    drift = max(float(np.abs(run.ledger.column("mass_drift")).max()) for run in (released, held))
    return Outcome(
        values={
            "mean deflection when gravity ends, m": bent,
            "what is left of it at the end": last / bent,
            "distance from superposition": float(np.abs(one[:both] - expected).max()) / bent,
            "extrapolated elastic end over the beam's, less one": abs(at_end / AT_REST - 1),
            "kinetic over stored energy": kinetic,
            "drift of the mass": drift,
            "largest |closure|": closure(released, held),
        },
        tables=[
            Table(
                "mean deflection, m",
                ["t, kyr", "released", "superposed", "held"],
                [[float(v) for v in row] for row in zip(times, one, expected, other, strict=False)],
            )
        ],
        remarks=[f"The beam's mean deflection at rest is {AT_REST:.1f} m, that extrapolated {at_end:.1f} m."],
        plots=[
            Plot(
                "A slab in a weak medium",
                "t, kyr",
                "mean deflection, m",
                [
                    Curve("gravity until 20 kyr", list(times), list(one), "o-"),
                    Curve("gravity all the time", list(times[:both]), list(other), "s-"),
                    Curve("superposed from it", list(times[:both]), list(expected), "k--"),
                ],
            )
        ],
    )


CASES = (
    Case(
        name="slab-recovery",
        theme="Bodies and their interfaces",
        statement="A viscoelastic slab in a weak medium bends under its weight towards the elastic end of "
        "beam theory, and goes back when gravity ends; the answer to the load is linear.",
        label="Gerya 2010",
        setting=f"{SIZE[0]:g} m x {SIZE[1]:g} m, slab {LENGTH:g} m x {THICKNESS:g} m; densities {HEAVY:g} "
        f"and {LIGHT:g} kg/m3, viscosities {OF_SLAB:g} and {OF_MEDIUM:g} Pa s, G = {SHEAR:g} Pa in the slab, "
        f"K_e = {BULK:g} Pa; g = {GRAVITY:g} m/s2 until {LOADED:g} kyr; {2 * CELLS[0] * CELLS[1]} triangles, "
        f"backward Euler, tau = {TAU:g} kyr, inertia as it is.",
        bounds=(
            Bound("mean deflection when gravity ends, m", ">=", 10.0, "it bends"),
            Bound("what is left of it at the end", "<=", 0.9, "it goes back"),
            Bound("distance from superposition", "<=", 0.05, "deflections of a few per cent of the length"),
            Bound(
                "extrapolated elastic end over the beam's, less one",
                "<=",
                0.3,
                "one exponential for all modes of the beam, three cells along it",
            ),
            Bound("kinetic over stored energy", "<=", 1e-15, "nothing moves by inertia"),
            Bound("drift of the mass", "<=", 1e-10, "conserved"),
            Bound("largest |closure|", "<=", 1e-10, "the tolerance of Newton's iteration"),
        ),
        run=_bending,
    ),
)
