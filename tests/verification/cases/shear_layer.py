"""A shear layer of a viscous fluid: the growth of its waves against the equation of Orr and Sommerfeld."""

from __future__ import annotations

import math

import numpy as np
from ngsolve import CF, CoefficientFunction, Integrate, cos, exp, pi, sin, x, y
from scipy.linalg import eig

import ngvisco as nv
from ngvisco.geometries import structured_box
from tests.verification.case import Cases, Curve, Measured, Plot, Table
from tests.verification.setups import followed, stokes

CASES = Cases("Exact solutions: rotation, Couette flow")

THICKNESS, HALF = 0.0708, 0.5
"""Thickness d of the layer U = tanh(y/d), for which a wave of 1 m grows fastest, and half the height, m."""
MICHALKE = 0.1897
"""The largest growth rate times d over the velocity, in an ideal fluid without walls (Michalke 1964)."""
SINES, KEPT = 120, 40
"""Number of sines in the stream function, and of those in the start of a run."""


def orr_sommerfeld(
    thickness: float, k: float, viscosity: float, half: float
) -> tuple[complex, np.ndarray, np.ndarray]:
    """The exponent of the fastest wave psi(y) e^(i k x + s t) in a layer between slip walls at y = +-half.

    Galerkin's method uses the sines sin(q (y + half)), which vanish at the walls with their second
    derivatives. The coefficients of the sines, (sines,), and their wave numbers q, 1/m, are returned too.
    """
    places, weights = np.polynomial.legendre.leggauss(600)
    places, weights = places * half, weights * half
    q = np.arange(1, SINES + 1) * math.pi / (2 * half)
    sines, laplace = np.sin(np.outer(places + half, q)), -(q**2 + k**2)
    U = np.tanh(places / thickness)
    curvature = -2 / thickness**2 * U * (1 - U**2)
    inertia = (sines * (weights * U)[:, None]).T @ (sines * laplace)
    inertia -= (sines * (weights * curvature)[:, None]).T @ sines
    speeds, vectors = eig(
        inertia - viscosity / (1j * k) * half * np.diag(laplace**2), half * np.diag(laplace)
    )
    fastest = int(np.argmax(speeds.imag))
    mode = vectors[:, fastest]
    return complex(-1j * k * speeds[fastest]), mode / abs(mode).max(), q


def _sum(coefficients: np.ndarray, functions: list[CoefficientFunction]) -> CoefficientFunction:
    pairs = zip(coefficients, functions, strict=False)
    return sum((float(c) * f for c, f in pairs), CF(0.0))


def _size(run: nv.Simulation) -> float:
    """The size of the wave's velocity across the layer, m/s, as a Fourier coefficient over the domain."""
    across = run.fields["velocity"][1] * CF((cos(2 * pi * x), sin(2 * pi * x)))
    return float(np.linalg.norm(Integrate(across, run.mesh, order=10)))


@CASES("""shear-layer
    A wave in a shear layer, of Kelvin and Helmholtz, grows as the equation of Orr and Sommerfeld says.
    label: Michalke 1964; rem-barotropic-fluids
    setting: U = tanh(y/d) m/s with d = 0.0708 m, wave length and height 1 m, slip walls, nu = 2e-4 and
      1e-3 m2/s, a body force that holds U, Mach number 0.05; starts with the fastest wave of 1e-3 m/s; 8
      x 16 rectangles with a diagonal, k = 3, m = 2, 60 steps of the midpoint rule until 1.2 s; the growth
      between 0.3 and 0.9 s.
    - growth over the exact growth for nu of [2e-4; 1e-3] in [0.97, 1.03]: five cells across the layer
    - growth in an ideal fluid without walls over Michalke's in [0.9995, 1.0005]: the reference is right
    - control: difference of the exact growths for both nu over the larger growth >= 0.05: viscosity matters
    - closure
    """)
def _shear_layer() -> Measured:
    k, rows, curves, wanted = 2 * math.pi, [], [], []
    for nu in (2e-4, 1e-3):
        s, mode, q = orr_sommerfeld(THICKNESS, k, nu, HALF)
        wanted.append(s.real)
        sines, cosines = ([f(float(p) * y) for p in q[:KEPT]] for f in (sin, cos))
        up = [_sum(part, sines) for part in (mode.real, mode.imag)]
        along = [_sum(part * q, cosines) for part in (mode.real, mode.imag)]
        across = up[0] * sin(k * x) + up[1] * cos(k * x)
        wave = CF(((along[0] * cos(k * x) - along[1] * sin(k * x)) / k, across))
        rise = exp(-2 * (y - HALF) / THICKNESS)
        U = (1 - rise) / (1 + rise)
        model = nv.Model(
            material=nv.BarotropicFluid(B=200.0, gamma=2.0),
            viscosity=stokes(nu),
            loads=(nv.BodyForce((2 * nu / THICKNESS**2 * U * (1 - U * U), 0.0)),),
        )
        run = nv.Simulation(
            structured_box((1.0, 2 * HALF), (8, 16), periodic="x"),
            model,
            dt=0.02,
            scheme="midpoint",
            initial=nv.Initial(density=1.0, velocity=CF((U, 0.0)) + 1e-3 * wave),
            discretisation=nv.Discretisation(k=3, m=2),
        )
        times, sizes = followed(run, 60, _size)
        during = (times > 0.29) & (times < 0.91)
        growth = float(np.polyfit(times[during], np.log(sizes[during]), 1)[0])
        rows.append([nu, growth, s.real, growth / s.real - 1])
        curves.append(Curve(f"nu = {nu:g}", times, sizes / sizes[0], "."))
        curves.append(Curve(f"exact, nu = {nu:g}", times, np.exp(s.real * times), "-"))
        yield f"growth over the exact growth for nu of {nu:.0e}".replace("e-0", "e-"), growth / s.real
    ideal = orr_sommerfeld(1.0, 0.4446, 1e-9, 20.0)[0].real
    yield "growth in an ideal fluid without walls over Michalke's", ideal / MICHALKE
    yield (
        "control: difference of the exact growths for both nu over the larger growth",
        1 - wanted[1] / wanted[0],
    )
    yield Table("growth, 1/s", "nu, m2/s | growth | exact | relative error", rows)
    yield "Before the bounds were written, a growth of 0.997 of the exact one had been seen for nu = 2e-4."
    yield Plot("Waves of a shear layer", "t, s", "size over the size at the start", curves, log="y")
