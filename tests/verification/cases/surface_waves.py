"""Waves along a surface: Rayleigh's, Love's in a soft layer, Scholte's between a solid and a fluid, and
Stoneley's between two solids.

A standing wave u = U(depth) cos(k x) sin(omega t) starts with the velocities of its mode and without strain.
The frequencies omega = k c are roots of the secular equations of a half-space.  A wave length is 1 m, and the
density of the solids is 1 kg/m^3.
"""

from __future__ import annotations

import math

import numpy as np
from ngsolve import CF, CoefficientFunction, IfPos, InnerProduct, Integrate, Mesh, cos, exp, sin, x, y, z
from scipy.optimize import brentq

import ngvisco as nv
from ngvisco.geometries import structured_box
from ngvisco.physics.variables import Jacobian
from tests.verification.case import Cases, Curve, Measured, Plot, Table
from tests.verification.setups import followed, swing_by_midpoint

CASES = Cases("Exact solutions: waves")

K = 2 * math.pi
SMALL, STEPS = 1e-5, 32
"""Amplitude of the velocity, m/s, and number of steps in a period."""
LAME, SHEAR, BULK = 1.0, 1.0, 5 / 3
"""Moduli of the solid, Pa, with lambda = mu, so that c_S = 1 and c_P = sqrt(3) m/s."""


def _swing(run: nv.Simulation, mode: CoefficientFunction) -> tuple[complex, np.ndarray, np.ndarray]:
    """The exponent of a mode's amplitude over a period of the run, with times, s, and amplitudes."""
    rho = run.fields["density"]
    size = Integrate(rho * InnerProduct(mode, mode), run.mesh, order=8)

    def amplitude(run: nv.Simulation) -> float:
        return float(Integrate(rho * InnerProduct(run.fields["velocity"], mode), run.mesh, order=8) / size)

    times, values = followed(run, STEPS, amplitude)
    return swing_by_midpoint(values, run.dt), times, values


def _of_solid(c: float, depth: CoefficientFunction) -> tuple[CoefficientFunction, CoefficientFunction, float]:
    """The mode of a half-space whose surface bears no shear: the velocities along x and downward, and the
    downward velocity at the surface."""
    q, s = K * math.sqrt(1 - c * c * SHEAR / (LAME + 2 * SHEAR)), K * math.sqrt(1 - c * c)
    share = 2 * K * K / (s * s + K * K)
    along = K * (exp(-q * depth) - share * q * s / (K * K) * exp(-s * depth)) * sin(K * x)
    down = q * (exp(-q * depth) - share * exp(-s * depth)) * cos(K * x)
    return along, down, q * (1 - share)


def rayleigh(c: float, fluid: float = 0.0, sound: float = math.inf) -> float:
    """The secular function of a half-space under a fluid with the given density and speed of sound."""
    slow, fast = math.sqrt(1 - c * c), math.sqrt(1 - c * c * SHEAR / (LAME + 2 * SHEAR))
    return (2 - c * c) ** 2 - 4 * slow * fast + fluid * c**4 * fast / math.sqrt(1 - (c / sound) ** 2)


def _curves(times: np.ndarray, values: np.ndarray, omega: float) -> list[Curve]:
    return [Curve("amplitude", times, values, "."), Curve("exact", times, np.cos(omega * times), "k-")]


HEAD = "cells in a wave | k | omega, 1/s | exact | over exact | decay, 1/s"


@CASES("""rayleigh-wave
    A wave along a free surface, an Open wall without stress, has Rayleigh's speed.
    label: Euler-small-viscoelastodyn+; Rayleigh 1885
    setting: A strip of one wave length and two wave lengths deep, periodic along x, clamped at the
      bottom; lambda = mu = rho = 1, no viscosity; 6 x 12 squares with a diagonal, midpoint, 32 steps a
      period; the step's own factor is undone.
    - frequency over Rayleigh's with k = 3 in [0.997, 1.003]: six cubic cells in a wave
    - frequency over Rayleigh's with k = 2 in [0.98, 1.02]: six quadratic cells in a wave
    - closure
    """)
def _rayleigh() -> Measured:
    c, deep, rows = brentq(rayleigh, 0.5, 0.9999), 2.0, []
    along, down, _ = _of_solid(c, deep - y)
    mode = CF((along, -down))
    for k, m in ((2, 1), (3, 2)):
        run = nv.Simulation(
            structured_box((1.0, deep), (6, 12), periodic="x"),
            nv.Model(material=nv.LinearElastic(K_e=BULK, G_e=SHEAR)),
            dt=1 / (c * STEPS),
            scheme="midpoint",
            walls={"top": nv.Open(), "bottom": nv.NoSlip()},
            initial=nv.Initial(density=1.0, velocity=SMALL * mode),
            discretisation=nv.Discretisation(k=k, m=m),
        )
        s, times, values = _swing(run, mode)
        rows.append([6, k, s.imag, K * c, s.imag / (K * c), -s.real])
        yield f"frequency over Rayleigh's with k = {k}", s.imag / (K * c)
    yield Table("Rayleigh's wave", HEAD, rows)
    yield Plot("Rayleigh's wave, k = 3", "t, s", "amplitude", _curves(times, values / values[0], K * c))


THICK, HARD = 0.25, 4.0
"""Thickness of the soft layer, m, and shear modulus, Pa, of the half-space below it."""


@CASES("""love-wave
    A shear wave across its path in a soft layer on a half-space, in three dimensions, has Love's speed.
    label: Euler-small-viscoelastodyn+; Love 1911
    setting: A layer of 0.25 m and mu = 1 Pa on 1 m with mu = 4 Pa, lambda = mu, rho = 1, one wave length
      along x, periodic along x and y, free at the top and clamped at the bottom; moduli are carried with
      the matter; 504 tetrahedra, k = 2, m = 1, midpoint, 32 steps a period; the step's own factor is
      undone.
    - frequency over Love's in [0.995, 1.005]: six quadratic cells in a wave
    - closure
    """)
def _love() -> Measured:
    def secular(c: float) -> float:
        soft = math.sqrt(c * c - 1)
        return math.tan(K * THICK * soft) - HARD * math.sqrt(1 - c * c / HARD) / soft

    top = 1 + THICK
    c = brentq(secular, 1.0001, math.sqrt(1 + (math.pi / (2 * K * THICK)) ** 2) * 0.9999)
    across, decay, depth = K * math.sqrt(c * c - 1), K * math.sqrt(1 - c * c / HARD), top - z
    bottom = math.cos(across * THICK)
    shape = IfPos(THICK - depth, cos(across * depth), bottom * exp(-decay * (depth - THICK)))
    mode, mu = CF((0.0, shape * cos(K * x), 0.0)), IfPos(THICK - depth, 1.0, HARD)
    run = nv.Simulation(
        structured_box((1.0, THICK, top), (6, 2, 7), periodic="xy"),
        nv.Model(material=nv.LinearElastic(K_e=BULK * mu, G_e=mu)),
        dt=1 / (c * STEPS),
        scheme="midpoint",
        walls={"top": nv.Open(), "bottom": nv.NoSlip()},
        initial=nv.Initial(density=1.0, velocity=SMALL * mode),
        solver="split",
    )
    s, times, values = _swing(run, mode)
    yield "frequency over Love's", s.imag / (K * c)
    yield Table("Love's wave", HEAD, [[6, 2, s.imag, K * c, s.imag / (K * c), -s.real]])
    yield Plot("Love's wave", "t, s", "amplitude", _curves(times, values / values[0], K * c))


STIFF = 3.0
"""Bulk modulus of the fluid, Pa."""


@CASES("""scholte-wave
    A wave along the interface of a solid body and a heavy fluid has Scholte's speed, up to a layer of a
    cell in which the fluid moves with the solid.
    label: Scholte 1947
    setting: A solid body with lambda = mu = rho = 1 under a fluid without viscosity, K = 3 Pa, of the
      densities 1 and 0.5, each 1.5 wave lengths deep; 6 x 18 and 12 x 36 squares with a diagonal, k = 2,
      m = 1, midpoint, 32 steps a period; the step's own factor is undone.
    - frequency over Scholte's for density [1; 0.5] in [0.98, 1.02]: the velocity along the interface has
      no jump
    - least ratio of the errors of both meshes >= 1.5: order h, by the fluid that moves with the solid
    - closure
    """)
def _scholte() -> Measured:
    deep, rows, ratios = 1.5, [], []
    for fluid in (1.0, 0.5):
        sound, errors = math.sqrt(STIFF / fluid), []
        c = brentq(rayleigh, 1e-3, 0.99999, (fluid, sound))
        for n in (6, 12):
            run, mode = _solid_under_fluid(
                c, deep, fluid, structured_box((1.0, 2 * deep), (n, 3 * n), periodic="x")
            )
            s, times, values = _swing(run, mode)
            rows.append([n, 2, s.imag, K * c, s.imag / (K * c), -s.real])
            errors.append(abs(s.imag / (K * c) - 1))
        ratios.append(errors[0] / errors[1])
        yield f"frequency over Scholte's for density {fluid:g}", s.imag / (K * c)
    yield "least ratio of the errors of both meshes", min(ratios)
    yield Table("Scholte's wave, densities 1 and 0.5", HEAD, rows)
    yield "Before the bounds were written, frequencies of 0.991 and 0.998 of Scholte's had been seen."
    yield Plot("Scholte's wave, density 0.5", "t, s", "amplitude", _curves(times, values / values[0], K * c))


def _solid_under_fluid(
    c: float, deep: float, fluid: float, mesh: Mesh
) -> tuple[nv.Simulation, CoefficientFunction]:
    along, down, sinking = _of_solid(c, deep - y)
    decay = K * math.sqrt(1 - c * c * fluid / STIFF)
    above = exp(-decay * (y - deep)) * (-sinking)
    of_fluid = CF((above * K / decay * sin(K * x), above * cos(K * x)))
    mode = IfPos(deep - y, CF((along, -down)), of_fluid)
    liquid = nv.CustomMaterial(
        transported=(Jacobian(),), stored_energy=lambda J: STIFF / 2 * (J - 1) * (J - 1) / J
    )
    solid = nv.IsochoricNeoHookean(K_e=BULK, G_e=SHEAR / 2)
    bodies = (
        nv.Body(name="solid", where=deep - y, material=solid, density=1.0),
        nv.Body(name="fluid", material=liquid, density=fluid),
    )
    run = nv.Simulation(
        mesh,
        nv.Model(bodies=bodies),
        dt=1 / (c * STEPS),
        scheme="midpoint",
        walls={"bottom": nv.NoSlip()},
        initial=nv.Initial(velocity=SMALL * mode),
    )
    return run, mode


HEAVY = 6.0
"""Shear modulus, Pa, and density, kg/m^3, of the upper of two solids, whose shear waves are equally fast."""


def _interface(c: float) -> np.ndarray:
    """Matrix with a column for each potential: pressure and shear below the interface, then pressure and
    shear above it with the opposite sign. The rows are the velocities along and across the interface and the
    stresses xy and yy. Common factors of a row are left out."""
    columns = []
    for above, mu in ((1, 1.0), (-1, HEAVY)):
        p, s = above * math.sqrt(1 - c * c / 3), above * math.sqrt(1 - c * c)
        stresses = (-2 * mu * p, mu * (p * p - 1) + 2 * mu * p * p), (mu * (s * s + 1), -2 * mu * s)
        columns += [np.array((-1.0, p, *stresses[0])) * above, np.array((s, -1.0, *stresses[1])) * above]
    return np.array(columns).T


@CASES(f"""stoneley-wave
    A wave along the interface of two solids that stick together has Stoneley's speed.
    label: Stoneley 1924
    setting: Solids with lambda = mu, of mu = rho = 1 below and mu = rho = {HEAVY:g} above, two wave lengths
      each, periodic along x and clamped at both ends; moduli are carried with the matter; 6 x 24 squares with
      a diagonal, k = 2, m = 1, midpoint, 32 steps a period; the step's own factor is undone.
    - Stoneley's speed over that of shear waves in [0.9615, 0.9617]: the root of the secular determinant
    - frequency over Stoneley's in [0.99, 1.01]: six quadratic cells in a wave; shear waves have 1.04
    - closure
    """)
def _stoneley() -> Measured:
    c, deep = brentq(lambda c: float(np.linalg.det(_interface(c))), 0.9, 0.9999), 2.0
    shares = np.linalg.svd(_interface(c))[2][-1]
    parts = []
    for above, (of_p, of_s) in ((1, shares[:2]), (-1, shares[2:])):
        fast, slow = above * math.sqrt(1 - c * c / 3), above * math.sqrt(1 - c * c)
        waves = of_p * exp(fast * K * (y - deep)), of_s * exp(slow * K * (y - deep))
        along, across = -waves[0] + slow * waves[1], fast * waves[0] - waves[1]
        parts.append(CF((along * sin(K * x), across * cos(K * x))))
    mode, mu = IfPos(deep - y, *parts), IfPos(deep - y, 1.0, HEAVY)
    run = nv.Simulation(
        structured_box((1.0, 2 * deep), (6, 24), periodic="x"),
        nv.Model(material=nv.LinearElastic(K_e=BULK * mu, G_e=mu)),
        dt=1 / (c * STEPS),
        scheme="midpoint",
        walls={("top", "bottom"): nv.NoSlip()},
        initial=nv.Initial(density=mu, velocity=SMALL * mode),
        solver="split",
    )
    exponent, times, values = _swing(run, mode)
    yield "Stoneley's speed over that of shear waves", c
    yield "frequency over Stoneley's", exponent.imag / (K * c)
    yield Table(
        "Stoneley's wave", HEAD, [[6, 2, exponent.imag, K * c, exponent.imag / (K * c), -exponent.real]]
    )
    yield Plot("Stoneley's wave", "t, s", "amplitude", _curves(times, values / values[0], K * c))
