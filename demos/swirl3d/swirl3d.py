"""The swirl in three dimensions: a neo-Hookean cube creeps and rotates about its z axis.

Run with ``python demos/swirl3d/swirl3d.py [output directory]``; needs the extra ``plots``.
"""

import sys

from ngsolve import cos, pi, sin, x, y, z

import ngvisco as nv
from ngvisco.geometries import box


def simulation(maxh: float = 0.25, dt: float = 0.02, gravity: float = 1.0, **options) -> nv.Simulation:
    """A cube of 1 m, Maxwell time 0.01 s; the rotation is fastest at the top."""
    model = nv.Model(
        material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1),
        viscosity=nv.StokesViscosity(K_v=0.01, G_v=0.01),
        hyperviscosity=nv.HyperViscosity(mu=1e-5, p=4),
        creep=nv.Creep(G_m=0.2),
        loads=[nv.Gravity((0.0, 0.0, -gravity))] if gravity else [],
    )
    shape = (1 + z) / 2
    velocity = (shape * sin(pi * x) * cos(pi * y), -shape * cos(pi * x) * sin(pi * y), 0.0)
    initial = nv.Initial(density=1.0, velocity=velocity)
    return nv.Simulation(box((1, 1, 1), maxh=maxh), model, dt=dt, initial=initial, **options)


def main(directory: str = "results/swirl3d", until: float = 1.0, **options) -> nv.Simulation:
    run = simulation(**options)
    speed = "sqrt(velocity_1**2 + velocity_2**2 + velocity_3**2)"
    shown = {"speed at z = 1/2, m/s": speed, "von Mises stress at z = 1/2, Pa": "von_mises"}
    nv.record(run, directory, until, checkpoints=10, show=shown)
    return run


if __name__ == "__main__":
    main(*sys.argv[1:2])
