"""A gel that settles under a load as its solvent leaves, and a gel that swells to twice its height."""

import numpy as np
from ngsolve import CoefficientFunction
from scipy.optimize import fsolve

import ngvisco as nv
from ngvisco.geometries import structured_box
from ngvisco.physics.tensors import log, square
from ngvisco.physics.variables import Concentration, Distortion, Jacobian, ReciprocalJacobian
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


NETWORK, CHI, TIGHT, SWOLLEN = 0.05, 0.3, 50.0, 1.5
"""Shear modulus of the network, Flory's parameter, and the modulus that couples volume and solvent, in units
of kT over the volume of a molecule; height at the start over the dry height."""


def _swelling_energy(
    F: CoefficientFunction, J: CoefficientFunction, A: CoefficientFunction, c: CoefficientFunction
) -> CoefficientFunction:
    """The energy of Flory and Rehner over J, with the solvent n = c J per dry volume: G/2 (|F|^2 - 2 ln J) +
    n ln(n/(1 + n)) + chi n/(1 + n), and 1/2 TIGHT (J - 1 - n)^2."""
    room = 1 - A - c
    network = NETWORK / 2 * square(F) / J + NETWORK * A * log(A)
    return network + c * log(c / (A + c)) + CHI * c * A / (A + c) + TIGHT / 2 * room * room / A


def _swollen() -> tuple[float, float]:
    """Height over the dry height, and solvent per volume, where no stress and no potential are left."""

    def left(state: np.ndarray) -> list[float]:
        height, n = state
        pull = TIGHT * (height - 1 - n)
        potential = np.log(n / (1 + n)) + 1 / (1 + n) + CHI / (1 + n) ** 2 - pull
        return [potential, NETWORK * (height - 1 / height) + pull]

    height, n = fsolve(left, [2.2, 1.2])
    return height, n / height


@CASES(f"""swelling
    A gel between slip walls swells through its open top to the height of Flory and Rehner, without stress.
    label: none, Flory and Rehner 1943
    setting: A window of 1 m in a layer whose width is held, G = {NETWORK:g}, chi = {CHI:g}, K =
      {TIGHT:g} kT per molecule's volume, here 1 Pa; a user's energy of F, J, A and c. The gel starts with
      {SWOLLEN:g} times its dry height; its top is Open, and held at the potential 0. 4 x 1 rectangles,
      mobility 1 m2/(Pa s), SDIRK2, 200 steps of 0.1 s. The bounds were stated before trials.
    - J over the exact height at [the bottom; the top] in [0.99, 1.01]: at rest no error of the mesh is left
    - solvent over the exact one at [the bottom; the top] in [0.99, 1.01]: as above
    - stress along the layer over G at [the bottom; the top] in [-0.01, 0.01]: nothing bears a load
    - largest |closure| <= 1e-9: energies of the size of K almost cancel, so that their rounding counts
    """)
def _swelling() -> Measured:
    gel = nv.CustomMaterial(
        transported=(Distortion(), Jacobian(), ReciprocalJacobian(), Concentration("c")),
        stored_energy=_swelling_energy,
    )
    wet = {"top": nv.WallExchange(potential=0.0, coefficient=100.0)}
    run = nv.Simulation(
        structured_box((0.2, 1), (1, 4)),
        nv.Model(
            material=gel,
            viscosity=nv.StokesViscosity(K_v=0.1, G_v=0.1),
            diffusion=nv.Diffusion(variable="c", mobility=1.0, walls=wet),
        ),
        time=nv.TimeSteps(dt=0.1, scheme="sdirk2"),
        initial=nv.Initial(
            density=0.01, F=np.diag([1.0, SWOLLEN, 1.0]), values={"c": (SWOLLEN - 1) / SWOLLEN}
        ),
        walls={"top": nv.Open()},
    )
    height, solvent = _swollen()
    places, rows = {"the bottom": 0.1, "the top": 0.9}, []
    for t in (2.0, 5.0, 10.0, 20.0):
        run.run(t)
        for y in places.values():
            point = run.mesh(0.1, y)
            J, c, T = (run.fields[name](point) for name in ("J", "c", "cauchy_stress"))
            rows.append([t, y, J / height, c / solvent, T[4] / NETWORK])
    for name, (*_, J, c, stress) in zip(places, rows[-2:], strict=True):
        yield f"J over the exact height at {name}", J
        yield f"solvent over the exact one at {name}", c
        yield f"stress along the layer over G at {name}", stress
    yield Table("swelling", "t, s | y, m | J over exact | c over exact | stress over G", rows)
