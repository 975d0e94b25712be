"""A neo-Hookean block set in rotation inside its box, under gravity: it recoils elastically.
Run with ``python demos/swirl/swirl.py [output directory]``; needs the extra ``plots``.
"""

import sys
from pathlib import Path

from ngsolve import cos, pi, sin, x, y

import ngvisco as nv
from ngvisco.geometries import box


def simulation(maxh: float = 0.1, dt: float = 0.02, gravity: float = 1.0, **options) -> nv.Simulation:
    """The demo's run: 1 m x 1 m, plane strain."""
    model = nv.Model(
        material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1),
        viscosity=nv.StokesViscosity(K_v=0.01, G_v=0.01),
        hyperviscosity=nv.HyperViscosity(mu=1e-5, p=4),
        loads=[nv.Gravity((0.0, -gravity))] if gravity else [],
    )
    initial = nv.Initial(density=1.0, velocity=(sin(pi * x) * cos(pi * y), -cos(pi * x) * sin(pi * y)))
    options = {"scheme": "midpoint", **options}
    return nv.Simulation(box((1, 1), maxh=maxh), model, dt=dt, initial=initial, **options)


def main(directory: str = "results/swirl", until: float = 1.0) -> nv.Simulation:
    out = Path(directory)
    files = [nv.LedgerCSV(out / "ledger.csv"), nv.VTKSeries(out / "vtk", every=5)]
    run = simulation(observers=[nv.Progress(until), *files, nv.Checkpoints(out / "run.h5", every=25)])
    ledger, fields = run.run(until), run.fields
    nv.plot_energies(ledger, out / "energies.png")
    shown = [("J", fields["J"]), ("von Mises stress, Pa", fields["von_mises"])]
    nv.plot_fields(run.mesh, [*shown, ("density, kg/m³", fields["density"])], out / "fields.png")
    euler = simulation(scheme="backward-euler").run(until)
    nv.plot_schemes({"midpoint": ledger, "backward Euler": euler}, out / "schemes.png")
    print(f"largest |closure| {abs(ledger.column('closure_relative')).max():.1e}; results in {out}")
    return run


if __name__ == "__main__":
    main(*sys.argv[1:2])
