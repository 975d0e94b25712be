"""Derivatives of a swirling block's kinetic energy by stiffness and density at each place.
Run with ``python demos/swirl_sensitivity/swirl_sensitivity.py``; needs the extra ``plots``.
"""

import sys
from pathlib import Path

from ngsolve import Integrate, cos, pi, sin, x, y

import ngvisco as nv
from ngvisco.geometries import box


def simulation(maxh: float = 0.15, stiffness=5.0, dt: float = 0.02, **options) -> nv.Simulation:
    """The demo swirl without hyperviscosity: a block of 1 m x 1 m in plane strain."""
    model = nv.Model(
        material=nv.NeoHookean(K_e=10.0, G_e=stiffness, epsilon=0.1),
        viscosity=nv.StokesViscosity(K_v=0.01, G_v=0.01),
        loads=[nv.Gravity((0.0, -1.0))],
    )
    initial = nv.Initial(density=1.0, velocity=(sin(pi * x) * cos(pi * y), -cos(pi * x) * sin(pi * y)))
    options = {"scheme": "midpoint", **options}
    return nv.Simulation(box((1, 1), maxh=maxh), model, dt=dt, initial=initial, **options)


def main(directory: str = "results/swirl_sensitivity", until: float = 0.3, maxh: float = 0.15) -> nv.Gradient:
    run = simulation(maxh, nv.Parameter("stiffness", start=5.0))
    number = f"kinetic at {until}"
    found = nv.gradient(run, until, of=[number], by=["initial.density"], method="adjoint")
    shown = {"stiffness": "J by Pa and m² of stiffness", "density": "J by kg/m³ and m² of density"}
    fields = [(title, found.density(number, name)) for name, title in shown.items()]
    for title, field in fields:
        print(f"{title}: in all {Integrate(field, run.mesh):.6g}")
    Path(directory).mkdir(parents=True, exist_ok=True)
    nv.plot_fields(run.mesh, fields, Path(directory) / "sensitivity.png")
    return found


if __name__ == "__main__":
    main(*sys.argv[1:2])
