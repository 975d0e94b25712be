"""A notched block is sheared until a crack runs from the notch: damage with a gradient.

Run with ``python demos/notch/notch.py [output directory]``; needs the extra ``plots``.
"""

import sys

from ngsolve import IfPos, exp, x, y

import ngvisco as nv
from ngvisco.geometries import channel

SPEED, LENGTH = 0.4, 0.15  # speed of the lid, m/s; width of a crack, m


def simulation(maxh: float = 0.11, dt: float = 0.02, **options) -> nv.Simulation:
    """A block of 1 m x 1 m, periodic in x, below a lid; the notch of 0.4 m is the damage of an initial
    crack."""
    beyond = IfPos(x - 0.7, x - 0.7, IfPos(0.3 - x, 0.3 - x, 0))
    notch = 0.99 * exp(-((beyond**2 + (y - 0.5) ** 2) ** 0.5) / LENGTH)
    rubber = nv.ReferentialNeoHookean(K_e=20.0, G_e=5.0)
    material = nv.Damaged(material=rubber, G_c=0.02, length=LENGTH, viscosity=1e-3, floor=1e-3)
    model = nv.Model(material=material, viscosity=nv.StokesViscosity(K_v=0.02, G_v=0.02))
    initial = nv.Initial(density=0.1, velocity=(SPEED * y, 0), values={"damage": notch})
    options["walls"] = {"top": nv.PrescribedTangential((SPEED, 0)), "bottom": nv.NoSlip()}
    return nv.Simulation(channel(1, 1, maxh=maxh), model, dt=dt, initial=initial, **options)


def main(directory: str = "results/notch", until: float = 0.6, **options) -> nv.Simulation:
    run = simulation(**options)
    shown = {"damage": "damage", "shear stress, Pa": "cauchy_stress_12", "v₁, m/s": "velocity_1"}
    nv.record(run, directory, until, every=3, show=shown)
    return run


if __name__ == "__main__":
    main(*sys.argv[1:2])
