"""Impact and parting of an elastic solid with heat: profiles with entropy, and exact star states.

The body of ``riemann`` with a temperature, in uniaxial strain, F = diag(stretch, 1, 1).  Per reference
volume, of mass 1,

    e = W(stretch) + c (theta - theta_R) + Gamma c theta_R (stretch - 1),  P = W' - Gamma c (theta - theta_R).
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from ngsolve import CF, CoefficientFunction, IfPos, Integrate, x
from scipy.integrate import quad
from scipy.optimize import brentq

import ngvisco as nv
from ngvisco.geometries import structured_box
from ngvisco.physics.materials.thermal import rest_stress_and_modulus
from ngvisco.physics.variables import Cofactor, Distortion, Jacobian
from tests.verification.case import Cases, Curve, Outcome, Plot, Table, measured
from tests.verification.cases import riemann
from tests.verification.manufactured import NUMERIC, SYMBOLIC, Functions
from tests.verification.rates import RateTable

CASES = Cases("Heat")

HEAT_CAPACITY, THETA_R, GAMMA = 2.0, 1.0, 1.5
SOUND = math.sqrt(riemann.SOUND**2 + GAMMA**2 * HEAT_CAPACITY * THETA_R)
"""Of longitudinal waves at rest without conduction, m/s."""


def strip(cells: int, start: CoefficientFunction, nu: float, kappa: float, end: float) -> nv.Simulation:
    """A periodic strip of two rows with a start velocity along it, at its end; nu = K_v + 4/3 G_v."""
    h = 1 / cells
    cold = nv.CustomMaterial(transported=(Distortion(), Cofactor(), Jacobian()), stored_energy=riemann.energy)
    expansion = GAMMA * HEAT_CAPACITY / rest_stress_and_modulus(cold)[1]
    model = nv.Model(
        material=nv.Thermal(material=cold, c=HEAT_CAPACITY, theta_R=THETA_R, expansion=expansion),
        viscosity=nv.StokesViscosity(K_v=nu / 3, G_v=nu / 2),
        heat=nv.Heat(conductivity=kappa),
    )
    mesh = structured_box((1, 2 * h), (cells, 2), periodic="xy")
    initial = nv.Initial(density=1.0, velocity=CF((start, 0.0)))
    dt = end / math.ceil(2 * end * SOUND * cells)
    run = nv.Simulation(mesh, model, dt=dt, initial=initial, scheme="midpoint")
    run.run(end)
    return run


# --- profiles, against a Lagrangian method of lines --------------------------------------------------------

SPEED, WIDTH, NU, KAPPA, END = 0.3 * SOUND, 0.03, 0.04, 0.02, 0.05
"""Of the start -SPEED tanh(sin(2 pi (x - 1/2))/(2 pi WIDTH)); it steepens to a shock of about NU/SPEED."""


def _lagrangian(n: int, is_heated: bool = True) -> dict[str, np.ndarray]:
    """Places of n cells and what is in them at the end; rho_0 = 1, velocities on their left sides.

    v' = d/dX (P + sigma), stretch' = dv/dX, c theta' = -Gamma c theta stretch' + sigma stretch' +
    d/dX (kappa theta_X/stretch), sigma = nu (dv/dX)/stretch: second order in X, Heun's steps in time.
    ``is_heated`` False leaves out what sigma heats: for the negative control.
    """
    d = 1 / n
    X = d * np.arange(n)
    u = np.stack([_start(X, NUMERIC), np.ones(n), np.full(n, THETA_R)])

    def rate(u: np.ndarray) -> np.ndarray:
        v, stretch, theta = u
        strain_rate = (np.roll(v, -1) - v) / d
        sigma = NU * strain_rate / stretch
        P = riemann.A * stretch + 2 * riemann.B * stretch + riemann.C * (stretch - 1) - riemann.D / stretch
        P = P - GAMMA * HEAT_CAPACITY * (theta - THETA_R) + sigma
        side = 0.5 * (stretch + np.roll(stretch, 1))
        flux = KAPPA * (theta - np.roll(theta, 1)) / d / side
        heat = (np.roll(flux, -1) - flux) / d + is_heated * sigma * strain_rate
        return np.stack(
            [(P - np.roll(P, 1)) / d, strain_rate, heat / HEAT_CAPACITY - GAMMA * theta * strain_rate]
        )

    steps = math.ceil(END / (0.2 * d * d / NU))
    place, dt = X.copy(), END / steps
    for _ in range(steps):
        first = rate(u)
        second = rate(u + dt * first)
        place += dt * (u[0] + 0.5 * dt * first[0])
        u = u + 0.5 * dt * (first + second)
    right = np.append(place[1:], place[0] + 1)
    v, stretch, theta = u
    return {
        "place": 0.5 * (place + right) % 1,
        "density": 1 / stretch,
        "temperature": theta,
        "velocity": 0.5 * (v + np.roll(v, -1)),
        "entropy": HEAT_CAPACITY * (np.log(theta / THETA_R) + GAMMA * (stretch - 1)) / stretch,
    }


def _start(at: Any, m: Functions) -> Any:
    """The start velocity, m/s, of a coordinate, by functions of its kind."""
    return SPEED * (2 / (1 + m.exp(m.sin(2 * np.pi * (at - 0.5)) / (np.pi * WIDTH))) - 1)


def _samples(reference: dict[str, np.ndarray], places: np.ndarray) -> dict[str, np.ndarray]:
    order = np.argsort(reference["place"])
    at = reference["place"][order]
    return {name: np.interp(places, at, of[order], period=1.0) for name, of in reference.items()}


@CASES("""heat-impact
    Impact and parting of an elastic body that is heated by compression and viscosity and conducts: profiles
      with entropy are those of a Lagrangian method of lines in numpy.
    label: heat-entropy, heat-temperature, ED-Euler-large2
    setting: A periodic strip of 1 m, 25, 50, 100 x 2 rows; W of riemann-elastic, c = 2 J/(m^3 K), Gamma = 1.5
      by expansion, 1 K; -0.3 c_s tanh over 0.03 m, nu = 0.04 Pa s, kappa = 0.02 W/(m K), until 0.05 s,
      midpoint rule; the reference has 400 and 800 cells and is extrapolated.
    - rate of [density; temperature; velocity; entropy] >= 1.8: 2 by P1 and the midpoint rule
    - largest error at 100 cells <= 2e-3: set after the entropy was seen: 6e-4
    - the reference's own step, of the entropy <= 5e-4: a third of it is extrapolated away
    - error of the entropy without its heat in the reference >= 0.1: the negative control
    - closure
    """)
def _profiles() -> Outcome:
    places = (np.arange(400) + 0.5) / 400
    coarse, fine = (_samples(_lagrangian(n), places) for n in (400, 800))
    names = ("density", "temperature", "velocity", "entropy")
    exact = {name: (4 * fine[name] - coarse[name]) / 3 for name in names}
    cold = _samples(_lagrangian(400, is_heated=False), places)
    table, curves = RateTable("largest errors, of the largest difference in space"), []
    for cells in (25, 50, 100):
        run = strip(cells, _start(x, SYMBOLIC), NU, KAPPA, END)
        fields = run.fields
        found = {
            "density": fields["density"],
            "temperature": fields["temperature"],
            "velocity": fields["velocity"][0],
            "entropy": HEAT_CAPACITY * fields["s"],
        }
        values = {n: np.array([f(run.mesh(p, 0.6 / cells)) for p in places]) for n, f in found.items()}
        errors = {n: float(abs(values[n] - exact[n]).mean() / np.ptp(exact[n])) for n in names}
        table.add(1 / cells, **errors)
        curves = [Curve(n, places, values[n], "-") for n in ("temperature", "entropy")]
    curves += [Curve(f"{n}, reference", places, exact[n], "k:") for n in ("temperature", "entropy")]
    return measured(
        {
            **{f"rate of {name}": table.last(name) for name in names},
            "largest error at 100 cells": max(errors.values()),
            "the reference's own step, of the entropy": float(
                abs(fine["entropy"] - coarse["entropy"]).mean() / np.ptp(exact["entropy"])
            ),
            "error of the entropy without its heat in the reference": float(
                abs(values["entropy"] - cold["entropy"]).mean() / np.ptp(exact["entropy"])
            ),
        },
        table.table("h, m"),
        Plot("At the end", "x, m", "K, J/(m3 K)", curves),
    )


# --- star states, against the shock relations and the fan --------------------------------------------------

MACH, PASSAGES = 0.2, 0.15
"""U/c, and the end in passages of a wave through the strip."""
NEAR, FAR = 0.06, 0.08
"""From the plane of impact or parting, m: where a star region's means are taken.  Close to it viscosity has
heated the body while the jumps were formed, and no wave carries that away."""


def elastic(stretch: float) -> float:
    """W, without heat, J."""
    A, B, C, D = riemann.A, riemann.B, riemann.C, riemann.D
    s = stretch * stretch - 1
    return A / 2 * s + B * s + C / 2 * (stretch - 1) ** 2 - D * math.log(stretch)


@dataclass(frozen=True)
class Star:
    """An exact star state: the stretch, and the temperature, K."""

    stretch: float
    theta: float

    @property
    def stress(self) -> float:
        """P, which is Cauchy's in uniaxial strain, Pa."""
        return riemann.stress(self.stretch) - GAMMA * HEAT_CAPACITY * (self.theta - THETA_R)

    @property
    def entropy(self) -> float:
        """Per reference volume, J/K."""
        return HEAT_CAPACITY * (math.log(self.theta / THETA_R) + GAMMA * (self.stretch - 1))


def _behind_a_shock(stretch: float) -> Star:
    """On the Hugoniot curve of the body at rest: e = P (stretch - 1)/2, linear in theta."""
    d = stretch - 1
    heat = riemann.stress(stretch) * d / 2 - elastic(stretch) - GAMMA * HEAT_CAPACITY * THETA_R * d
    return Star(stretch, THETA_R + heat / HEAT_CAPACITY / (1 + GAMMA * d / 2))


def star_of_impact(U: float) -> Star:
    """Between two bodies that meet with U each, by one shock into each: U^2 = P (stretch - 1)."""

    def excess(stretch: float) -> float:
        return U * U - _behind_a_shock(stretch).stress * (stretch - 1)

    return _behind_a_shock(brentq(excess, 0.3, 1 - 1e-9))


def star_of_expansion(U: float) -> Star:
    """Between two pieces that part with U each: an isentropic fan into each, U = int c dstretch."""

    def theta(stretch: float) -> float:
        return THETA_R * math.exp(-GAMMA * (stretch - 1))

    def speed(stretch: float) -> float:
        slope = riemann.A + 2 * riemann.B + riemann.C + riemann.D / stretch**2
        return math.sqrt(slope + GAMMA**2 * HEAT_CAPACITY * theta(stretch))

    stretch = brentq(lambda s: quad(speed, 1, s)[0] - U, 1 + 1e-9, 4.0)
    return Star(stretch, theta(stretch))


def _mean(run: nv.Simulation, value: CoefficientFunction, middle: float) -> float:
    """Over ``NEAR`` to ``FAR`` from a plane, on its right."""
    where = IfPos(x - middle - NEAR, IfPos(middle + FAR - x, 1.0, 0.0), 0.0)
    return float(Integrate(value * where, run.mesh, order=8) / Integrate(where, run.mesh, order=8))


@CASES("""heat-riemann
    Star states of an impact and of a parting at 20 % of the sound speed agree with the shock relations,
      energy's among them, and with the integral over the isentropic fan.
    label: heat-entropy; Rankine and Hugoniot
    setting: The body of heat-impact without conduction, jumps of the velocity, K_v + 4/3 G_v = 2 rho U h,
      midpoint rule; means 0.06 to 0.08 m from the planes.
    - largest error of a star state, 200 cells <= 0.02: h/x = 0.08, of which a part is heat; set after it was
      seen: 0.011
    - that of 100 cells over it >= 1.3: 2 in the limit; seen: 1.47
    - closure
    """)
def _stars() -> Outcome:
    rows: list[list[str | float]] = []
    worst, U = [], MACH * SOUND
    shock = star_of_impact(U).entropy
    for cells in (100, 200):
        run = strip(cells, IfPos(x - 0.5, -U, U), 2 * U / cells, 0.0, PASSAGES / SOUND)
        fields, largest = run.fields, 0.0
        for name, star, middle in (
            ("impact", star_of_impact(U), 0.5),
            ("parting", star_of_expansion(U), 0.0),
        ):
            found = {
                1 / star.stretch: fields["density"],
                star.stretch: fields["F"][0, 0],
                star.theta: fields["temperature"],
                star.stress: fields["cauchy_stress"][0, 0],
            }
            errors = [abs(_mean(run, value, middle) / exact - 1) for exact, value in found.items()]
            entropy = HEAT_CAPACITY * star.stretch * _mean(run, fields["s"], middle)
            rows.append([name, cells, *errors, (entropy - star.entropy) / shock])
            largest = max(largest, *errors)
        worst.append(largest)
    return measured(
        {
            "largest error of a star state, 200 cells": worst[1],
            "that of 100 cells over it": worst[0] / worst[1],
        },
        Table(
            "relative errors; what there is of entropy beside the exact one, of the shock's",
            " | cells | density | F_11 | temperature | stress | entropy",
            rows,
        ),
        "Shocks of this strength make little entropy, fans none: what viscosity makes while the jumps "
        "spread, like h/x at a distance x from the plane, is more on these meshes. That it is what "
        "it should be is measured by heat-impact.",
    )
