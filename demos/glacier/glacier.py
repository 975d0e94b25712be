"""A layer of power-law fluid flows down a slope, as ice does: Norton's rule with n = 3 beside n = 1.

Run with ``python demos/glacier/glacier.py [output directory]``; needs the extra ``plots``.
"""

import sys
from pathlib import Path

import numpy as np
from ngsolve import y

import ngvisco as nv
from ngvisco.geometries import channel
from ngvisco.run.pictures import figure

SLOPE = (1.0, -3.0)  # gravity along the bed and into the bed, m/s^2


def exact(n: float, height: np.ndarray) -> np.ndarray:
    """The velocity v, m/s, with the shear stress 1 - y, Pa, and the shear rate 4 (1 - y)^n, 1/s."""
    return 4 / (n + 1) * (1 - (1 - height) ** (n + 1))


def simulation(n: float = 3.0, maxh: float = 0.15, dt: float = 0.2, **options) -> nv.Simulation:
    """A layer, 1 m deep, periodic along the slope, without slip on its bed and without traction above."""
    model = nv.Model(
        material=nv.ReferentialNeoHookean(K_e=300.0, G_e=25.0),
        creep=nv.Norton(A=2.0 ** (1.5 - n / 2), n=n),  # shear rate 4 tau^n at the stress tau
        loads=[nv.Gravity(SLOPE)],
    )
    options |= {"walls": {"bottom": nv.NoSlip()}, "initial": nv.Initial(velocity=(y, 0))}
    return nv.Simulation(channel(0.5, 1, maxh=maxh), model, dt=dt, **options)


def main(directory: str = "results/glacier", until: float = 12.0, **options) -> nv.Simulation:
    (fig, ((axes,),)), height = figure(1, 1, (6, 5)), np.linspace(0, 1, 41)
    for n, color in ((1.0, "C0"), (3.0, "C3")):
        run = simulation(n, **options)
        shown = {
            "v₁, m/s": "velocity_1",
            "shear stress, Pa": "cauchy_stress_12",
            "creep rate Π₁₂, 1/s": "creep_rate_12",
        }
        nv.record(run, str(Path(directory) / f"n{n:g}"), until, every=20, show=shown)
        v = run.fields["velocity"](run.mesh(0.2 + 0 * height, height))[:, 0]
        axes.plot(exact(n, height), height, color, v, height, color + "o", ms=3)
        axes.annotate(f"n = {n:g}", (exact(n, height)[20], 0.45), color=color)
    axes.set(xlabel="v₁, m/s: closed form (lines), ngvisco (dots)", ylabel="height above the bed, m")
    fig.savefig(Path(directory) / "profiles.png", dpi=110)
    return run


if __name__ == "__main__":
    main(*sys.argv[1:2])
