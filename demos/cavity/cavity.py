"""A neo-Hookean body in a cavity under a lid that starts at full speed up to the corners, and a smooth lid.
Run with ``python demos/cavity/cavity.py [output directory]``; needs the extra ``plots``.
"""

import sys
from pathlib import Path

from ngsolve import sqrt, x

import ngvisco as nv
from ngvisco.geometries import box
from ngvisco.run.pictures import figure

LIDS = {"full": (1.0, 0.0), "smooth": (16 * x**2 * (1 - x) ** 2, 0.0)}
"""Velocities of the lid, m/s."""


def simulation(lid: str = "full", maxh: float = 0.1, dt: float = 0.02, **options) -> nv.Simulation:
    """A cavity of 1 m x 1 m; the lid moves from the start on, the other walls hold the body."""
    model = nv.Model(
        material=nv.NeoHookean(K_e=20.0, G_e=0.05, epsilon=0.1, elastic_state="F"),
        viscosity=nv.StokesViscosity(K_v=0.01, G_v=0.01),
        hyperviscosity=nv.HyperViscosity(mu=1e-5, p=4),
    )
    walls = {"top": nv.PrescribedTangential(LIDS[lid]), ("left", "right", "bottom"): nv.NoSlip()}
    # at the corners, where the body is torn, det F drifts from J, which would end a run
    return nv.Simulation(box((1, 1), maxh=maxh), model, dt=dt, drift=1.0, walls=walls, **options)


def main(directory: str = "results/cavity", until: float = 0.4, maxh: float = 0.1) -> nv.Simulation:
    out = Path(directory)
    files = [nv.LedgerCSV(out / "ledger.csv"), nv.VTKSeries(out / "vtk", every=5)]
    runs = {"full": simulation(maxh=maxh, observers=[nv.Progress(until), *files])}
    runs["smooth"] = simulation("smooth", maxh)
    for run in runs.values():
        run.run(until)
    fig, ((left, middle, right),) = figure(1, 3, (13, 4.3))
    for name, run in runs.items():
        v, rho = (run.fields[field] for field in ("velocity", "density"))
        shown = [("speed, m/s", sqrt(v * v)), ("density, kg/m³", rho)]
        nv.plot_fields(run.mesh, shown, out / f"{name}.png")
        ledger, color = run.ledger, {"full": "C3", "smooth": "C0"}[name]
        t = ledger.column("time")
        left.semilogy(t, ledger.column("J_min"), color, label=f"{name} lid: J")
        left.semilogy(t, ledger.column("rho_min"), color + "--", label=f"{name} lid: density")
        middle.plot(t, ledger.column("limited_cells"), color + ".-", label=f"{name} lid")
        right.plot(t, ledger.column("newton_iterations"), color + ".-", label=f"{name} lid")
    titles = ("least J and density at points", "cells that were limited", "solver iterations a step")
    for axis, title in zip((left, middle, right), titles, strict=True):
        axis.set(xlabel="time, s", title=title)
        axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=2)
    fig.savefig(out / "limiter.png", dpi=110)
    return runs["full"]


if __name__ == "__main__":
    main(*sys.argv[1:2])
