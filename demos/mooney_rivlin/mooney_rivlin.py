"""A Mooney-Rivlin block, set in rotation inside its box, recoils elastically.
Run with ``python demos/mooney_rivlin/mooney_rivlin.py [output directory]``; needs the extra ``plots``.
"""

import sys
from pathlib import Path

from ngsolve import cos, pi, sin, x, y

import ngvisco as nv
from ngvisco.geometries import box


def simulation(
    G_mr: float = 2.5, maxh: float = 0.25, dt: float = 0.02, gravity: float = 0.0, **options
) -> nv.Simulation:
    """A block of 1 m x 1 m with up to 0.5 m/s at the start; G_e + G_mr = 5 Pa for every G_mr."""
    model = nv.Model(
        material=nv.ReferentialMooneyRivlin(K_e=20.0, G_e=5.0 - G_mr, G_mr=G_mr),
        viscosity=nv.StokesViscosity(K_v=0.1, G_v=0.1),
        hyperviscosity=nv.HyperViscosity(mu=1e-5, p=4),
        loads=[nv.Gravity((0.0, -gravity))] if gravity else [],
    )
    swirl = (0.5 * sin(pi * x) * cos(pi * y), -0.5 * cos(pi * x) * sin(pi * y))
    options = {"initial": nv.Initial(velocity=swirl), "scheme": "midpoint", **options}
    return nv.Simulation(box((1, 1), maxh=maxh), model, dt=dt, **options)


def main(directory: str = "results/mooney_rivlin", until: float = 1.0) -> nv.Simulation:
    run = simulation()
    shown = {"von Mises stress, Pa": "von_mises", "J": "J", "N₁₂ of J^(−7/6) Cof F": "N_12"}
    ledgers = {"midpoint": nv.record(run, directory, until, show=shown)}
    ledgers["backward Euler"] = simulation(scheme="backward-euler").run(until)
    nv.plot_schemes(ledgers, Path(directory) / "schemes.png")
    return run


if __name__ == "__main__":
    main(*sys.argv[1:2])
