"""A neo-Hookean block, set in rotation inside its box under gravity, recoils elastically.
Run with ``python demos/swirl/swirl.py [output directory]``; needs the extra ``plots``.
"""

import sys
from pathlib import Path

from ngsolve import cos, pi, sin, x, y

import ngvisco as nv
from ngvisco.geometries import box


def simulation(maxh: float = 0.1, dt: float = 0.02, gravity: float = 1.0, **options) -> nv.Simulation:
    """A block of 1 m x 1 m in plane strain."""
    model = nv.Model(
        material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1),
        viscosity=nv.StokesViscosity(K_v=0.01, G_v=0.01),
        hyperviscosity=nv.HyperViscosity(mu=1e-5, p=4),
        loads=[nv.Gravity((0.0, -gravity))] if gravity else [],
    )
    initial = nv.Initial(density=1.0, velocity=(sin(pi * x) * cos(pi * y), -cos(pi * x) * sin(pi * y)))
    options = {"scheme": "midpoint", **options}
    return nv.Simulation(box((1, 1), maxh=maxh), model, dt=dt, initial=initial, **options)


def main(directory: str = "results/swirl", until: float = 1.0, maxh: float = 0.1) -> nv.Simulation:
    run = simulation(maxh)
    shown = {"J": "J", "von Mises stress, Pa": "von_mises", "density, kg/m³": "density"}
    ledgers = {"midpoint": nv.record(run, directory, until, show=shown)}
    # in longer steps J and det F, which are transported separately, would drift apart by more than 1 %
    ledgers["backward Euler"] = simulation(maxh, dt=0.00625, scheme="backward-euler").run(until)
    nv.plot_schemes(ledgers, Path(directory) / "schemes.png")
    return run


if __name__ == "__main__":
    main(*sys.argv[1:2])
