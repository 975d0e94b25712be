"""Simple shear of a Zaremba-Jaumann Maxwell fluid between sliding walls, against its exact solution.
Run with ``python demos/shear/shear.py [output directory]``; needs the extra ``plots``.
"""

import sys
from pathlib import Path

import numpy as np
from ngsolve import SetNumThreads, y

import ngvisco as nv
from ngvisco.geometries import channel
from ngvisco.run.plots import figure

RATE, G, ETA = 0.3, 100.0, 100.0  # 1/s, Pa, Pa s
TIMES = (0.01, 0.02, 0.1, 0.25, 0.5, 1.0, 2.0)  # s
DT = 1.65e-6  # first step, s; doubled after every 400 steps, so that dt is t/800 to t/400
GROWING = nv.AdaptiveSteps(dt_min=DT / 2, dt_max=0.01, patience=400)


def exact(t: np.ndarray) -> np.ndarray:
    """Rows of tau_12 and tau_11 at the times t."""
    r, c, w = RATE * ETA / G, np.cos(RATE * t), np.sin(RATE * t)
    decay, scale = np.exp(-G * t / ETA), RATE * ETA / (1 + (RATE * ETA / G) ** 2)
    return scale * np.array([1 - decay * (c - r * w), r - decay * (r * c + w)]).T


def simulation(dt: float = DT, **options) -> nv.Simulation:
    """2 m x 1 m, periodic in x; the fields are uniform, so that four cells with m = 0 hold them exactly."""
    model = nv.Model(material=nv.LinearElastic(K_e=200.0, G_e=G), creep=nv.Creep(G_m=2 * ETA))
    options["walls"] = {"top": nv.PrescribedTangential((RATE, 0.0)), "bottom": nv.NoSlip()}
    options["initial"] = nv.Initial(velocity=(RATE * y, 0))
    options["discretisation"] = nv.Discretisation(m=0)
    return nv.Simulation(channel(2, 1, maxh=1), model, dt=dt, **options)


def stress(run: nv.Simulation) -> tuple[float, float]:
    """tau_12 and tau_11 of dev S = 2 G dev E, Pa."""
    E = np.reshape(run.fields["E"](run.mesh(0.4, 0.4)), (3, 3))
    return 2 * G * E[0, 1], 2 * G * (E[0, 0] - np.trace(E) / 3)


def main(directory: str = "results/shear") -> tuple[nv.Simulation, np.ndarray]:
    Path(directory).mkdir(parents=True, exist_ok=True)
    SetNumThreads(1)  # a second one only waits on four cells
    run = simulation(stepping=GROWING)
    curve = []
    for t in TIMES:
        run.run(t)
        curve.append(stress(run))
        print(f"t = {t:.2f} s, step {run.number}: errors {np.array(curve[-1]) / exact(t) - 1}")
    fig, ((axis,),) = figure(1, 1, (7, 4))
    axis.plot(np.linspace(0, 2), exact(np.linspace(0, 2)), "k-", TIMES, curve, "o", lw=1, ms=4)
    axis.set(xlabel="time, s", ylabel="τ₁₂ (above) and τ₁₁, Pa", title="exact (lines) and ngvisco (dots)")
    fig.savefig(Path(directory) / "stress.png", dpi=110)
    return run, np.array(curve) / exact(np.array(TIMES)) - 1


if __name__ == "__main__":
    main(*sys.argv[1:2])
