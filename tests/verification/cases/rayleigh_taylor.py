"""Rayleigh–Taylor of a heavy elastic layer over a light fluid: elasticity holds it below a threshold.

A layer of thickness h and shear modulus G hangs on a rigid ceiling over a fluid that is lighter by drho.  For
an incompressible layer a pressure p cos(k x) on its free face lifts that by

    w = p/(2 G k) (sinh a cosh a - a)/(cosh^2 a + a^2),    a = k h,

so that the face is in neutral equilibrium with the weight drho g w of what it displaces where

    drho g h/G = 2 a (cosh^2 a + a^2)/(sinh a cosh a - a),

least at a = 2.12, where it is 6.22 (Mora, Phou, Fromental and Pomeau, Phys. Rev. Lett. 113, 178301, 2014).  A
softer layer falls, a stiffer one oscillates.  The fluid's depth and inertia do not matter for the threshold.
"""

import math

import numpy as np
from ngsolve import CF, CoefficientFunction, Id, IfPos, Integrate, cos, pi, sin, x, y

import ngvisco as nv
from ngvisco.geometries import structured_box
from tests.verification.case import Cases, Curve, Outcome, Plot, Table, measured
from tests.verification.setups import fluid, stokes

CASES = Cases("Bodies and their interfaces")

DEPTH, WIDTH = 1.0, 2.96
"""Of the layer, as of the fluid, m; one wavelength, that of the least threshold."""
GRAVITY, LIGHT, STIFF = 1.0, 0.25, 20.0
"""m/s^2; density of the fluid, kg/m^3, where the layer has 1; K_e of both, Pa: 110 to 330 times G."""
SPEED, VISCOSITY = 1e-3, 1e-4
"""Of the first velocity, m/s; of the fluid, Pa s."""
RATIOS = (0.5, 0.8, 1.2, 1.5)
"""Shear moduli over the threshold's."""
TAU, STEPS = 0.1, 20
CELLS = (12, 16)


def threshold(a: float) -> float:
    """drho g h/G of neutral equilibrium at k h = a."""
    return 2 * a * (math.cosh(a) ** 2 + a * a) / (math.sinh(a) * math.cosh(a) - a)


CRITICAL = (1 - LIGHT) * GRAVITY * DEPTH / threshold(2 * math.pi / WIDTH * DEPTH)
"""Shear modulus at the threshold, Pa."""


def layer(ratio: float) -> nv.Simulation:
    """From hydrostatic rest, J J' = rho_R g/K_e with J = 1 at the face, and a solenoidal velocity."""
    k, height = 2 * pi / WIDTH, y - DEPTH
    solid = nv.ReferentialNeoHookean(K_e=STIFF, G_e=ratio * CRITICAL / 2)
    bodies = (
        nv.Body(name="layer", where=height, material=solid, density=1.0),
        nv.Body(name="fluid", material=fluid(STIFF), density=LIGHT, viscosity=stokes(VISCOSITY)),
    )
    J = (1 + 2 * GRAVITY / STIFF * IfPos(height, 1.0, LIGHT) * height) ** 0.5
    s = 1 - IfPos(height, height, -height) / DEPTH  # 0 at the walls, 1 at the face
    slope = 6 * s * (1 - s) * IfPos(height, -1.0, 1.0) / DEPTH
    velocity = SPEED * CF((-slope / k * sin(k * x), s * s * (3 - 2 * s) * cos(k * x)))
    return nv.Simulation(
        structured_box((WIDTH, 2 * DEPTH), CELLS, periodic="x"),
        nv.Model(bodies=bodies, loads=(nv.Gravity((0.0, -GRAVITY)),)),
        dt=TAU,
        scheme="midpoint",
        initial=nv.Initial(F=J ** (1 / 3) * Id(3), velocity=velocity),
        walls={"top": nv.NoSlip()},
    )


def _amplitude(run: nv.Simulation, weight: CoefficientFunction) -> float:
    return float(Integrate(run.fields["velocity"][1] * weight, run.mesh, order=5))


def _swing(ratio: float) -> tuple[np.ndarray, float]:
    """v_y : cos(k x) over its first value, and s^2 in 1/s^2, of which exp(s t) is the motion.

    The values obey a_n+1 + a_n-1 = (q + 1/q) a_n with q = (1 + s tau/2)/(1 - s tau/2), the midpoint rule's
    factor, from which (s tau/2)^2 = (c - 2)/(c + 2) for c = q + 1/q, of either sign.
    """
    run, weight = layer(ratio), cos(2 * pi / WIDTH * x)
    values = [_amplitude(run, weight)]
    for _ in range(STEPS):
        run.advance()
        values.append(_amplitude(run, weight))
    a = np.array(values) / values[0]
    c = float((a[2:] + a[:-2]) @ a[1:-1] / (a[1:-1] @ a[1:-1]))
    return a, (2 / TAU) ** 2 * (c - 2) / (c + 2)


@CASES(f"""rayleigh-taylor-elastic
    A heavy elastic layer that hangs over a light fluid falls where it is softer than the threshold of linear
      theory, and oscillates where it is stiffer.
    label: benchmark: Mora et al. (2014)
    setting: Layer and fluid {DEPTH:g} m deep, one wavelength of {WIDTH:g} m, densities 1 and {LIGHT:g} kg/m3,
      g = {GRAVITY:g} m/s2, G_c = {CRITICAL:.4f} Pa; both bodies K_e = {STIFF:g} Pa, the fluid {VISCOSITY:g}
      Pa s; {2 * CELLS[0] * CELLS[1]} triangles, midpoint, tau = {TAU:g} s, {STEPS} steps from hydrostatic
      rest.
    - s^2 at 0.8 of the threshold, 1/s^2 >= 0.05: it falls
    - s^2 at 1.2 of the threshold, 1/s^2 <= -0.05: it is held
    - relative error of the threshold <= 0.06: eight cells through the layer, K_e/G of more than a hundred,
      s^2 nearly linear in G
    - drift
    - closure
    """)
def _rayleigh_taylor() -> Outcome:
    found = {ratio: _swing(ratio) for ratio in RATIOS}
    squares = [found[ratio][1] for ratio in RATIOS]
    slope, level = np.polyfit(RATIOS, squares, 1)
    times = [n * TAU for n in range(STEPS + 1)]
    return measured(
        {
            "s^2 at 0.8 of the threshold, 1/s^2": squares[1],
            "s^2 at 1.2 of the threshold, 1/s^2": squares[2],
            "relative error of the threshold": abs(float(-level / slope) - 1),
        },
        Table(
            "growth",
            "G over the threshold | drho g h/G | s^2, 1/s^2 | amplitude at the end",
            [
                [ratio, (1 - LIGHT) * GRAVITY * DEPTH / (ratio * CRITICAL), square, a[-1]]
                for ratio, (a, square) in found.items()
            ],
        ),
        Plot(
            "A heavy layer over a fluid",
            "t, s",
            "amplitude of v",
            [Curve(f"G = {ratio:g} G_c", times, a) for ratio, (a, _) in found.items()],
        ),
        f"s^2 fitted by a line in G vanishes at {float(-level / slope):.4f} of the threshold.",
        "The bounds were written after trial runs at 0.5 and 1.5 of it.",
    )
