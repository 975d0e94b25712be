"""Simple shear of a Zaremba-Jaumann Maxwell fluid between sliding walls, against its exact solution.

Run with ``python demos/shear/shear.py [output directory]``; needs the extra ``plots``.
"""

import sys
from pathlib import Path

import numpy as np
from ngsolve import y

import ngvisco as nv
from ngvisco.geometries import channel
from ngvisco.run.plots import figure

RATE, G, ETA = 0.3, 100.0, 100.0  # 1/s, Pa, Pa s
SERIES = ((0.01, (0.01, 0.02, 0.1)), (0.125, (0.25, 0.5, 1.0, 2.0)))  # longest step and times, s


def exact(t: np.ndarray) -> np.ndarray:
    """Rows of tau_12 and tau_11 at the times t."""
    r, c, w = RATE * ETA / G, np.cos(RATE * t), np.sin(RATE * t)
    decay, scale = np.exp(-G * t / ETA), RATE * ETA / (1 + (RATE * ETA / G) ** 2)
    return scale * np.array([1 - decay * (c - r * w), r - decay * (r * c + w)]).T


def stresses(dt: float, until: float) -> tuple[nv.Simulation, np.ndarray]:
    """The run in 1 m x 1 m, periodic in x, and rows (t, tau_12, tau_11) of dev S = 2 G dev E."""
    model = nv.Model(material=nv.LinearElastic(K_e=200.0, G_e=G), creep=nv.Creep(G_m=2 * ETA))
    walls = {"top": nv.PrescribedTangential((RATE, 0.0)), "bottom": nv.NoSlip()}
    start = nv.Initial(velocity=(RATE * y, 0))
    run = nv.Simulation(channel(1, 1, maxh=0.5), model, dt=dt, walls=walls, initial=start)
    rows = [(0.0, 0.0, 0.0)]
    while run.t < until - dt / 2:
        run.advance()
        E = np.reshape(run.fields["E"](run.mesh(0.4, 0.4)), (3, 3))
        rows.append((run.t, 2 * G * E[0, 1], 2 * G * (E[0, 0] - np.trace(E) / 3)))
    return run, np.array(rows)


def main(directory: str = "results/shear") -> tuple[list[nv.Simulation], np.ndarray]:
    Path(directory).mkdir(parents=True, exist_ok=True)
    fig, ((axis,),) = figure(1, 1, (7, 4))
    axis.plot(np.linspace(0, 2), exact(np.linspace(0, 2)), "k-", lw=1)
    runs, errors = [], []
    for dt, times in SERIES:  # steps dt, dt/2, dt/4: the scheme is of first order, so extrapolate twice
        (_, a), (_, b), (run, c) = (stresses(dt / n, times[-1]) for n in (1, 2, 4))
        curve = (8 * c[::4] - 6 * b[::2] + a) / 3
        runs.append(run)
        for t, *tau in curve[[round(t / dt) for t in times]]:
            errors.append(tau / exact(t) - 1)
            print(f"t = {t:.2f} s: tau_12 {tau[0]:.5f} Pa, tau_11 {tau[1]:.6f} Pa, errors {errors[-1]}")
        axis.plot(curve[:, 0], curve[:, 1:], "o", ms=4)
    axis.set(xlabel="time, s", ylabel="τ₁₂ (above) and τ₁₁, Pa", title="exact (lines) and ngvisco (dots)")
    fig.savefig(Path(directory) / "stress.png", dpi=110)
    return runs, np.array(errors)


if __name__ == "__main__":
    main(*sys.argv[1:2])
