"""Two elastic discs are thrown at each other in a soft light medium, meet and part again.
Run with ``python demos/collision/collision.py [output directory]``; needs the extra ``plots``."""

import sys
from pathlib import Path

import numpy as np
from ngsolve import CF, IfPos, x, y

import ngvisco as nv
from ngvisco.geometries import structured_box
from ngvisco.physics.variables import Jacobian
from ngvisco.run.frames import averaged, outline, read_frame, read_series_files
from ngvisco.run.pictures import figure


def thrown(X: float) -> CF:
    """A solenoidal velocity: nearly 0.2 m/s in a disc about (X, 0.4), none farther than 0.36 m from there."""
    Y, q = y - 0.4, ((x - X) ** 2 + (y - 0.4) ** 2) / 0.36**2
    f, slope = IfPos(1 - q, 1 - q**4, 0.0), 16 / 0.36**2 * IfPos(1 - q, 1 - q**4, 0.0) * q**3
    return 0.2 * CF((f**2 - Y**2 * slope, (x - X) * Y * slope))


def simulation(cells: tuple[int, int] = (14, 8), dt: float = 0.05, **options) -> nv.Simulation:
    """1.4 m x 0.8 m; discs of 1 kg/m^3 with a shear modulus of 1 Pa."""
    damped, thin = (nv.StokesViscosity(K_v=eta, G_v=eta) for eta in (0.002, 0.0002))  # Pa s
    disc = {"material": nv.ReferentialNeoHookean(K_e=2.0, G_e=0.5), "viscosity": damped, "density": 1.0}
    soft = nv.CustomMaterial(transported=(Jacobian(),), stored_energy=lambda J: 0.05 * (J + 1 / J - 2))
    places = {"left": nv.Ball((0.37, 0.4), 0.21), "right": nv.Ball((1.03, 0.4), 0.21)}
    bodies = [nv.Body(name=name, where=where, **disc) for name, where in places.items()]
    bodies.insert(0, nv.Body(name="medium", material=soft, viscosity=thin, density=0.05))
    options |= {"initial": nv.Initial(velocity=thrown(0.37) - thrown(1.03))}
    options |= {"discretisation": nv.Discretisation(m=0)}  # less than nothing of the softer has no pressure
    mesh, model = structured_box((1.4, 0.8), cells), nv.Model(bodies=bodies)
    time = nv.TimeSteps(dt=dt, scheme="midpoint", velocity_scale=5.0)
    return nv.Simulation(mesh, model, time=time, **options)


def main(directory: str = "results/collision", until: float = 2.2, **options) -> nv.Simulation:
    run = simulation(**options, observers=[table := nv.Bodies(Path(directory) / "bodies.csv")])
    nv.record(run, directory, until, every=2)
    draw(Path(directory), table)
    return run


def draw(out: Path, table: nv.Bodies) -> None:
    (fig, axes), files = figure(2, 3, (14, 6.4)), read_series_files(out / "vtk")
    for axis, i in zip(axes.ravel(), np.linspace(0, len(files) - 1, 5).astype(int), strict=False):
        mesh = (*(frame := read_frame(files[i][1])).points.T[:2], frame.cells)
        axis.tripcolor(*mesh, frame.scalar("von_mises"), shading="gouraud", vmin=0, vmax=0.5)
        outline(axis, *mesh, averaged(frame.points, frame.scalar("medium_fraction")))
        axis.set(title=f"von Mises stress, 0 to 0.5 Pa, t = {files[i][0]:.2f} s", aspect="equal")
    axes[1, 2].plot(table.column("time"), table.column("left_momentum_x"), ".-")
    axes[1, 2].set(title="momentum of the left disc, kg m/s", xlabel="t, s")
    fig.savefig(out / "discs.png", dpi=80)


if __name__ == "__main__":
    main(*sys.argv[1:2])
