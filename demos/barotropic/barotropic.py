"""A standing acoustic wave in a barotropic fluid; its period against the speed of sound.
Run with ``python demos/barotropic/barotropic.py [output directory]``; needs the extra ``plots``.
"""

import sys
from pathlib import Path

import numpy as np
from ngsolve import pi, sin, x

import ngvisco as nv
from ngvisco.geometries import box
from ngvisco.run.pictures import figure

RHO_R, GAMMA, A = 1.0, 1.4, 1 / 1.4
"""The law is p = A rho^GAMMA, so that the speed of sound at RHO_R is 1 m/s."""


def simulation(
    maxh: float = 0.25, dt: float = 0.02, gravity: float = 0.0, scheme: str = "midpoint", **options
) -> nv.Simulation:
    """A tube of 1 m x 0.2 m; v_x = 0.001 sin(pi x) m/s at the start."""
    fluid = nv.BarotropicFluid.from_state_equation(A, GAMMA, RHO_R)
    loads = [nv.Gravity((-gravity, 0.0))] if gravity else []
    model = nv.Model(material=fluid, viscosity=nv.StokesViscosity(K_v=1e-4, G_v=1e-4), loads=loads)
    initial = nv.Initial(density=RHO_R, velocity=(1e-3 * sin(pi * x), 0.0), values=fluid.start(RHO_R, RHO_R))
    # the velocity scale is the speed of sound, since the flow's velocity vanishes twice a period
    time = nv.TimeSteps(dt=dt, scheme=scheme, velocity_scale=1.0)
    return nv.Simulation(box((1, 0.2), maxh=maxh), model, time=time, initial=initial, **options)


def sound_speed(ledger) -> float:
    """The speed of sound c, m/s; two minima of the kinetic energy are half a period apart, pi/(k c), k =
    pi/m."""
    t, kinetic = ledger.column("time"), ledger.column("kinetic")
    minima = []
    for i in range(1, len(t) - 1):
        if kinetic[i] < min(kinetic[i - 1], kinetic[i + 1]):
            a, b, _ = np.polyfit(t[i - 1 : i + 2] - t[i], kinetic[i - 1 : i + 2], 2)
            minima.append(t[i] - b / (2 * a))
    return 1 / (minima[1] - minima[0])


def main(directory: str = "results/barotropic", until: float = 2.0) -> nv.Simulation:
    run, shown = simulation(), {"v₁, m/s": "velocity_1", "density, kg/m³": "density"}
    ledgers = {"midpoint": nv.record(run, directory, until, every=10, checkpoints=50, show=shown)}
    ledgers["backward-euler"] = simulation(scheme="backward-euler").run(until)
    fig, ((axis,),) = figure(1, 1, (8, 4.3))
    for scheme, ledger in ledgers.items():
        t, kinetic = ledger.column("time"), ledger.column("kinetic")
        axis.plot(t, kinetic / kinetic[0], label=f"{scheme}: c = {sound_speed(ledger):.4f} m/s, exact 1")
    axis.set(xlabel="time, s", title="kinetic energy, relative")
    axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=2)
    fig.savefig(Path(directory) / "schemes.png", dpi=110)
    return run


if __name__ == "__main__":
    main(*sys.argv[1:2])
