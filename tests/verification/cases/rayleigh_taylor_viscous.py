"""Rayleigh–Taylor of two viscous layers, the upper one heavier, without inertia: the rate at which it grows.

A face at A cos(k x) between a layer of thickness h_1, viscosity eta_1 and density rho_1 above another one of
h_2, eta_2 and rho_2, between walls that hold, moves with K (rho_1 - rho_2) g h_2 A/(2 eta_2), where K is
``factor`` (H. Ramberg, Phys. Earth Planet. Inter. 1, 427, 1968; T. Gerya, Introduction to Numerical
Geodynamic Modelling, 2010, Chapter 16).  Backward Euler multiplies A by 1/(1 - s tau) then.

Pressures of 9e7 Pa are rounded to 1e-6 Pa where K_e = 1e10 Pa, which moves the weak layer of 1e13 Pa s by
1e-6 of its velocity: the iteration ends there.
"""

import math

from ngsolve import Id, IfPos, Integrate, cos, x, y

import ngvisco as nv
from tests.verification.case import Cases, Outcome, Table, measured
from tests.verification.setups import fluid, layers

CASES = Cases("Bodies and their interfaces")

DEPTH, LENGTH, FIRST = 1500.0, 4000.0, 30.0
"""Of each layer, of a wave, and of the face at first, m."""
HEAVY, LIGHT, GRAVITY, BULK = 3000.0, 2900.0, 10.0, 1e10
STRONG = 1e19
"""Viscosity of the lower layer, Pa s."""
RATIOS = (1.0, 1e-3, 1e-6)
"""Viscosities of the upper layer over it."""
MAXH, TAU, STEPS = (250.0, 125.0), 5e10, 4
"""m, s."""
WAVE = 2 * math.pi / LENGTH


def factor(ratio: float) -> float:
    """K of the module's docstring with h_1 = h_2 and eta_1/eta_2 = ``ratio``."""
    f = WAVE * DEPTH
    of = math.cosh(2 * f) - 1 - 2 * f * f
    straight, sheared = math.sinh(2 * f) - 2 * f, math.sinh(2 * f) + 2 * f
    c, d = 2 * f * f * (ratio - 1) / of, straight * (ratio + 1) / of
    i, j = f * sheared * (ratio + 1) / of, 2 * f**3 * (ratio - 1) / of
    return -d / (c * j - d * i)


def _face(s: float) -> float:
    return DEPTH + FIRST * math.cos(WAVE * s)


def overturn(ratio: float, maxh: float) -> nv.Simulation:
    """Half a wave, from hydrostatic rest, J J' = rho_R g/K_e with J = 1 at the top."""
    body, upper, lower = (
        fluid(BULK),
        *(nv.StokesViscosity(K_v=0.0, G_v=eta) for eta in (ratio * STRONG, STRONG)),
    )
    bodies = (
        nv.Body(name="upper", where=nv.Subdomain("u"), material=body, viscosity=upper, density=HEAVY),
        nv.Body(name="lower", material=body, viscosity=lower, density=LIGHT),
    )
    weight = IfPos(y - DEPTH, HEAVY * (y - 2 * DEPTH), LIGHT * (y - DEPTH) - HEAVY * DEPTH)
    J = (1 + 2 * GRAVITY / BULK * weight) ** 0.5
    return nv.Simulation(
        layers(LENGTH / 2, (lambda s: 0.0, _face, lambda s: 2 * DEPTH), "lu", maxh),
        nv.Model(bodies=bodies, loads=(nv.Gravity((0.0, -GRAVITY)),)),
        time=nv.TimeSteps(dt=TAU, velocity_scale=1e-12),
        initial=nv.Initial(F=J ** (1 / 3) * Id(3)),
        walls={"top": nv.NoSlip(), "bottom": nv.NoSlip()},
        newton=nv.NewtonOptions(tolerance=1e-6),
    )


def _amplitude(run: nv.Simulation) -> float:
    """Of the face, m: what the upper layer's fraction says."""
    return 4 / LENGTH * float(Integrate(run.fields["lower_fraction"] * cos(WAVE * x), run.mesh, order=6))


@CASES(f"""rayleigh-taylor-viscous
    A heavy viscous layer over a lighter one overturns at the rate of linear theory, over six decades of their
      viscosities.
    label: benchmark: Ramberg (1968), Gerya (2010)
    setting: Layers of {DEPTH:g} m, {HEAVY:g} over {LIGHT:g} kg/m3, g = {GRAVITY:g} m/s2, viscosities of the
      lower one {STRONG:g} Pa s and of the upper one that times 1, 1e-3 and 1e-6 (growth factor
      {factor(1e-06):.4f}); K_e = {BULK:g} Pa; half a wave of {LENGTH:g} m, slip at the sides; cells of
      {MAXH[0]:g} m and {MAXH[1]:g} m, backward Euler, {STEPS} steps of {TAU:g} s.
    - relative error, viscosities 1e13 and 1e19 Pa s <= 0.015: volumes and densities by 0.5 % at the face, (k
      A)^2 = 0.2 %, twelve cells through a layer
    - largest relative error <= 0.03: the coarser mesh, too
    - drift
    - closure
    """)
def _growth() -> Outcome:
    rows, errors = [], {}
    for ratio in RATIOS:
        for maxh in MAXH:
            run = overturn(ratio, maxh)
            for _ in range(STEPS):
                before = _amplitude(run)
                row = run.advance()
            rate = (1 - before / _amplitude(run)) / row["dt"]
            found = rate * 2 * STRONG / ((HEAVY - LIGHT) * GRAVITY * DEPTH)
            errors[ratio, maxh] = abs(found / factor(ratio) - 1)
            count = float(run.ledger.column("newton_iterations").sum())
            rows.append([ratio, maxh, found, factor(ratio), errors[ratio, maxh], count])
    return measured(
        {
            "relative error, viscosities 1e13 and 1e19 Pa s": errors[RATIOS[-1], MAXH[-1]],
            "largest relative error": max(errors.values()),
        },
        Table(
            "growth factor", "eta_1/eta_2 | cells, m | found | analytic | relative error | iterations", rows
        ),
        "The bounds were written after trials with A = 10 m and 50 m of three steps.",
    )
