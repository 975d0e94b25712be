"""A sheared layer of a Jeffreys material relaxes: creep dissipates the energy of elastic strain.

The linearised model; the initial shear strain varies in space, so that the layer also moves.
Run with ``python demos/creep/creep.py [output directory]``; needs the extra ``plots``.
"""

import sys

from ngsolve import CF, cos, pi, x, y

import ngvisco as nv
from ngvisco.geometries import box


def simulation(maxh: float = 0.15, dt: float = 0.05, gravity: float = 0.0, **options) -> nv.Simulation:
    """A layer of 2 m x 1 m with the Maxwell time G_m/(2 G_e) = 0.5 s."""
    model = nv.Model(
        material=nv.LinearElastic(K_e=10.0, G_e=5.0),
        viscosity=nv.StokesViscosity(K_v=0.02, G_v=0.02),
        hyperviscosity=nv.HyperViscosity(mu=1e-5, p=4),
        creep=nv.Creep(G_m=5.0),
        loads=[nv.Gravity((0.0, -gravity))] if gravity else [],
    )
    shear = 0.1 * (1 + 0.5 * cos(pi * x) * cos(pi * y))
    E_0 = CF((0, shear, 0, shear, 0, 0, 0, 0, 0), dims=(3, 3))
    initial = nv.Initial(density=1.0, values={"E": E_0})
    return nv.Simulation(box((2, 1), maxh=maxh), model, dt=dt, initial=initial, **options)


def main(directory: str = "results/creep", until: float = 2.5) -> nv.Simulation:
    run = simulation()
    nv.record(run, directory, until, show={"shear strain E₁₂": "E_12", "von Mises stress, Pa": "von_mises"})
    return run


if __name__ == "__main__":
    main(*sys.argv[1:2])
