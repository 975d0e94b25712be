"""Toroidal modes of an elastic ball: frequencies that seismology knows, on curved cells in 3D.

A toroidal displacement turns every shell about an axis, each of its parts by another angle.  It is tangential
to the sphere and changes no volume, so that a wall with slip, v . n = 0 without tangential traction, is a
free surface for it.  In a homogeneous ball of radius R with shear speed c the velocity of mode nTl about z is

    v = j_l(k r)/r^l  Q_l(r, z)  (-y, x, 0),      r^{l-1} P_l'(z/r) = Q_l,      omega = k c,

and tau_{r phi} = 0 at r = R is (l - 1) j_l(x) = x j_{l+1}(x) for x = k R (Lamb 1882; Dahlen and Tromp,
Theoretical Global Seismology, 1998, Section 8.6).  The least roots are 2.5011, 3.8647, 5.0946.
"""

import math
from dataclasses import dataclass

import numpy as np
from ngsolve import CF, CoefficientFunction, InnerProduct, Integrate, x, y, z
from scipy.optimize import brentq
from scipy.special import spherical_jn

import ngvisco as nv
from ngvisco.geometries import sphere
from tests.verification.case import Cases, Curve, Outcome, Plot, Table, measured

CASES = Cases("Exact solutions: waves")

K_E, G_E = 2.0, 1.0
"""Pa; with rho = 1 kg/m^3 and R = 1 m the frequency is the root itself, in 1/s."""
AMPLITUDE = 1e-2
"""m/s, of the fastest point: strains of half a per cent."""
PER_PERIOD, PERIODS = 16, 2
SIZES = (0.36, 0.25)
"""m: 265 and 984 tetrahedra."""
TERMS = 16
"""Of the power series of j_l: its rest is below rounding for arguments up to 6."""


def root(degree: int) -> float:
    """The least x > 0 of (l - 1) j_l(x) = x j_{l+1}(x)."""

    def traction(x: float) -> float:
        return (degree - 1) * spherical_jn(degree, x) - x * spherical_jn(degree + 1, x)

    return float(brentq(traction, 0.8 * degree + 0.3, degree + 2.2, xtol=1e-14))


def mode(degree: int) -> CoefficientFunction:
    """The velocity of 0Tl in the unit ball, not normalised; a power series, which is smooth at the centre."""
    k, square = root(degree), x * x + y * y + z * z
    radial, power = CF(0.0), CF(1.0)
    for n in range(TERMS):
        double_factorial = math.prod(range(1, 2 * degree + 2 * n + 2, 2))
        radial = radial + (-1) ** n * k ** (2 * n) / (2**n * math.factorial(n) * double_factorial) * power
        power = power * square
    zonal = {2: z, 3: 5 * z**2 - square, 4: 7 * z**3 - 3 * z * square}[degree]
    return radial * zonal * CF((-y, x, 0.0))


@dataclass(frozen=True)
class Oscillation:
    """A mode's run: ``frequency`` in 1/s, ``decay`` in 1/s, ``values`` of v : mode over the first."""

    run: nv.Simulation
    frequency: float
    decay: float
    values: np.ndarray


def oscillation(degree: int, maxh: float, material: nv.Material) -> Oscillation:
    """Two periods by the midpoint rule from the mode's velocity and no strain.

    The values obey a_n+1 = (q + q*) a_n - |q|^2 a_n-1 with q = (1 + s tau/2)/(1 - s tau/2), from which
    s = -decay + i frequency follows without the error of the step.
    """
    mesh, shape = sphere(1.0, maxh), mode(degree)
    fastest = max(abs(shape(mesh(0.02 * i, 0.0, 0.02 * j))[1]) for i in range(35) for j in range(35))
    tau = 2 * math.pi / root(degree) / PER_PERIOD
    run = nv.Simulation(
        mesh,
        nv.Model(material=material),
        time=nv.TimeSteps(dt=tau, scheme="midpoint", velocity_scale=1.0),
        initial=nv.Initial(velocity=AMPLITUDE / fastest * shape),
        discretisation=nv.Discretisation(k=2, m=1),
    )
    values = []
    for n in range(PERIODS * PER_PERIOD + 1):
        if n:
            run.advance()
        values.append(float(Integrate(InnerProduct(run.fields["velocity"], shape), mesh, order=8)))
    a = np.array(values) / values[0]
    b = np.linalg.lstsq(np.array([a[1:-1], a[:-2]]).T, a[2:], rcond=None)[0]
    q = complex(np.roots([1.0, -b[0], -b[1]])[0])
    s = 2 / tau * (q - 1) / (q + 1)
    return Oscillation(run, abs(s.imag), -s.real, a)


@CASES(f"""toroidal-modes
    An elastic ball that a wall with slip encloses swings in its toroidal modes 0T2, 0T3 and 0T4 with the
      frequencies of a free one; the midpoint rule keeps their energy.
    label: Euler-small-viscoelastodyn+; Lamb 1882
    setting: R = 1 m, rho = 1 kg/m3, K_e = {K_E:g} Pa, G_e = {G_E:g} Pa, no viscosity; curved tetrahedra, maxh
      = {SIZES[0]:g} and {SIZES[1]:g} m, k = 2, m = 1; midpoint, {PER_PERIOD} steps a period, two periods; the
      step's own factor is undone.
    - relative error of 0T2 <= 3e-3: eight quadratic cells in a diameter
    - relative error of 0T3 <= 1e-2: eight quadratic cells in a diameter
    - relative error of 0T4 <= 2e-2: eight quadratic cells in a diameter
    - least ratio of the errors of both meshes >= 2.0: order h^2 at least: 1.55^2 = 2.4
    - finite against small strain, 0T2 <= 1e-3: strains of half a per cent
    - change of the energy <= 1e-4: a linear problem, but for the upwinding
    - closure
    """)
def _toroidal() -> Outcome:
    degrees, linear = (2, 3, 4), nv.LinearElastic(K_e=K_E, G_e=G_E)
    rows, curves, errors, kept = [], [], {}, []
    for degree in degrees:
        exact = root(degree)
        for maxh in SIZES:
            found = oscillation(degree, maxh, linear)
            error = found.frequency / exact - 1
            errors[degree, maxh] = abs(error)
            energy = found.run.ledger.column("kinetic") + found.run.ledger.column("stored")
            kept.append(abs(float(energy[-1] / energy[0]) - 1))
            rows.append([f"0T{degree}", found.run.mesh.ne, found.frequency, exact, error, found.decay])
        times = found.run.ledger.column("time") * exact / (2 * math.pi)
        curves.append(Curve(f"0T{degree}", times, found.values, "o"))
    fine = np.linspace(0, PERIODS, 200)
    exactly = [math.cos(2 * math.pi * float(t)) for t in fine]
    curves.append(Curve("exact", fine, exactly, "k-"))
    finite = oscillation(2, SIZES[0], nv.ReferentialNeoHookean(K_e=K_E, G_e=G_E / 2, elastic_state="F"))
    of_linear = rows[0][2]
    assert isinstance(of_linear, float)
    coarse, best = SIZES
    # by what the error shrinks; the meshes' cells are smaller by (984/265)^(1/3) = 1.55
    gains = [errors[degree, coarse] / errors[degree, best] for degree in degrees]
    return measured(
        {
            **{f"relative error of 0T{degree}": errors[degree, best] for degree in degrees},
            "least ratio of the errors of both meshes": min(gains),
            "finite against small strain, 0T2": abs(finite.frequency / of_linear - 1),
            "change of the energy": max(kept),
        },
        Table("frequencies", "mode | tetrahedra | omega, 1/s | exact | error | decay, 1/s", rows),
        Plot("Toroidal modes, finer mesh", "t, periods of each", "amplitude of v", curves),
        "In the picture the values fall behind by the midpoint rule's own error of the phase, "
        "(omega tau)²/12 = 1.3 % at 16 steps a period; the table's frequencies are without it.",
    )
