"""A heavy body sinks in a creeping shell under central gravity (plane strain: an annulus).

Run with ``python demos/shell/shell.py [output directory]``; needs the extra ``plots``.
"""

import sys

from ngsolve import Integrate, exp, sqrt, x, y

import ngvisco as nv
from ngvisco.geometries import annulus


def simulation(maxh: float = 0.15, dt: float = 0.05, **options) -> nv.Simulation:
    """The annulus 1 m < r < 2 m with slip; density 1 + 0.5 exp(-|x - (0, 1.6)|^2/0.25^2) kg/m^3.

    The Maxwell time is 0.005 s.
    """
    model = nv.Model(
        material=nv.ReferentialNeoHookean(K_e=50.0, G_e=10.0),
        viscosity=nv.StokesViscosity(K_v=0.1, G_v=0.01),
        hyperviscosity=nv.HyperViscosity(mu=1e-5, p=4),
        creep=nv.Creep(G_m=0.2),
        loads=[nv.CentralGravity(strength=2.0)],
    )
    initial = nv.Initial(density=1 + 0.5 * exp(-(x * x + (y - 1.6) * (y - 1.6)) / 0.25**2))
    return nv.Simulation(annulus(1, 2, maxh), model, dt=dt, initial=initial, **options)


def depth(run: nv.Simulation) -> float:
    """Mean radius, m, of the matter that is at least 10 % denser than the mean."""
    rho = run.fields["density"]
    mean = Integrate(rho, run.mesh) / Integrate(1, run.mesh)
    r = sqrt(x * x + y * y)
    heavy = 0.5 * (1 + (rho - 1.1 * mean) / sqrt((rho - 1.1 * mean) ** 2 + 1e-6))
    return Integrate(r * heavy, run.mesh) / Integrate(heavy, run.mesh)


def main(directory: str = "results/shell", until: float = 3.0, **options) -> tuple:
    run = simulation(**options)
    before = depth(run)
    shown = {"density, kg/m³": "density", "speed, m/s": "sqrt(velocity_1**2 + velocity_2**2)"}
    nv.record(run, directory, until, every=10, show=shown)
    after = depth(run)
    print(f"mean radius of the heavy part {before:.3f} m -> {after:.3f} m")
    return run, before, after


if __name__ == "__main__":
    main(*sys.argv[1:2])
