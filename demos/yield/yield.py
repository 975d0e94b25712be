"""A sheared body yields where it is weak: a band of plastic strain grows from the soft spot.

Run with ``python demos/yield/yield.py [output directory]``; needs the extra ``plots``.
"""

import sys

from ngsolve import cos, pi, x, y

import ngvisco as nv
from ngvisco.geometries import channel


def simulation(maxh: float = 0.1, dt: float = 0.02, **options) -> nv.Simulation:
    """A body of 1 m x 1 m, periodic in x, under a lid of 0.2 m/s; its yield stress is least, 0.6 Pa, in the
    middle."""
    sigma_Y = 0.8 + 0.1 * (cos(2 * pi * x) + cos(2 * pi * y))
    model = nv.Model(
        material=nv.ReferentialNeoHookean(K_e=50.0, G_e=5.0),
        viscosity=nv.StokesViscosity(K_v=0.1, G_v=0.1),
        creep=nv.Perzyna(sigma_Y=sigma_Y, G_m=0.02, H=0.2),
    )
    options["walls"] = {"top": nv.PrescribedTangential((0.2, 0.0)), "bottom": nv.NoSlip()}
    mesh = channel(1, 1, maxh=maxh)
    return nv.Simulation(mesh, model, dt=dt, initial=nv.Initial(velocity=(0.2 * y, 0)), **options)


def main(directory: str = "results/yield", until: float = 1.0, **options) -> nv.Simulation:
    run = simulation(**options)
    shown = {
        "plastic strain": "plastic_strain",
        "creep rate Π₁₂, 1/s": "creep_rate_12",
        "shear stress, Pa": "cauchy_stress_12",
        "v₁, m/s": "velocity_1",
    }
    nv.record(run, directory, until, every=10, show=shown)
    return run


if __name__ == "__main__":
    main(*sys.argv[1:2])
