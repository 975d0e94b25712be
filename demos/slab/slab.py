"""A viscoelastic slab bends under gravity in a weak medium, and recovers its shape when gravity ends.
Run with ``python demos/slab/slab.py [output directory]``; needs the extra ``plots``.
"""

import sys
from pathlib import Path

from ngsolve import IfPos

import ngvisco as nv
from ngvisco.geometries import structured_box
from ngvisco.physics.variables import Jacobian
from ngvisco.run.frames import averaged, outline, read_frame, read_series_files
from ngvisco.run.pictures import figure

KYR = 3.15576e10  # s


def simulation(cells: tuple[int, int] = (15, 20), dt: float = KYR, **options) -> nv.Simulation:
    """A box of 7.5 km x 5 km, a slab of 4.5 km x 0.5 km held at the left; g = 10 m/s^2 for 20 kyr."""
    fluid = nv.CustomMaterial(transported=(Jacobian(),), stored_energy=lambda J: 5e10 * (J - 1) * (J - 1) / J)
    slab = nv.Body(
        name="slab",
        where=nv.Block((0.0, 2250.0), (4500.0, 2750.0)),
        material=nv.ReferentialNeoHookean(K_e=1e11, G_e=5e9),  # G_e is half of the shear modulus, 1e10 Pa
        creep=nv.Creep(G_m=2e24),  # G_m is twice the viscosity, 1e24 Pa s
        density=3300.0,
    )
    weak = nv.StokesViscosity(K_v=0.0, G_v=1e18)
    medium = nv.Body(name="medium", material=fluid, viscosity=weak, density=2800.0)
    gravity = nv.Gravity((0.0, -10 * IfPos(20 * KYR - nv.time, 1.0, 0.0)))
    # in SI a cell's matrix, from volume/dt to modulus times volume, seems singular to the coupled solver
    options = {"walls": {"left": nv.NoSlip()}, "solver": "split"} | options
    mesh = structured_box((7500.0, 5000.0), cells)
    return nv.Simulation(mesh, nv.Model(bodies=[slab, medium], loads=[gravity]), dt=dt, **options)


def main(directory: str = "results/slab", until: float = 50 * KYR, **options) -> nv.Simulation:
    table = nv.Bodies(Path(directory) / "bodies.csv")
    nv.record(run := simulation(**options, observers=[table]), directory, until, every=5)
    draw(Path(directory), table)
    return run


def draw(out: Path, table: nv.Bodies) -> None:
    (fig, axes), files = figure(1, 3, (16, 4)), read_series_files(out / "vtk")
    bent = min(range(len(files)), key=lambda i: abs(files[i][0] - 20 * KYR))
    for axis, (time, file) in zip(axes[0], (files[bent], files[-1]), strict=False):
        mesh = (*(frame := read_frame(file)).points.T[:2] / 1e3, frame.cells)
        axis.tripcolor(*mesh, frame.scalar("von_mises"), shading="gouraud")
        outline(axis, *mesh, averaged(frame.points, frame.scalar("medium_fraction")))
        axis.set(title=f"von Mises stress, t = {time / KYR:.0f} kyr; km", aspect="equal")
    axes[0, 2].plot(table.column("time") / KYR, table.column("slab_y"), ".-")
    axes[0, 2].set(title="height of the slab's centroid, m; t, kyr")
    fig.savefig(out / "slab.png", dpi=80)


if __name__ == "__main__":
    main(*sys.argv[1:2])
