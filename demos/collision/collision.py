"""Two elastic discs that are thrown at each other in a soft light medium meet and part again.
Run with ``python demos/collision/collision.py [output directory]``; needs the extra ``plots``.
"""

import sys
from pathlib import Path

import numpy as np
from ngsolve import CF, IfPos, x, y

import ngvisco as nv
from ngvisco.geometries import structured_box
from ngvisco.physics.variables import Jacobian
from ngvisco.run.outlines import averaged, outline
from ngvisco.run.plots import figure
from ngvisco.run.vtu import read_frame, read_series_files


def thrown(X: float, speed: float = 0.2, reach: float = 0.36) -> CF:
    """A solenoidal velocity, m/s: nearly uniform in a disc about (X, 0.4), none farther than its reach."""
    r2 = (x - X) ** 2 + (y - 0.4) ** 2
    left = IfPos(reach**8 - r2**4, 1 - r2**4 / reach**8, 0.0)
    slope = 16 * left * r2**3 / reach**8
    return speed * CF((left**2 - (y - 0.4) ** 2 * slope, (x - X) * (y - 0.4) * slope))


def simulation(cells: tuple[int, int] = (14, 8), dt: float = 0.05, **options) -> nv.Simulation:
    """1.4 m x 0.8 m; discs of 1 kg/m^3 with a shear modulus of 1 Pa."""
    rubber, some = nv.OldroydB(K_e=2.0, G_e=0.5), nv.StokesViscosity(K_v=0.002, G_v=0.002)
    soft = nv.CustomMaterial(transported=(Jacobian(),), stored_energy=lambda J: 0.05 * (J + 1 / J - 2))
    thin = nv.StokesViscosity(K_v=0.0002, G_v=0.0002)
    bodies = [nv.Body(name="medium", material=soft, viscosity=thin, density=0.05)]
    for name, X in (("left", 0.37), ("right", 1.03)):
        disc = nv.Ball((X, 0.4), 0.21)
        bodies.append(nv.Body(name=name, where=disc, material=rubber, viscosity=some, density=1.0))
    options["initial"] = nv.Initial(velocity=thrown(0.37) - thrown(1.03))
    options = {"dt": dt, "scheme": "midpoint", "velocity_scale": 5.0} | options
    return nv.Simulation(structured_box((1.4, 0.8), cells), nv.Model(bodies=bodies), **options)


def main(directory: str = "results/collision", until: float = 2.2, **options) -> nv.Simulation:
    table = nv.Bodies(Path(directory) / "bodies.csv")
    run = simulation(**options, observers=[table])
    nv.record(run, directory, until, every=2)
    draw(Path(directory), table)
    return run


def draw(out: Path, table: nv.Bodies) -> None:
    fig, axes = figure(2, 3, (14, 6.4))
    files = read_series_files(out / "vtk")
    for axis, i in zip(axes.ravel(), np.linspace(0, len(files) - 1, 5).round().astype(int), strict=False):
        frame = read_frame(files[i][1])
        mesh = (*frame.points.T[:2], frame.cells)
        axis.tripcolor(*mesh, frame.scalar("von_mises"), shading="gouraud", vmin=0, vmax=0.5)
        outline(axis, *mesh, averaged(frame.points, frame.scalar("medium_fraction")))
        axis.set(title=f"von Mises stress, 0 to 0.5 Pa, t = {files[i][0]:.2f} s", aspect="equal")
    axes[1, 2].plot(table.column("time"), table.column("left_momentum_x"), ".-")
    axes[1, 2].set(title="momentum of the left disc, kg m/s", xlabel="t, s")
    fig.savefig(out / "discs.png", dpi=80)


if __name__ == "__main__":
    main(*sys.argv[1:2])
