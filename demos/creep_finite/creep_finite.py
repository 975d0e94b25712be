"""A heavy spot sinks in a body that creeps at finite strain; passive fields keep where matter came from.

Run with ``python demos/creep_finite/creep_finite.py [output directory]``; needs the extra ``plots``.
"""

import sys

from ngsolve import exp, x, y

import ngvisco as nv
from ngvisco.geometries import box


def simulation(maxh: float = 0.1, dt: float = 0.2, gravity: float = 2.0, **options) -> nv.Simulation:
    """A body of 1 m x 1 m with a heavy blob, all of one Jeffreys material with the Maxwell time 0.1 s."""
    model = nv.Model(
        material=nv.ReferentialNeoHookean(K_e=40.0, G_e=5.0),
        viscosity=nv.StokesViscosity(K_v=0.5, G_v=0.5),
        hyperviscosity=nv.HyperViscosity(mu=1e-5, p=4),
        creep=nv.Creep(G_m=2.0, nu=1e-3),
        loads=[nv.Gravity((0.0, -gravity))] if gravity else [],
    )
    density = 1 + 1.5 * exp(-25 * ((x - 0.4) ** 2 + (y - 0.65) ** 2))
    initial = nv.Initial(density=density)
    passive = ("F_tot", "reference_map", "creep_strain")
    mesh = box((1, 1), maxh=maxh)
    return nv.Simulation(mesh, model, dt=dt, initial=initial, passive=passive, **options)


def main(directory: str = "results/creep_finite", until: float = 20.0, **options) -> nv.Simulation:
    run = simulation(**options)
    shown = {
        "density, kg/m³": "density",
        "height at the start, m": "reference_map_2",
        "creep strain": "creep_strain",
        "speed, m/s": "sqrt(velocity_1**2 + velocity_2**2)",
    }
    nv.record(run, directory, until, every=10, show=shown)
    return run


if __name__ == "__main__":
    main(*sys.argv[1:2])
