"""An elastic beam on ground of springs and dashpots is pressed down in its middle.
Run with ``python demos/foundation/foundation.py [output directory]``; needs the extra ``plots``.
"""

import sys
from pathlib import Path

import numpy as np
from ngsolve import exp, x

import ngvisco as nv
from ngvisco.geometries import box
from ngvisco.run.pictures import figure

LENGTH, HEIGHT, K_E, G_E = 4.0, 0.4, 100.0, 50.0  # m, Pa
SPRING, DASHPOT = 0.3, 0.4  # Pa/m, Pa s/m
PRESSED, WIDTH = 6e-3, 0.3  # Pa, m


def theory(at: np.ndarray, modes: int = 40) -> np.ndarray:
    """The solution of E' I w'''' + k w = -p with Timoshenko's shear, between sliding walls, by cosines."""
    lame, s, q = K_E - 2 * G_E / 3, (np.arange(4000) + 0.5) * LENGTH / 4000, np.arange(modes) * np.pi / LENGTH
    flexure = 4 * G_E * (lame + G_E) / (lame + 2 * G_E) * HEIGHT**3 / 12
    bending = flexure * q**4 / (1 + flexure * q**2 / (5 / 6 * G_E * HEIGHT))
    load = PRESSED * np.exp(-(((s - LENGTH / 2) / WIDTH) ** 2))
    shares = np.mean(load * np.cos(np.outer(q, s)), axis=1) * np.where(q > 0, 2, 1)
    return -shares / (SPRING + bending) @ np.cos(np.outer(q, at))


def simulation(maxh: float = 0.2, dt: float = 0.25, **options) -> nv.Simulation:
    """A beam that starts at rest, pressed from t = 0 on."""
    pressure = PRESSED * exp(-(((x - LENGTH / 2) / WIDTH) ** 2))
    walls = {
        "bottom": nv.Open(stiffness=(SPRING, 0.0), impedance=(DASHPOT, 0.0), density=1.0),
        "top": nv.Open(pressure=pressure, density=1.0),
    }
    model = nv.Model(material=nv.LinearElastic(K_e=K_E, G_e=G_E))
    return nv.Simulation(box((LENGTH, HEIGHT), maxh), model, dt=dt, walls=walls, **options)


def main(directory: str = "results/foundation", until: float = 30.0) -> nv.Simulation:
    run, at, (fig, ((along, over),)) = simulation(), np.linspace(0, LENGTH, 41), figure(1, 2, (11, 4))
    where = run.mesh(at, 0 * at)
    middle = [w := run.fields["displacement_bottom"](where)[:, 1]]
    while run.t < until - run.dt / 2:
        run.run(run.t + run.dt)
        middle.append(w := run.fields["displacement_bottom"](where)[:, 1])
    along.plot(at, 1e3 * theory(at), "k", lw=6, alpha=0.2)
    along.plot(at, 1e3 * w, "C0")
    along.set(xlabel="x, m", ylabel="w, mm", title="the grey line is beam theory's, at rest")
    over.plot(run.ledger.column("time"), [1e3 * w[20] for w in middle])
    over.set(xlabel="time, s", ylabel="w in the middle, mm")
    Path(directory).mkdir(parents=True, exist_ok=True)
    fig.savefig(Path(directory) / "foundation.png", dpi=110)
    print(f"middle {1e3 * w[20]:.3f} mm, ends {1e3 * w[0]:.3f} mm; by theory {1e3 * theory(at)[[20, 0]]}")
    return run


if __name__ == "__main__":
    main(*sys.argv[1:2])
