"""A Mooney-Rivlin block set in rotation, beside a neo-Hookean one of the same shear modulus.

Run with ``python demos/mooney_rivlin/mooney_rivlin.py [output directory]``; needs the extra ``plots``.
"""

import sys
from pathlib import Path

from ngsolve import cos, pi, sin, x, y

import ngvisco as nv
from ngvisco.geometries import box


def simulation(
    G_mr: float = 2.5, maxh: float = 0.5, dt: float = 0.02, gravity: float = 0.0, **options
) -> nv.Simulation:
    """1 m x 1 m, at most 1 m/s at the start; G_e + G_mr = 5 Pa whatever G_mr."""
    model = nv.Model(
        material=nv.ReferentialMooneyRivlin(K_e=20.0, G_e=5.0 - G_mr, G_mr=G_mr),
        viscosity=nv.StokesViscosity(K_v=0.02, G_v=0.02),
        hyperviscosity=nv.HyperViscosity(mu=1e-5, p=4),
        loads=[nv.Gravity((0.0, -gravity))] if gravity else [],
    )
    swirl = (sin(pi * x) * cos(pi * y), -cos(pi * x) * sin(pi * y))
    initial = nv.Initial(velocity=swirl)
    return nv.Simulation(box((1, 1), maxh=maxh), model, dt=dt, initial=initial, **options)


def main(directory: str = "results/mooney_rivlin", until: float = 1.0) -> nv.Simulation:
    out = Path(directory)
    shown = []
    for name, G_mr in (("neo-Hookean", 0.0), ("Mooney–Rivlin", 2.5)):
        observers = [nv.Progress(until)]
        if G_mr:
            observers += [
                nv.LedgerCSV(out / "ledger.csv"),
                nv.VTKSeries(out / "vtk", every=5),
                nv.Checkpoints(out / "run.h5", every=25),
            ]
        run = simulation(G_mr, observers=observers)
        ledger = run.run(until)
        print(f"{name}: kinetic energy at most {ledger.column('kinetic').max():.4f} J")
        shown += [(f"{name}: von Mises, Pa", run.fields["von_mises"]), (f"{name}: J", run.fields["J"])]
    nv.plot_energies(ledger, out / "energies.png")
    nv.plot_fields(run.mesh, shown[2:], out / "fields.png")
    print(f"largest |closure| {abs(ledger.column('closure_relative')).max():.1e}; results in {out}")
    return run


if __name__ == "__main__":
    main(*sys.argv[1:2])
