"""A soft disc in a lid-driven cavity (Sugiyama et al. 2011): a neo-Hookean body carried round by a fluid.
Run with ``python demos/soft_disc/soft_disc.py [output directory]``; needs the extra ``plots``.
"""

import sys
from pathlib import Path

from ngsolve import IfPos, sqrt, x

import ngvisco as nv
from ngvisco.geometries import box
from ngvisco.physics.variables import Jacobian
from ngvisco.run.fields import outlined
from ngvisco.run.plots import figure

RAMP = 0.1
"""Time in which the lid reaches its speed, s."""
SHOWN = (1.16, 2.36, 3.52, 4.68, 5.88, 7.04)
"""Times of the pictures, s: those of Sugiyama et al., to a step."""


def simulation(
    maxh: float = 0.1, dt: float = 0.04, K_e: float = 50.0, m: int = 1, **options
) -> nv.Simulation:
    """1 m x 1 m, the disc of radius 0.2 m at (0.6, 0.5) m; density 1 kg/m^3, viscosity 0.01 Pa s in both.

    ``K_e`` is the bulk modulus of both (Pa): nothing holds div v = 0, volumes change by the pressure over it.
    """
    viscosity = nv.StokesViscosity(K_v=0.01, G_v=0.01)
    fluid = nv.CustomMaterial(transported=(Jacobian(),), stored_energy=lambda J: K_e / 2 * (J + 1 / J - 2))
    solid = nv.IsochoricNeoHookean(K_e=K_e, G_e=0.05)  # shear modulus 0.1 Pa
    bodies = [
        nv.Body(name="fluid", material=fluid, viscosity=viscosity, density=1.0),
        nv.Body(
            name="disc",
            where=nv.Ball((0.6, 0.5), 0.2),
            material=solid,
            viscosity=viscosity,
            density=1.0,
        ),
    ]
    model = nv.Model(bodies=bodies)
    ramp = IfPos(nv.time - RAMP, 1.0, nv.time / RAMP)
    lid = nv.PrescribedTangential(((1 - (2 * x - 1) ** 8) * ramp, 0.0))
    walls = {"top": lid, ("left", "right", "bottom"): nv.NoSlip()}
    space = nv.Discretisation(m=m)
    return nv.Simulation(box((1, 1), maxh=maxh), model, dt=dt, walls=walls, discretisation=space, **options)


def main(directory: str = "results/soft_disc", until: float = 8.0, **options) -> nv.Simulation:
    out = Path(directory)
    table = nv.Bodies(out / "bodies.csv")
    run = simulation(**options, observers=[table])
    picture = Pictures(out, [time for time in SHOWN if time <= until])
    run.observers.append(picture)
    nv.record(run, out, until, every=5, show={"speed, m/s": "sqrt(velocity_1**2 + velocity_2**2)"})
    draw_path(table, out / "path.png")
    return run


class Pictures:
    """The speed and the disc's outline at some times, side by side in one picture."""

    def __init__(self, directory: Path, times: list[float]) -> None:
        self.directory, self.times = directory, times

    def start(self, simulation: nv.Simulation) -> None:
        """Nothing is drawn of the start."""

    def step(self, simulation: nv.Simulation, row: dict[str, float]) -> None:
        for time in self.times:
            if abs(row["time"] - time) < simulation.dt / 2:
                fields = simulation.fields
                v, lines = fields["velocity"], [fields[name] for name in outlined(fields)]
                shown = [(f"speed, m/s, t = {row['time']:.2f} s", sqrt(v * v))]
                nv.plot_fields(simulation.mesh, shown, self.directory / f"t{time:.2f}.png", outlines=lines)

    def finish(self, simulation: nv.Simulation) -> None:
        """Nothing is left to draw."""


def draw_path(table: nv.Bodies, path: Path) -> None:
    """The centroid's path, and what the disc's mass and volume are over time."""
    fig, ((left, right),) = figure(1, 2, (11, 4.6))
    t, X, Y = (table.column(name) for name in ("time", "disc_x", "disc_y"))
    left.plot(X, Y)
    left.plot(X[:1], Y[:1], "o", label="start")
    left.set(
        title="centroid of the disc", xlabel="x, m", ylabel="y, m", aspect="equal", xlim=(0, 1), ylim=(0, 1)
    )
    left.legend()
    for name, label in (("disc_mass", "mass"), ("disc_volume", "volume")):
        right.plot(t, table.column(name) / table.column(name)[0] - 1, label=label)
    right.set(title="disc: change since the start, relative", xlabel="time, s")
    right.legend()
    fig.savefig(path, dpi=110)


if __name__ == "__main__":
    main(*sys.argv[1:2])
