"""Simple shear of a Zaremba-Jaumann Maxwell fluid between sliding walls, against its exact solution.
Run with ``python demos/shear/shear.py [output directory]``; needs the extra ``plots``.
"""

import sys
from pathlib import Path

import numpy as np
from ngsolve import SetNumThreads, y

import ngvisco as nv
from ngvisco.geometries import channel
from ngvisco.run.pictures import figure

RATE, G, ETA, DT = 0.3, 100.0, 100.0, 0.0025  # 1/s, Pa, Pa s, s
TIMES = (0.01, 0.02, 0.1, 0.25, 0.5, 1.0, 2.0)  # s


def exact(t: np.ndarray) -> np.ndarray:
    """The exact tau_12 and tau_11, one row for each of the times t."""
    r, c, w, decay = RATE * ETA / G, np.cos(RATE * t), np.sin(RATE * t), np.exp(-G * t / ETA)
    return RATE * ETA / (1 + r**2) * np.array([1 - decay * (c - r * w), r - decay * (r * c + w)]).T


def simulation(dt: float = DT, scheme: str = "midpoint", **options) -> nv.Simulation:
    """A body of 2 m x 1 m, periodic in x; its fields are uniform, so that four cells with k = 1, m = 0
    suffice."""
    model = nv.Model(material=nv.LinearElastic(K_e=200.0, G_e=G), creep=nv.Creep(G_m=2 * ETA))
    options["walls"] = {"top": nv.PrescribedTangential((RATE, 0.0)), "bottom": nv.NoSlip()}
    options |= {"initial": nv.Initial(velocity=(RATE * y, 0)), "discretisation": nv.Discretisation(k=1, m=0)}
    return nv.Simulation(channel(2, 1, maxh=1), model, dt=dt, scheme=scheme, **options)


def stress(run: nv.Simulation) -> tuple[float, float]:
    """The components tau_12 and tau_11 of dev S = 2 G dev E, Pa."""
    E = np.reshape(run.fields["E"](run.mesh(0.4, 0.4)), (3, 3))
    return 2 * G * E[0, 1], 2 * G * (E[0, 0] - np.trace(E) / 3)


def main(directory: str = "results/shear") -> dict[str, tuple[nv.Simulation, np.ndarray]]:
    Path(directory).mkdir(parents=True, exist_ok=True)
    SetNumThreads(1)  # a second thread only waits on four cells
    (fig, ((left, right),)), results, s = figure(1, 2, (11, 4.6)), {}, np.linspace(0, 2)
    for scheme, color, mark in (("midpoint", "C0", "o"), ("backward-euler", "C3", "x")):
        run, rows = simulation(scheme=scheme), []
        for t in TIMES:
            run.run(t)
            rows.append(stress(run))
        results[scheme] = run, (errors := abs(np.array(rows) / exact(np.array(TIMES)) - 1))
        left.plot(s, exact(s), "k", TIMES, rows, color + mark, lw=1)
        for e, line, name in zip(errors.T, ":-", ("τ₁₂", "τ₁₁"), strict=True):
            right.loglog(TIMES, e, color + mark + line, label=f"{name}, {scheme}: ≤ {e.max():.1e}")
    left.set(xlabel="time, s", title="τ₁₂ (above) and τ₁₁, Pa: exact (lines), ngvisco (dots)")
    right.set(xlabel="time, s", title=f"relative errors, steps of {DT} s")
    right.legend(loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=2)
    fig.savefig(Path(directory) / "stress.png", dpi=110)
    return results


if __name__ == "__main__":
    main(*sys.argv[1:2])
