"""A soft disc in a lid-driven cavity (Sugiyama et al. 2011): a fluid carries a body round.
Run with ``python demos/soft_disc/soft_disc.py [output directory]``; needs the extra ``plots``.
"""

import sys
from pathlib import Path

import numpy as np

import ngvisco as nv
from ngvisco.geometries import structured_box
from ngvisco.physics.variables import Jacobian
from ngvisco.run.frames import averaged, outline, read_frame, read_series_files
from ngvisco.run.pictures import figure


def simulation(cells=(10, 11), dt: float = 0.05, K_e: float = 50.0, **options) -> nv.Simulation:
    """A box of 1 m x 1 m, 1 kg/m^3, 0.01 Pa s, with a disc of shear modulus 0.1 Pa and a lid of 1 m/s."""
    fluid = nv.CustomMaterial(
        transported=(Jacobian(),), stored_energy=lambda J: K_e / 2 * (J - 1) * (J - 1) / J
    )
    solid = nv.IsochoricNeoHookean(K_e=K_e, G_e=0.05, elastic_state="B")
    both = {"viscosity": nv.StokesViscosity(K_v=0.01, G_v=0.01), "density": 1.0}
    disc = nv.Body(name="disc", where=nv.Ball((0.6, 0.5), 0.2), material=solid, **both)
    model = nv.Model(bodies=[nv.Body(name="fluid", material=fluid, **both), disc])
    options["walls"] = {"top": nv.PrescribedTangential((1.0, 0.0)), ("left", "right", "bottom"): nv.NoSlip()}
    # velocities of order 3 do not lock with a stiff volume; two Euler steps damp the lid's start
    options = {"time": nv.TimeSteps(dt=dt, scheme="midpoint", startup=2), **options}
    options = {"discretisation": nv.Discretisation(k=3)} | options
    # flat rows at the lid, where the fluid becomes a film; small cells at its ends, where the velocity jumps
    mesh = structured_box((1, 1), cells, grading={"y": 0.3}, split_corners=True, refine_corners={"top": 2})
    return nv.Simulation(mesh, model, **options)


def main(directory: str = "results/soft_disc", until: float = 8.0, **options) -> nv.Simulation:
    out = Path(directory)
    table = nv.Bodies(out / "bodies.csv")
    run = simulation(**options, observers=[table])
    nv.record(run, out, until, show={"speed, m/s": "sqrt(velocity_1**2 + velocity_2**2)"})
    draw(out, table.column("disc_x"), table.column("disc_y"))
    return run


def draw(out: Path, X: np.ndarray, Y: np.ndarray) -> None:
    """Draw the disc and the speed at seven times, and the path of the disc's centroid."""
    fig, axes = figure(2, 4, (15, 7.6))
    files = read_series_files(out / "vtk")
    chosen = np.linspace(0, len(files) - 1, 7).round().astype(int)
    for axis, (time, file) in zip(axes.ravel(), (files[i] for i in chosen), strict=False):
        frame = read_frame(file)
        mesh = (*frame.points.T[:2], frame.cells)
        axis.tripcolor(*mesh, frame.scalar("velocity"), shading="gouraud", vmin=0, vmax=1)
        outline(axis, *mesh, averaged(frame.points, frame.scalar("fluid_fraction")))
        axis.set(title=f"speed, t = {time:.2f} s", aspect="equal", xticks=[], yticks=[])
    axes[1, 3].plot(X, Y, ".-", markersize=3)
    axes[1, 3].set(title="centroid of the disc, m", aspect="equal", xlim=(0, 1), ylim=(0, 1))
    fig.savefig(out / "disc.png", dpi=80)


if __name__ == "__main__":
    main(*sys.argv[1:2])
