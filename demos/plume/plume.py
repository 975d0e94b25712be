"""A plume: gas, heated above the floor of a closed box, expands, rises and spreads below the lid.
Run with ``python demos/plume/plume.py [output directory]``; needs the extra ``plots``.
"""

import sys
from pathlib import Path

import numpy as np
from ngsolve import exp, x, y

import ngvisco as nv
from ngvisco.geometries import box
from ngvisco.run.frames import read_frame, read_series_files
from ngvisco.run.ledger import Ledger
from ngvisco.run.pictures import figure


def simulation(maxh: float = 0.08, dt: float = 0.05, **options) -> nv.Simulation:
    """A box of 1 m x 1.5 m with gas: gamma = 1.4, 96 Pa at 300 K, 10 m/s^2; a source of 6 W, 0.1 m wide."""
    model = nv.Model(
        material=nv.Thermal(c=0.8, gruneisen=0.4, theta_R=300.0, rho_R=1.0),
        viscosity=nv.StokesViscosity(K_v=0.005, G_v=0.005),
        heat=nv.Heat(conductivity=0.008, source=200 * exp(-100 * ((x - 0.5) ** 2 + (y - 0.25) ** 2))),
        loads=[nv.Gravity((0.0, -10.0))],
    )
    walls = {"bottom": nv.NoSlip(), "top": nv.NoSlip()}
    start = nv.Initial(density=exp(-y / 9.6))  # an atmosphere at rest at 300 K
    options = {"walls": walls, "initial": start, "solver": "split", "scheme": "midpoint"} | options
    return nv.Simulation(box((1, 1.5), maxh=maxh), model, dt=dt, **options)


def main(directory: str = "results/plume", until: float = 3.0, **options) -> nv.Simulation:
    run = simulation(**options)
    nv.record(run, directory, until, show={"temperature, K": "temperature"})
    draw(Path(directory), run.ledger)
    return run


def draw(out: Path, ledger: Ledger) -> None:
    """Draw the temperature at four times, and the energies of motion and height over time."""
    (fig, axes), files = figure(1, 5, (17, 4.8)), read_series_files(out / "vtk")
    *frames, last = axes.ravel()
    for axis, i in zip(frames, np.linspace(0, len(files) - 1, 5).astype(int)[1:], strict=True):
        mesh = (*(frame := read_frame(files[i][1])).points.T[:2], frame.cells)
        theta = {"shading": "gouraud", "vmin": 300, "vmax": 360, "cmap": "inferno"}
        axis.tripcolor(*mesh, frame.scalar("temperature"), **theta)
        axis.set(title=f"300 to 360 K, t = {files[i][0]:.2f} s", aspect="equal", xticks=[], yticks=[])
    dt, kinetic, stored = (ledger.column(name) for name in ("dt", "kinetic", "stored"))
    heat, weight = (np.cumsum(dt * ledger.column(f"power_{of}")) for of in ("heat_source", "gravity"))
    rest = heat - stored + stored[0]
    for label, value in {"heat less internal": rest, "kinetic": kinetic, "height": -weight}.items():
        last.plot(ledger.column("time"), value, label=label)
    last.legend(title="energies, J")
    fig.savefig(out / "plume.png", dpi=80)


if __name__ == "__main__":
    main(*sys.argv[1:2])
