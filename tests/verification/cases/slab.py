"""A viscoelastic slab bends under its weight in a weak medium, and recovers its shape without gravity.

After T. Gerya, Introduction to Numerical Geodynamic Modelling (2010), the recovery of the shape of a
viscoelastic slab: 4.5 km x 0.5 km, held at one side of a box of 7.5 km x 5 km.  Its Maxwell time,
1e24 Pa s/1e10 Pa, is 3 Myr, that of the medium, 1e18 Pa s/1e11 Pa, four months: in steps of a thousand
years the one is elastic and the other a fluid of 1e18 Pa s, and so it is taken here.  Inertia stays in the
equations; it is nothing, and an implicit step does not see its waves.

What bends is q = drho g a, the weight in the medium per length.  Its elastic end is the beam's,

    mean w = q L^4/(20 E' I) + q L^2/(3 kappa G a),      E' = 4 G, I = a^3/12, kappa = 5/6 (incompressible),

which the medium lets it approach slowly, and from which it comes back as slowly.

Numbers of a cell's matrix lie between its mass over a step, |K|/tau = 1e-6 m^2/s, and its stiffness,
K_e |K| = 1e17 N/m.  NGSolve's elimination of a cell's own unknowns, as the coupled solver does it, takes
such a matrix for singular, though with its rows and columns scaled its condition is 3.  The split solver,
which meshes of this size have by default, scales by itself.
"""

import numpy as np
from ngsolve import CF, IfPos

import ngvisco as nv
from ngvisco.geometries import structured_box
from ngvisco.physics.signals import time
from tests.verification.case import Cases, Curve, Outcome, Plot, Table, measured
from tests.verification.setups import fluid

CASES = Cases("Bodies and their interfaces")

KYR = 3.15576e10
SIZE, CELLS = (7500.0, 5000.0), (15, 20)
LENGTH, THICKNESS, MIDDLE = 4500.0, 500.0, 2500.0
"""Of the slab, which is two rows of cells, m."""
SHEAR, BULK = 1e10, 1e11
"""Pa; the bulk modulus is both bodies'."""
OF_SLAB, OF_MEDIUM = 1e24, 1e18
"""Viscosities, Pa s."""
HEAVY, LIGHT, GRAVITY = 3300.0, 2800.0, 10.0
TAU, LOADED, END = 1.0, 20.0, 50.0
"""kyr."""
FLEXURE = 4 * SHEAR * THICKNESS**3 / 12
WEIGHT = (HEAVY - LIGHT) * GRAVITY * THICKNESS
AT_REST = WEIGHT * LENGTH**4 / (20 * FLEXURE) + WEIGHT * LENGTH**2 / (3 * 5 / 6 * SHEAR * THICKNESS)
"""The mean deflection of the beam under its weight, m."""


def _slab() -> tuple[nv.Simulation, nv.Bodies]:
    """Until ``END``, with gravity until ``LOADED``."""
    slab = nv.Body(
        name="slab",
        where=nv.Block((-SIZE[0], MIDDLE - THICKNESS / 2), (LENGTH, MIDDLE + THICKNESS / 2)),
        material=nv.ReferentialNeoHookean(K_e=BULK, G_e=SHEAR / 2),
        creep=nv.Creep(G_m=2 * OF_SLAB),
        density=HEAVY,
    )
    weak = nv.StokesViscosity(K_v=0.0, G_v=OF_MEDIUM)
    medium = nv.Body(name="medium", material=fluid(BULK), viscosity=weak, density=LIGHT)
    gravity = CF((0.0, -GRAVITY)) * IfPos(LOADED * KYR - time, 1.0, 0.0)
    table = nv.Bodies()
    run = nv.Simulation(
        structured_box(SIZE, CELLS),
        nv.Model(bodies=(slab, medium), loads=(nv.Gravity(gravity),)),
        # twenty times the velocity of the slab: facets turn round within 1e-12 m/s
        time=nv.TimeSteps(dt=TAU * KYR, velocity_scale=1e-8),
        walls={"left": nv.NoSlip()},
        observers=[table],
    )
    run.run(END * KYR)
    return run, table


@CASES(f"""slab-recovery
    A viscoelastic slab in a weak medium bends under its weight, no farther than its elastic end, and goes
      back when gravity ends.
    label: benchmark: Gerya (2010)
    setting: Box {SIZE[0]:g} m x {SIZE[1]:g} m, slab {LENGTH:g} m x {THICKNESS:g} m; densities {HEAVY:g} and
      {LIGHT:g} kg/m3, viscosities {OF_SLAB:g} and {OF_MEDIUM:g} Pa s, G = {SHEAR:g} Pa in the slab, K_e =
      {BULK:g} Pa; g = {GRAVITY:g} m/s2 until {LOADED:g} kyr; {2 * CELLS[0] * CELLS[1]} triangles, backward
      Euler, tau = {TAU:g} kyr, inertia as it is.
    - mean deflection when gravity ends, m >= 10.0: it bends
    - mean deflection over the beam's at rest <= 1.0: the elastic end of beam theory
    - what is left of it at the end <= 0.9: it goes back
    - largest step downwards after gravity, m <= 0.0: all the time
    - kinetic over stored energy <= 1e-15: nothing moves by inertia
    - drift
    - closure
    """)
def _bending() -> Outcome:
    run, table = _slab()
    times = np.round(table.column("time") / KYR, 6)
    deflection = table.column("slab_y")[0] - table.column("slab_y")
    n, stored = int(np.searchsorted(times, LOADED)), run.ledger.column("stored")
    bent, slab_stored = float(deflection[n]), table.column("slab_stored")
    return measured(
        {
            "mean deflection when gravity ends, m": bent,
            "mean deflection over the beam's at rest": bent / AT_REST,
            "what is left of it at the end": float(deflection[-1]) / bent,
            "largest step downwards after gravity, m": float(np.diff(deflection[n:]).max()),
            "kinetic over stored energy": float(run.ledger.column("kinetic").max() / stored[n]),
        },
        Table(
            "the slab",
            "t, kyr | mean deflection, m | stored in the slab, J/m",
            list(zip(times, deflection, slab_stored, strict=True)),
        ),
        Plot(
            "A slab in a weak medium",
            "t, kyr",
            "mean deflection, m",
            [Curve("gravity until 20 kyr", times, deflection)],
        ),
        f"The beam's mean deflection at rest under its weight in the medium is {AT_REST:.1f} m.",
    )
