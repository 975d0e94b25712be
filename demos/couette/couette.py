"""A Maxwell fluid between two cylinders, the outer one rotating: shear stress against the closed form.
Run with ``python demos/couette/couette.py [output directory]``; needs the extra ``plots``.
"""

import sys
from pathlib import Path

import numpy as np
from ngsolve import x, y

import ngvisco as nv
from ngvisco.geometries import annulus
from ngvisco.run.pictures import figure

R_I, R_O, OMEGA, G, ETA = 1.0, 2.0, 0.2, 10.0, 1.0  # m, m, 1/s, Pa, Pa s


def shear_stress(r: np.ndarray) -> np.ndarray:
    """The stress tau_rt = 2 eta A R_i^2/r^2 of v_t = A (r - R_i^2/r), A = Omega R_o^2/(R_o^2 - R_i^2)."""
    return 2 * ETA * OMEGA * R_O**2 / (R_O**2 - R_I**2) * R_I**2 / r**2


def simulation(maxh: float = 0.35, dt: float = 0.1, **options) -> nv.Simulation:
    """A fluid at rest until the outer wall turns with Omega; the Maxwell time is eta/G = 0.1 s."""
    model = nv.Model(
        material=nv.LinearElastic(K_e=20.0, G_e=G),
        viscosity=nv.StokesViscosity(K_v=0.01, G_v=0.01),
        creep=nv.Creep(G_m=2 * ETA),
    )
    options["walls"] = {"outer": nv.PrescribedTangential((-OMEGA * y, OMEGA * x)), "inner": nv.NoSlip()}
    options["discretisation"] = nv.Discretisation(k=3, m=2)
    return nv.Simulation(annulus(R_I, R_O, maxh), model, dt=dt, initial=nv.Initial(density=0.1), **options)


def profile(run: nv.Simulation, r: np.ndarray) -> np.ndarray:
    """Means of tau_rt, from the elastic stress, over circles of the radii r."""
    angles = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    result, c, s = [], np.cos(angles), np.sin(angles)
    for radius in r:
        T = run.fields["cauchy_stress"](run.mesh(radius * c, radius * s)).reshape(-1, 3, 3)
        result.append(np.mean(c * s * (T[:, 1, 1] - T[:, 0, 0]) + (c**2 - s**2) * T[:, 0, 1]))
    return np.array(result)


def main(directory: str = "results/couette", until: float = 2.0) -> tuple[nv.Simulation, float]:
    run = simulation()
    nv.record(run, directory, until, show={"v₂, m/s": "velocity_2"})
    r = np.linspace(1.05, 1.95, 10)
    error = float(np.abs(profile(run, r) / shear_stress(r) - 1).max())
    print(f"largest error of the shear stress {error:.1e}")
    fig, ((axis,),) = figure(1, 1, (7, 4))
    axis.plot(r, shear_stress(r), "k-", r, profile(run, r), "o")
    axis.set(xlabel="r, m", ylabel="stress, Pa", title="τ_rθ: closed form (line) and ngvisco (dots)")
    fig.savefig(Path(directory) / "stress.png", dpi=110)
    return run, error


if __name__ == "__main__":
    main(*sys.argv[1:2])
