"""A gel that settles under a load as its solvent leaves, against Terzaghi's consolidation."""

import numpy as np
from ngsolve import CoefficientFunction

import ngvisco as nv
from ngvisco.geometries import structured_box
from ngvisco.physics.variables import Concentration, ReciprocalJacobian
from tests.verification.case import Cases, Measured, Table

CASES = Cases("Exact solutions: layers and fronts")

DRAINED, UNDRAINED, LOAD, MOBILITY = 10.0, 1e3, 0.01, 0.1
"""Moduli of the gel without and with the pressure of its solvent and the load, Pa; m^2/(Pa s)."""
TAU, INSTANTS = 0.02, (0.06, 0.2, 0.5, 1.0)
"""Step, and times at which the settlement is compared, s."""
DIFFUSIVITY = MOBILITY * DRAINED / (1 + DRAINED / UNDRAINED)


def _energy(A: CoefficientFunction, c: CoefficientFunction) -> CoefficientFunction:
    """The energy K (J - 1)^2/2 + K_u (J - 1 - n)^2/2, n = c J, per referential volume, over J."""
    strain, room = 1 - A, 1 - A - c
    return (0.5 * DRAINED * strain * strain + 0.5 * UNDRAINED * room * room) / A


def _settled(t: float) -> float:
    """The settlement without loss of solvent, and the share of the rest by Terzaghi's series."""
    odd = (2 * np.arange(200) + 1) * np.pi
    share = 1 - float((8 / odd**2 * np.exp(-(odd**2) * DIFFUSIVITY * t / 4)).sum())
    at_once = LOAD / (DRAINED + UNDRAINED)
    return at_once + share * (LOAD / DRAINED - at_once)


@CASES(f"""consolidation
    A gel under a load settles as its solvent leaves through the loaded side, as in Terzaghi's theory:
      diffusion of a concentration, swelling and stress act together.
    label: Terzaghi 1923
    setting: A layer of 1 m between slip walls, K = {DRAINED:g} Pa, and {UNDRAINED:g} Pa more with its
      solvent, mobility {MOBILITY:g} m2/(Pa s); the open top bears {LOAD:g} Pa at once and is held at the
      potential 0; 8 x 1 rectangles, sdirk2, steps of {TAU:g} s; strains below {LOAD / DRAINED:g}. The bounds
      were stated before trials.
    - least settlement over the exact one in [0.98, 1.02]: eight cells across the layer
    - largest settlement over the exact one in [0.98, 1.02]: eight cells across the layer
    - largest |closure| <= 1e-8: the energy is 1e-8 of the moduli, so that rounding of 1/J counts
    """)
def _consolidation() -> Measured:
    gel = nv.CustomMaterial(transported=(ReciprocalJacobian(), Concentration("c")), stored_energy=_energy)
    drained = {"top": nv.WallExchange(potential=0.0, coefficient=1e3)}
    model = nv.Model(
        material=gel,
        viscosity=nv.StokesViscosity(K_v=0.01, G_v=0.01),
        diffusion=nv.Diffusion(variable="c", mobility=MOBILITY, walls=drained),
    )
    run = nv.Simulation(
        structured_box((0.25, 1), (1, 8)),
        model,
        time=nv.TimeSteps(dt=TAU, scheme="sdirk2", velocity_scale=LOAD),
        initial=nv.Initial(density=0.01),
        walls={"top": nv.Open(pressure=LOAD, displacement=True)},
    )
    rows = []
    for t in INSTANTS:
        run.run(t)
        rows.append([t, -run.fields["displacement_top"](run.mesh(0.1, 1.0))[1], _settled(t)])
    ratios = [computed / exact for _, computed, exact in rows]
    yield "least settlement over the exact one", min(ratios)
    yield "largest settlement over the exact one", max(ratios)
    yield from Table("settlement", "t, s | computed, m | exact, m", rows).drawn(0, 1, 2)
