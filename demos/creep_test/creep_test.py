"""A creep test: a fit of a layer's modulus and viscosity to a noisy record of its surface's displacement.
Run with ``python demos/creep_test/creep_test.py [output directory]``; needs the extra ``plots``.
"""

import sys
from pathlib import Path

import numpy as np

import ngvisco as nv
from ngvisco.geometries import channel

TRUE, NOISE = {"material.G_e": 1.3, "creep.G_m": 2.5}, 3e-4
"""The layer's true parameters (Pa, Pa s), and the standard deviation of the record, m."""
SURFACE = "integral of top.velocity_1"


def simulation(maxh: float = 0.25, G_e: float = 1.0, G_m: float = 2.0, **options) -> nv.Simulation:
    """A layer of 1 m x 1 m, periodic in x, pulled by 0.1 Pa from the start; the default numbers are a
    guess."""
    model = nv.Model(
        material=nv.NeoHookean(K_e=10, G_e=G_e, epsilon=0.1),
        viscosity=nv.StokesViscosity(K_v=0.2, G_v=0.2),
        creep=nv.Creep(G_m=G_m),
    )
    walls = {"top": nv.Traction(f=(0.1, 0.0)), "bottom": nv.NoSlip()}
    probes = nv.Probes({"top": (0.5, 1.0)}, ["velocity"])
    given = {"dt": 0.1, "scheme": "backward-euler", "walls": walls, "observers": [probes]}
    return nv.Simulation(channel(1, 1, maxh=maxh), model, **given | options)


def record(until: float, maxh: float) -> dict[str, np.ndarray]:
    """Displacements of the true layer's surface twice a second, with noise."""
    times = np.arange(0.5, until + 1e-9, 0.5)
    of = [f"top.velocity_1 until {t:.1f}" for t in times]
    run = simulation(maxh, *TRUE.values())
    exact = nv.gradient(run, until, of=of, by=["material.G_e"]).values
    return {"time": times, SURFACE: exact + NOISE * np.random.default_rng(1).standard_normal(len(times))}


def main(directory: str = "results/creep_test", until: float = 6.0, maxh: float = 0.25) -> nv.Fit:
    found = nv.fit(simulation(maxh), record(until, maxh), by=list(TRUE), sigma=NOISE, progress=print)
    print(found)
    Path(directory).mkdir(parents=True, exist_ok=True)
    found.plot(Path(directory) / "fit.png")
    return found


if __name__ == "__main__":
    main(*sys.argv[1:2])
