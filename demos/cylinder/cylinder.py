"""An Oldroyd-B fluid past a cylinder that blocks half of a channel, with inlet and outlet: the drag.
Run with ``python demos/cylinder/cylinder.py [output directory]``; needs the extra ``plots``.
"""

import sys

import numpy as np
from ngsolve import CF, exp, y

import ngvisco as nv
from ngvisco.geometries import block_with_hole

BETA, WI = 0.59, 0.2
"""Share of the solvent in the viscosity of 1 Pa s; and the relaxation time, s.  As the cylinder's radius over
the mean velocity is 1 s, the relaxation time is the Weissenberg number."""

PUBLISHED = {0.0: 132.36, 0.1: 130.36, 0.2: 126.63, 0.3: 123.19, 0.4: 120.59}
"""The drag, N/m, by the relaxation time (Fan, Tanner, Phan-Thien 1999; Hulsen, Fattal, Kupferman 2005)."""


def simulation(maxh: float = 0.9, dt: float = 0.125, wi: float = WI, **options) -> nv.Simulation:
    """A creeping flow from rest, Re = 0.01."""
    chains, grown, r = 1 - BETA, 1 - exp(-6 * nv.time), y - 2
    model = nv.Model(
        material=nv.OldroydB(K_e=2e4, G_e=chains / (2 * wi)),
        viscosity=nv.StokesViscosity(K_v=0.0, G_v=BETA),
        creep=nv.Creep(G_m=2 * chains, law="conformation"),
    )
    rate = -0.75 * r * grown  # shear rate and shear stress of the flow between plates, which both ends have
    B = CF((1 + 2 * (wi * rate) ** 2, wi * rate, 0, wi * rate, 1, 0, 0, 0, 1), dims=(3, 3))
    profile = 1.5 * (1 - r * r / 4) * grown
    walls = {
        "left": nv.Inflow(velocity=(profile, 0.0), density=0.01, values={"B": B}),
        "right": nv.Open(traction=(2 * chains * wi * rate**2, rate), density=0.01),
        ("bottom", "top", "hole"): nv.NoSlip(),
    }
    initial, mesh = nv.Initial(density=0.01), block_with_hole((14, 4), 1, maxh, refine={"hole": 0.15})
    options["discretisation"] = nv.Discretisation(k=3, m=1)
    return nv.Simulation(mesh, model, dt=dt, initial=initial, walls=walls, solver="coupled", **options)


def main(directory: str = "results/cylinder", until: float = 2.0) -> tuple[nv.Simulation, float]:
    forces = nv.WallForces(["hole"])
    run = simulation(observers=[forces])
    nv.record(run, directory, until, show={"v₁, m/s": "velocity_1"})
    drag = float(np.array(forces.column("hole.force_1"))[-1])
    print(f"drag {drag:.2f} N/m, published {PUBLISHED[WI]}: {drag / PUBLISHED[WI] - 1:+.1%}")
    return run, drag


if __name__ == "__main__":
    main(*sys.argv[1:2])
