"""Large strains in closed form: a circularly polarised wave in three dimensions, a ring that is twisted."""

import math
from typing import Any

import numpy as np
from ngsolve import CF, IfPos, Integrate, cos, sin, x, y

import ngvisco as nv
from ngvisco.geometries import annulus, box
from ngvisco.physics.tensors import square
from tests.verification.case import Cases, Measured, Table
from tests.verification.setups import elastic, followed

CASES = Cases("Exact solutions: shear and relaxation")

# --- a circularly polarised wave -------------------------------------------------------------------------
"""The displacement u = A (0, cos(kx - wt), sin(kx - wt)) gives |F|^2 = 3 + A^2 k^2 and J = 1 at every point.
A neo-Hookean body therefore has the same normal stress everywhere, and its wave keeps its form at any strain
A k (Carroll 1967), with rho s^2 + G_v k^2 s + G k^2 = 0 for the shear modulus G and a viscosity G_v."""

G, K, CELLS, STEPS = 5.0, 50.0, 8, 60
WAVES: tuple[tuple[Any, float, float], ...] = (("finite", 0.0, 0.0), ("finite-b", 0.05, 0.7))
"""Material by its variable, viscosity G_v, Pa s, and the velocity of the whole body, m/s."""


def _wave(kind: str, viscosity: float, speed: float, modulus: float = G) -> list[float]:
    """Frequency and decay of a wave of strain 1, over their exact values, and the velocity along the wave
    over the velocity of the wave."""
    k = 2 * math.pi
    swing = k * math.sqrt(G)
    period, amplitude = 2 * math.pi / swing, 1 / k
    c, s = cos(k * x), sin(k * x)
    F = CF((1, 0, 0, -amplitude * k * s, 1, 0, amplitude * k * c, 0, 1), dims=(3, 3))
    velocity = CF((speed, amplitude * swing * s, -amplitude * swing * c))
    mesh = box((1, 2 / CELLS, 2 / CELLS), 1 / CELLS, periodic="xyz")
    run = nv.Simulation(
        mesh,
        nv.Model(
            material=elastic(kind, K, modulus),
            viscosity=nv.StokesViscosity(K_v=viscosity, G_v=viscosity) if viscosity else None,
        ),
        dt=period / STEPS,
        scheme="midpoint",
        initial=nv.Initial(density=1.0, velocity=velocity, F=F),
    )
    v = run.fields["velocity"]

    def turned(run: nv.Simulation) -> complex:
        parts = Integrate(CF((v[1] * c + v[2] * s, v[2] * c - v[1] * s)), mesh, order=6)
        return complex(*parts)

    _, values = followed(run, STEPS, turned)
    phase = np.unwrap(np.angle(values))
    # the tangent corrects the phase error of the midpoint rule
    rate = 2 / run.dt * math.tan((phase[0] - phase[-1]) / STEPS / 2)
    exact = complex(np.roots([1.0, viscosity * k**2, G * k**2])[0])
    size = (Integrate(square(v[0] - speed), mesh) / Integrate(CF(1.0), mesh)) ** 0.5
    decay = abs(values[-1] / values[0]) / math.exp(exact.real * period)
    return [(rate - k * speed) / abs(exact.imag), decay, size / (amplitude * swing)]


@CASES(f"""polarised-wave
    A circularly polarised shear wave of strain 1 in a neo-Hookean body has the frequency and the decay of a
      small wave, also in a body that moves.
    label: ED-Euler-large1, exa-neo-Hookean-ref
    setting: Box of one wave length, periodic in x, y and z, {CELLS} cells along the wave, G = {G:g} Pa,
      K = {K:g} Pa, density 1, midpoint, a period of {STEPS} steps; by F at rest, and by B with G_v = 0.05
      Pa s at 0.7 m/s.
    - least frequency over the exact one in [0.99, 1.01]: eight quadratic cells a wave
    - largest frequency over the exact one in [0.99, 1.01]: eight quadratic cells a wave
    - least amplitude over the exact one in [0.97, 1.003]: jumps take some energy
    - largest amplitude over the exact one in [0.97, 1.003]: jumps take some energy
    - largest error of the velocity along the wave, over the wave's velocity <= 0.02: no normal stress varies
    - error of the frequency with a shear modulus of 1.1 G >= 0.04: a control
    - closure
    """)
def _polarised() -> Measured:
    rows = [_wave(*wave) for wave in WAVES]
    for name, i in (("frequency", 0), ("amplitude", 1)):
        yield f"least {name} over the exact one", min(row[i] for row in rows)
        yield f"largest {name} over the exact one", max(row[i] for row in rows)
    yield (
        "largest error of the velocity along the wave, over the wave's velocity",
        max(row[2] for row in rows),
    )
    yield (
        "error of the frequency with a shear modulus of 1.1 G",
        abs(_wave("finite", 0.0, 0.0, 1.1 * G)[0] - 1),
    )
    head = "run | frequency | amplitude | velocity along the wave"
    names = [f"{kind}, G_v = {of:g} Pa s, {at:g} m/s" for kind, of, at in WAVES]
    table = [[name, *row] for name, row in zip(names, rows, strict=True)]
    yield Table("over the exact values", head, table)


# --- a twisted ring --------------------------------------------------------------------------------------
"""The inner wall of a neo-Hookean ring turns by an angle, and the outer wall is held.  At rest the shear
stress is C/r^2, the angle falls by theta' = -C/(G r^3), and T_tt - T_rr = G (r theta')^2 (Rivlin 1949).
By backward Euler with the same steps, B gives too large a difference (the control)."""

INNER, OUTER, ANGLE, TURNING, REST = 0.5, 1.0, 1.0, 1.0, 4.0
RADII = (0.55, 0.75, 0.95)


def _ring(kind: str, scheme: Any = "midpoint") -> tuple[list[list[float]], list[float]]:
    """Rows of the radius, r^2 T_rt and T_tt - T_rr, both over their exact values; then the pressure and the
    angle."""
    rate = IfPos(TURNING - nv.time, ANGLE / TURNING * (1 - cos(2 * math.pi * nv.time / TURNING)), 0.0)
    run = nv.Simulation(
        annulus(INNER, OUTER, 0.17),
        nv.Model(material=elastic(kind, 200.0, 1.0), viscosity=nv.StokesViscosity(K_v=1.0, G_v=0.2)),
        dt=0.05,
        scheme=scheme,
        walls={"inner": nv.PrescribedTangential((-y * rate, x * rate)), "outer": nv.NoSlip()},
        discretisation=nv.Discretisation(k=3, m=2),
        initial=nv.Initial(density=0.05),
        passive=["reference_map"],
    )
    run.run(TURNING + REST)
    C = 2 * ANGLE / (INNER**-2 - OUTER**-2)
    turns = np.linspace(0, 2 * math.pi, 36, endpoint=False)
    rows, radial, angles = [], [], []
    for r in RADII:
        points = run.mesh(r * np.cos(turns), r * np.sin(turns))
        T = run.fields["cauchy_stress"](points).reshape(-1, 3, 3)[:, :2, :2]
        Q = np.array([[np.cos(turns), np.sin(turns)], [-np.sin(turns), np.cos(turns)]])
        T_rr, T_rt, T_tt = (
            np.einsum("in,nij,jn->n", Q[a], T, Q[b]).mean() for a, b in ((0, 0), (0, 1), (1, 1))
        )
        X = run.fields["reference_map"](points)
        turned = np.angle(np.exp(1j * (turns - np.arctan2(X[:, 1], X[:, 0])))).mean()
        rows.append([r, abs(T_rt) * r * r / C, (T_tt - T_rr) / (C / r**2) ** 2])
        radial.append(T_rr)
        angles.append(turned / (ANGLE * (r**-2 - OUTER**-2) / (INNER**-2 - OUTER**-2)))
    rise = (radial[-1] - radial[0]) / (C * C / 4 * (RADII[0] ** -4 - RADII[-1] ** -4))
    return rows, [rise, angles[1]]


@CASES(f"""twisted-ring
    A neo-Hookean ring whose inner wall has turned has the shear stress, the normal stresses and the angles of
      the closed form, at shear strains of up to 2.7.
    label: exa-neo-Hookean-ref
    setting: Ring of {INNER:g} m to {OUTER:g} m, cells of 0.17 m, k = 3, m = 2, G = 1 Pa, K = 200 Pa; the
      inner wall turns by {ANGLE:g} in {TURNING:g} s and then rests for {REST:g} s; midpoint, steps of 0.05 s;
      by F and B.
    - least shear stress over the exact one in [0.98, 1.02]: K = 200 G, and 3 cubic cells across
    - largest shear stress over the exact one in [0.98, 1.02]: as above
    - least difference of the normal stresses over the exact one in [0.96, 1.04]: twice the error of the shear
    - largest difference of the normal stresses over the exact one in [0.96, 1.04]: as above
    - least rise of the radial stress over the exact one in [0.95, 1.05]: the difference, integrated
    - largest rise of the radial stress over the exact one in [0.95, 1.05]: as above
    - least angle at 0.75 m over the exact one in [0.99, 1.01]: C and the wall's angle give the angle
    - largest angle at 0.75 m over the exact one in [0.99, 1.01]: as above
    - largest error of the difference of the normal stresses by B and backward Euler >= 0.05: a control
    - closure
    """)
def _twisted() -> Measured:
    runs = {kind: _ring(kind) for kind in ("finite", "finite-b")}
    rows = [row for found, _ in runs.values() for row in found]
    wholes = [whole for _, whole in runs.values()]
    quantities = (
        ("shear stress", [row[1] for row in rows]),
        ("difference of the normal stresses", [row[2] for row in rows]),
        ("rise of the radial stress", [whole[0] for whole in wholes]),
        ("angle at 0.75 m", [whole[1] for whole in wholes]),
    )
    for name, values in quantities:
        yield f"least {name} over the exact one", min(values)
        yield f"largest {name} over the exact one", max(values)
    control, _ = _ring("finite-b", "backward-euler")
    name = "largest error of the difference of the normal stresses by B and backward Euler"
    yield name, max(abs(row[2] - 1) for row in control)
    runs["finite-b, backward Euler"] = control, []
    table = [[kind, *row] for kind, (found, _) in runs.items() for row in found]
    yield Table("stresses over the exact ones", "material | r, m | T_rt | T_tt - T_rr", table)
