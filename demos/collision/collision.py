"""Two elastic discs are thrown at each other in a soft light medium, meet and part again.
Run with ``python demos/collision/collision.py [output directory]``; needs the extra ``plots``."""

import sys
from itertools import product
from pathlib import Path

import numpy as np
from ngsolve import CF, IfPos, x, y

import ngvisco as nv
from ngvisco.geometries import structured_box
from ngvisco.physics.variables import Jacobian
from ngvisco.run.frames import averaged, outline, read_frame, read_series_files
from ngvisco.run.pictures import figure

EMPTY_SPACE = 0.918
"""Share of its momentum that a disc thrown at a wall in empty space keeps, by a Lagrangian method."""


def thrown(X: float) -> CF:
    """A solenoidal velocity: nearly 0.2 m/s in a disc about (X, 0), and zero from a distance of 0.36 m on."""
    q = ((x - X) ** 2 + y**2) / 0.36**2
    f, slope = IfPos(1 - q, 1 - q**4, 0.0), 16 / 0.36**2 * IfPos(1 - q, 1 - q**4, 0.0) * q**3
    return 0.2 * CF((f**2 - y**2 * slope, (x - X) * y * slope))


def simulation(cells: tuple[int, int] = (14, 8), dt: float = 0.05, **options) -> nv.Simulation:
    """The quarter 0.7 m x 0.4 m of two discs of 1 kg/m^3 and 1 Pa of shear, with planes of symmetry."""
    damped, thin = (nv.StokesViscosity(K_v=eta, G_v=eta) for eta in (0.002, 4e-6))  # Pa s
    fluid = nv.CustomMaterial(transported=(Jacobian(),), stored_energy=lambda J: (J - 1) * (J - 1) / J)
    solid = nv.ReferentialNeoHookean(K_e=2.0, G_e=0.5)
    bodies = (
        nv.Body(name="medium", material=fluid, viscosity=thin, density=0.001),
        nv.Body(name="disc", where=nv.Ball((0.37, 0.0), 0.21), material=solid, viscosity=damped, density=1.0),
    )
    options |= {"initial": nv.Initial(velocity=thrown(0.37) - thrown(1.03))}
    mesh, model = structured_box((0.7, 0.4), cells), nv.Model(bodies=bodies)
    time = nv.TimeSteps(dt=dt, scheme="midpoint", velocity_scale=5.0)
    return nv.Simulation(mesh, model, time=time, **options)


def main(directory: str = "results/collision", until: float = 2.2, **options) -> nv.Simulation:
    run = simulation(**options, observers=[table := nv.Bodies(Path(directory) / "bodies.csv")])
    nv.record(run, directory, until, every=2)
    draw(Path(directory), table)
    return run


def draw(out: Path, table: nv.Bodies) -> None:
    """Draw both discs, by mirror images of the computed quarter, and the momentum of the quarter."""
    (fig, axes), files = figure(2, 3, (14, 6.4)), read_series_files(out / "vtk")
    for axis, i in zip(axes.ravel(), np.linspace(0, len(files) - 1, 5).astype(int), strict=False):
        frame = read_frame(files[i][1])
        places, stress = frame.points.T[:2], frame.scalar("von_mises")
        smooth = averaged(frame.points, frame.scalar("medium_fraction"))
        for left, up in product((True, False), repeat=2):
            mesh = (places[0] if left else 1.4 - places[0], places[1] if up else -places[1], frame.cells)
            axis.tripcolor(*mesh, stress, shading="gouraud", vmin=0, vmax=0.5)
            outline(axis, *mesh, smooth)
        axis.set(title=f"von Mises stress, 0 to 0.5 Pa, t = {files[i][0]:.2f} s", aspect="equal")
    momentum = table.column("disc_momentum_x")
    axes[1, 2].plot(table.column("time"), momentum / momentum[0], ".-")
    axes[1, 2].axhline(-EMPTY_SPACE, color="0.6")
    axes[1, 2].set(title="momentum of the left disc, over the first", xlabel="t, s")
    fig.savefig(out / "discs.png", dpi=80)


if __name__ == "__main__":
    main(*sys.argv[1:2])
