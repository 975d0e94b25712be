"""A body that sinks and creeps at finite strain: what remains is where its matter came from.

Run with ``python demos/creep_finite/creep_finite.py [output directory]``; needs the extra ``plots``.
"""

import sys
from pathlib import Path

from ngsolve import exp, x, y

import ngvisco as nv
from ngvisco.geometries import box


def simulation(maxh: float = 0.1, dt: float = 0.2, gravity: float = 2.0, **options) -> nv.Simulation:
    """1 m x 1 m; a heavy blob in a lighter body of the same Jeffreys material, Maxwell time 0.1 s."""
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
    out = Path(directory)
    observers = [
        nv.Progress(until),
        nv.LedgerCSV(out / "ledger.csv"),
        nv.VTKSeries(out / "vtk", every=10),
        nv.Checkpoints(out / "run.h5", every=25),
    ]
    run = simulation(observers=observers, **options)
    ledger = run.run(until)
    nv.plot_energies(ledger, out / "energies.png")
    fields = run.fields
    shown = [
        ("density, kg/m³", fields["density"]),
        ("height at the start, m", fields["reference_map"][1]),
        ("creep strain", fields["creep_strain"]),
        ("von Mises stress, Pa", fields["von_mises"]),
    ]
    nv.plot_fields(run.mesh, shown, out / "fields.png")
    print(f"largest |closure| {abs(ledger.column('closure_relative')).max():.1e}; results in {out}")
    return run


if __name__ == "__main__":
    main(*sys.argv[1:2])
