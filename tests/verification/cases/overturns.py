"""Rayleigh–Taylor: a heavy elastic layer over a fluid, and two viscous layers."""

import math

import numpy as np
from ngsolve import CF, IfPos, Integrate, cos, pi, sin, x, y

import ngvisco as nv
from ngvisco.geometries import structured_box
from tests.verification.case import Cases, Curve, Measured, Plot, Table
from tests.verification.setups import at_rest, fluid, followed, layers, stokes

CASES = Cases("Bodies and their interfaces")

# --- Rayleigh–Taylor of an elastic layer over a fluid --------------------------------------------------
"""A layer of thickness h and shear modulus G hangs on a rigid ceiling over a fluid that is lighter by drho.
A pressure p cos(k x) on the free face of an incompressible layer lifts this face by

    w = p/(2 G k) (sinh a cosh a - a)/(cosh^2 a + a^2),    a = k h,

so that the face is in neutral equilibrium with the weight drho g w of the displaced matter if

    drho g h/G = 2 a (cosh^2 a + a^2)/(sinh a cosh a - a).

The minimum is 6.22 at a = 2.12 (Mora, Phou, Fromental and Pomeau, Phys. Rev. Lett. 113, 178301, 2014).  A
softer layer falls, a stiffer one oscillates.  The fluid's depth and inertia do not matter for the threshold.
"""

DEEP, WIDTH = 1.0, 2.96
"""Depth of the layer and of the fluid, m; wavelength with the least threshold, m."""
G, LIGHT_FLUID, STIFF = 1.0, 0.25, 20.0
"""Gravity, m/s^2; density of the fluid, kg/m^3, with 1 for the layer; both K_e, Pa, 110 to 330 times G."""
SPEED, THIN_FLUID = 1e-3, 1e-4
"""Initial velocity, m/s; viscosity of the fluid, Pa s."""
MODULI = (0.5, 0.8, 1.2, 1.5)
"""Shear moduli over the modulus at the threshold."""
TAU, STEPS, CELLS = 0.1, 20, (12, 16)


def threshold(a: float) -> float:
    """The number drho g h/G of neutral equilibrium at k h = a."""
    return 2 * a * (math.cosh(a) ** 2 + a * a) / (math.sinh(a) * math.cosh(a) - a)


CRITICAL = (1 - LIGHT_FLUID) * G * DEEP / threshold(2 * math.pi / WIDTH * DEEP)
"""Shear modulus at the threshold, Pa."""


def _grown(ratio: float) -> tuple[np.ndarray, float]:
    """The projection of v_y on cos(k x) over its initial value, and s^2, 1/s^2, of the motion exp(s t).

    The run starts from hydrostatic rest, J = 1 at the face, with a solenoidal velocity. The midpoint rule
    multiplies by q = (1 + s tau/2)/(1 - s tau/2), so that the projections obey a_n+1 + a_n-1 = c a_n with c =
    q + 1/q. Then (s tau/2)^2 = (c - 2)/(c + 2), which has either sign.
    """
    k, height = 2 * pi / WIDTH, y - DEEP
    solid = nv.ReferentialNeoHookean(K_e=STIFF, G_e=ratio * CRITICAL / 2)
    bodies = (
        nv.Body(name="layer", where=height, material=solid, density=1.0),
        nv.Body(name="fluid", material=fluid(STIFF), density=LIGHT_FLUID, viscosity=stokes(THIN_FLUID)),
    )
    s = 1 - IfPos(height, height, -height) / DEEP  # s is 0 at the walls and 1 at the face
    slope = 6 * s * (1 - s) * IfPos(height, -1.0, 1.0) / DEEP
    velocity = SPEED * CF((-slope / k * sin(k * x), s * s * (3 - 2 * s) * cos(k * x)))
    run = nv.Simulation(
        structured_box((WIDTH, 2 * DEEP), CELLS, periodic="x"),
        nv.Model(bodies=bodies, loads=(nv.Gravity((0.0, -G)),)),
        dt=TAU,
        scheme="midpoint",
        initial=nv.Initial(F=at_rest(STIFF, G * IfPos(height, 1.0, LIGHT_FLUID) * height), velocity=velocity),
        walls={"top": nv.NoSlip()},
    )
    rising = run.fields["velocity"][1] * cos(k * x)
    _, values = followed(run, STEPS, lambda run: Integrate(rising, run.mesh, order=5))
    a = values / values[0]
    c = float((a[2:] + a[:-2]) @ a[1:-1] / (a[1:-1] @ a[1:-1]))
    return a, (2 / TAU) ** 2 * (c - 2) / (c + 2)


@CASES(f"""rayleigh-taylor-elastic
    A heavy elastic layer that hangs over a light fluid falls if it is softer than the threshold of linear
      theory, and oscillates if it is stiffer.
    label: benchmark: Mora et al. (2014)
    setting: Layer and fluid {DEEP:g} m deep, one wavelength of {WIDTH:g} m, densities 1 and {LIGHT_FLUID:g}
      kg/m3, g = {G:g} m/s2, G_c = {CRITICAL:.4f} Pa; both bodies K_e = {STIFF:g} Pa, the fluid {THIN_FLUID:g}
      Pa s; {2 * CELLS[0] * CELLS[1]} triangles, midpoint, tau = {TAU:g} s, {STEPS} steps from hydrostatic
      rest.
    - s^2 at 0.8 of the threshold, 1/s^2 in [0.1, 0.3]: the layer falls, with a fifth of s^2 without
      elasticity
    - s^2 at 1.2 of the threshold, 1/s^2 in [-0.3, -0.1]: the layer oscillates, with the opposite s^2
    - relative error of the threshold <= 0.06: eight cells through the layer, K_e/G of more than a hundred,
      s^2 nearly linear in G
    - drift
    - closure
    """)
def _rayleigh_taylor() -> Measured:
    found = {ratio: _grown(ratio) for ratio in MODULI}
    squares = [found[ratio][1] for ratio in MODULI]
    slope, level = np.polyfit(MODULI, squares, 1)
    times = TAU * np.arange(STEPS + 1)
    yield "s^2 at 0.8 of the threshold, 1/s^2", squares[1]
    yield "s^2 at 1.2 of the threshold, 1/s^2", squares[2]
    yield "relative error of the threshold", abs(float(-level / slope) - 1)
    rows = [[ratio, square, a[-1]] for ratio, (a, square) in found.items()]
    yield Table("growth", "G over the threshold | s^2, 1/s^2 | amplitude at the end", rows)
    curves = [Curve(f"G = {ratio:g} G_c", times, a) for ratio, (a, _) in found.items()]
    yield Plot("A heavy layer over a fluid", "t, s", "amplitude of v", curves)
    yield "The bounds were written after trial runs at 0.5 and 1.5 of it."


# --- Rayleigh–Taylor of viscous layers -----------------------------------------------------------------
"""Growth of two viscous layers without inertia. A layer of thickness h_1, viscosity eta_1 and density rho_1
lies above a layer of h_2, eta_2 and rho_2, between walls without slip. The face at A cos(k x) between the
layers moves with the velocity K (rho_1 - rho_2) g h_2 A/(2 eta_2), where K is ``factor`` (H. Ramberg, Phys.
Earth Planet. Inter. 1, 427, 1968; T. Gerya, Introduction to Numerical Geodynamic Modelling, 2010, Chapter
16). Backward Euler then multiplies A by 1/(1 - s tau).

With K_e = 1e10 Pa pressures of 9e7 Pa are rounded to 1e-6 Pa.  This changes the velocity of the weak layer,
1e13 Pa s, by 1e-6, where the iteration ends.
"""

THICK, WAVE_LENGTH, FIRST = 1500.0, 4000.0, 30.0
"""Thickness of each layer, length of a wave, and initial amplitude of the face, m."""
HEAVY, LIGHT, PULL, K_LAYERS = 3000.0, 2900.0, 10.0, 1e10
STRONG = 1e19
"""Viscosity of the lower layer, Pa s."""
RATIOS = (1.0, 1e-3, 1e-6)
"""Viscosities of the upper layer over the lower layer's."""
SIZES, TAU_OVERTURN, OVERTURNING = (250.0, 125.0), 5e10, 4
"""Sizes of cells, m; step, s."""
WAVE = 2 * math.pi / WAVE_LENGTH


def factor(ratio: float) -> float:
    """The factor K of the text above for h_1 = h_2 and eta_1/eta_2 = ``ratio``."""
    f = WAVE * THICK
    of = math.cosh(2 * f) - 1 - 2 * f * f
    straight, sheared = math.sinh(2 * f) - 2 * f, math.sinh(2 * f) + 2 * f
    c, d = 2 * f * f * (ratio - 1) / of, straight * (ratio + 1) / of
    i, j = f * sheared * (ratio + 1) / of, 2 * f**3 * (ratio - 1) / of
    return -d / (c * j - d * i)


def overturn(ratio: float, maxh: float) -> nv.Simulation:
    """Half a wave that starts from hydrostatic rest, J = 1 at the top."""

    def face(s: float) -> float:
        return THICK + FIRST * math.cos(WAVE * s)

    body = fluid(K_LAYERS)
    upper, lower = (nv.StokesViscosity(K_v=0.0, G_v=eta) for eta in (ratio * STRONG, STRONG))
    bodies = (
        nv.Body(name="upper", where=nv.Subdomain("u"), material=body, viscosity=upper, density=HEAVY),
        nv.Body(name="lower", material=body, viscosity=lower, density=LIGHT),
    )
    weight = IfPos(y - THICK, HEAVY * (y - 2 * THICK), LIGHT * (y - THICK) - HEAVY * THICK)
    return nv.Simulation(
        layers(WAVE_LENGTH / 2, (lambda s: 0.0, face, lambda s: 2 * THICK), "lu", maxh),
        nv.Model(bodies=bodies, loads=(nv.Gravity((0.0, -PULL)),)),
        time=nv.TimeSteps(dt=TAU_OVERTURN, velocity_scale=1e-12),
        initial=nv.Initial(F=at_rest(K_LAYERS, PULL * weight)),
        walls={"top": nv.NoSlip(), "bottom": nv.NoSlip()},
        newton=nv.NewtonOptions(tolerance=1e-6),
    )


def _of_face(run: nv.Simulation) -> float:
    """Amplitude of the face, m, from the lower layer's fraction."""
    return 4 / WAVE_LENGTH * float(Integrate(run.fields["lower_fraction"] * cos(WAVE * x), run.mesh, order=6))


@CASES(f"""rayleigh-taylor-viscous
    A heavy viscous layer over a lighter one overturns at the rate of linear theory, over six decades of their
      viscosities.
    label: benchmark: Ramberg (1968), Gerya (2010)
    setting: Layers of {THICK:g} m, {HEAVY:g} over {LIGHT:g} kg/m3, g = {PULL:g} m/s2, viscosities of the
      lower one {STRONG:g} Pa s and of the upper one that times 1, 1e-3 and 1e-6 (growth factor
      {factor(1e-06):.4f}); K_e = {K_LAYERS:g} Pa; half a wave of {WAVE_LENGTH:g} m, slip at the sides; cells
      of {SIZES[0]:g} m and {SIZES[1]:g} m, backward Euler, {OVERTURNING} steps of {TAU_OVERTURN:g} s.
    - relative error, viscosities 1e13 and 1e19 Pa s <= 0.015: volumes and densities by 0.5 % at the face, (k
      A)^2 = 0.2 %, twelve cells through a layer
    - largest relative error <= 0.03: the coarser mesh, too
    - drift
    - closure
    """)
def _growth() -> Measured:
    rows = []
    for ratio in RATIOS:
        for maxh in SIZES:
            run = overturn(ratio, maxh)
            times, faces = followed(run, OVERTURNING, _of_face)
            rate = (1 - faces[-2] / faces[-1]) / (times[-1] - times[-2])
            found = rate * 2 * STRONG / ((HEAVY - LIGHT) * PULL * THICK)
            rows.append([ratio, maxh, found, factor(ratio), abs(found / factor(ratio) - 1)])
    yield "relative error, viscosities 1e13 and 1e19 Pa s", rows[-1][-1]
    yield "largest relative error", max(row[-1] for row in rows)
    head = "eta_1/eta_2 | cells, m | found | analytic | relative error"
    yield from Table("growth factor", head, rows).drawn(0, 2, 3, by=1, log="xy")
    yield "The bounds were written after trials with A = 10 m and 50 m of three steps."
