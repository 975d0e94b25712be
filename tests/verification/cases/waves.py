"""Waves of small amplitude against the dispersion relation, with viscosity and hyperviscosity."""

import math
from functools import partial

import numpy as np
from ngsolve import CF, Integrate, cos, x

import ngvisco as nv
from ngvisco.geometries import box
from tests.verification.case import Cases, Curve, Outcome, Plot, Table, measured
from tests.verification.setups import KINDS, elastic

CASES = Cases("Exact solutions: waves")

K_E, G_E, G_V, K_V, MU = 2.0, 1.0, 0.02, 0.01, 1e-3
AMPLITUDE = 1e-2
"""m/s: strains of at most 1 %, and well above the width of the smoothed upwinding (1e-4 m/s)."""


def dispersion(k: float, wave: str, mu: float, viscous: bool = True) -> complex:
    """s of rho s² + (D k² + mu k⁴) s + M k² = 0, rho = 1: the decay is −Re s, the phase speed |Im s|/k."""
    M = G_E if wave == "shear" else K_E + 4 / 3 * G_E
    D = (G_V if wave == "shear" else K_V + 4 / 3 * G_V) if viscous else 0.0
    return complex(np.roots([1.0, D * k**2 + mu * k**4, M * k**2])[0])


def standing_wave(
    kind: str,
    wave: str,
    k: float,
    dt: float,
    steps: int,
    mu: float = MU,
    viscous: bool = True,
    scheme: str = "backward-euler",
) -> tuple[nv.Simulation, np.ndarray]:
    """Amplitudes of the velocity in a strip of one wave length, periodic in x and y, after every step."""
    length = 2 * math.pi / k
    model = nv.Model(
        material=elastic(kind, K_E, G_E),
        viscosity=nv.StokesViscosity(K_v=K_V, G_v=G_V) if viscous else None,
        hyperviscosity=nv.HyperViscosity(mu=mu, p=2) if mu else None,
    )
    shape = cos(k * x)
    velocity = (0.0, AMPLITUDE * shape) if wave == "shear" else (AMPLITUDE * shape, 0.0)
    mesh = box((length, length / 4), length / 8, periodic="xy")
    run = nv.Simulation(
        mesh,
        model,
        time=nv.TimeSteps(dt=dt, velocity_scale=1.0, scheme=scheme),  # type: ignore[arg-type]
        initial=nv.Initial(velocity=CF(velocity)),
        discretisation=nv.Discretisation(k=3, m=2),
    )
    component, values = 1 if wave == "shear" else 0, [1.0]
    for _ in range(steps):
        run.advance()
        moment = Integrate(run.fields["velocity"][component] * shape, mesh, order=8)
        values.append(float(moment) / (AMPLITUDE * length**2 / 8))
    return run, np.array(values)


def exponent(a: np.ndarray, dt: float) -> complex:
    """s of a_n+1 = (z + z*) a_n − |z|² a_n-1: an implicit step multiplies by z = 1/(1 − s tau)."""
    b = np.linalg.lstsq(np.array([a[2:-1], a[1:-2]]).T, a[3:], rcond=None)[0]
    return complex((1 - 1 / np.roots([1.0, -b[0], -b[1]])[0]) / dt)


WAVE_NUMBERS = (1.0, 2.0, 5.0, 10.0)


def _dispersion(kind: str, wave: str) -> Outcome:
    rows, speeds, decays = [], [], []
    for k in WAVE_NUMBERS:
        exact = dispersion(k, wave, MU)
        dt = 0.1 / abs(exact)
        _, a = standing_wave(kind, wave, k, dt, 30)
        s = exponent(a, dt)
        speed, decay = abs(s.imag) / k, -s.real
        speeds.append(abs(speed / (abs(exact.imag) / k) - 1))
        decays.append(abs(decay / -exact.real - 1))
        rows.append([k, speed, abs(exact.imag) / k, speeds[-1], decay, -exact.real, decays[-1]])
    fine = np.logspace(0, 1, 60)
    relation = [dispersion(float(k), wave, MU) for k in fine]
    exact_speeds = [abs(s.imag) / k for s, k in zip(relation, fine, strict=True)]
    head = ["k, 1/m", "speed, m/s", "exact", "error", "decay, 1/s", "exact", "error"]
    return measured(
        {
            "largest relative error of the phase speed": max(speeds),
            "largest relative error of the decay": max(decays),
        },
        Table("phase speed and decay", head, rows),
        Plot(
            f"{wave} wave: phase speed and decay",
            "k, 1/m",
            "m/s and 1/s",
            [
                Curve("phase speed, exact", fine, exact_speeds, "-"),
                Curve("decay, exact", fine, [-s.real for s in relation], "-"),
                Curve("phase speed", WAVE_NUMBERS, [row[1] for row in rows], "o"),
                Curve("decay", WAVE_NUMBERS, [row[4] for row in rows], "s"),
            ],
            log="xy",
        ),
        *[
            "At finite strain the upwinding also keeps the jumps of F small: with amplitudes below its "
            "smoothed width the fluxes are central, and the errors of the short waves grow to 1 to 2 %."
        ]
        * (kind == "finite"),
    )


for kind in KINDS:
    for wave in ("shear", "acoustic"):
        CASES(f"""dispersion-{wave}-{kind}{" (reduced)" * (kind == "linearised" and wave == "shear")}
            A small {wave} wave in {KINDS[kind]} has the phase speed and the decay of the dispersion relation
              rho omega² = M k² − i omega (D k² + mu k⁴), over a decade of k.
            label: {"Euler-small-viscoelastodyn+1" if kind == "linearised" else "ED-Euler-large1"}
            setting: Strip of one wave length, periodic; M = {"G_e" if wave == "shear" else "K_e + 4/3 G_e"},
              K_e = {K_E:g} Pa, G_e = {G_E:g} Pa, K_v = {K_V:g}, G_v = {G_V:g} Pa s, mu = {MU:g} Pa s m2 with
              p = 2; k = 1, 2, 5, 10 1/m; k = 3, m = 2, eight cells a wave, 30 steps; the step's own factor is
              undone.
            - largest relative error of the phase speed <= 2e-3: eight cubic cells a wave
            - largest relative error of the decay <= 1e-2: eight cubic cells a wave
            - closure
            """)(partial(_dispersion, kind, wave))
