"""A swirling block in an insulated box comes to rest: all of its kinetic energy becomes heat.
Run with ``python demos/heat/heat.py [output directory]``; needs the extra ``plots``.
"""

import sys
from pathlib import Path

from ngsolve import cos, pi, sin, x, y

import ngvisco as nv
from ngvisco.geometries import box


def simulation(maxh: float = 0.2, dt: float = 0.02, **options) -> nv.Simulation:
    """A block of 1 m x 1 m that swirls at 1 m/s; with c = 0.01 J/(m^3 K) it warms by 25 K."""
    gel = nv.IsochoricNeoHookean(K_e=20.0, G_e=1.0)
    model = nv.Model(
        material=nv.Thermal(material=gel, c=0.01, theta_R=300.0, expansion=1e-4),
        viscosity=nv.StokesViscosity(K_v=0.02, G_v=0.02),
        hyperviscosity=nv.HyperViscosity(mu=1e-5),
        creep=nv.Creep(G_m=0.5),
        heat=nv.Heat(conductivity=1e-4, numerical_heating=True),
    )
    start = nv.Initial(density=1.0, velocity=(sin(pi * x) * cos(pi * y), -cos(pi * x) * sin(pi * y)))
    return nv.Simulation(box((1, 1), maxh=maxh), model, dt=dt, initial=start, **options)


def main(directory: str = "results/heat", until: float = 1.0, **options) -> nv.Simulation:
    run = simulation(**options)
    nv.record(
        run, directory, until, show={"temperature, K": "temperature", "von Mises stress, Pa": "von_mises"}
    )
    draw(run.ledger, Path(directory) / "balances.png")
    return run


def draw(ledger, path: Path) -> None:
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    t, kinetic, stored = (ledger.column(name) for name in ("time", "kinetic", "stored"))
    for label, values in (("kinetic", kinetic), ("internal", stored), ("sum", kinetic + stored)):
        left.plot(t, values, label=label)
    made = (name for name in ledger.columns if name.startswith("entropy_production_"))
    for name in made:
        right.semilogy(t[1:], ledger.column(name)[1:], label=name.removeprefix("entropy_production_"))
    left.set(xlabel="t, s", ylabel="energy, J")
    right.set(xlabel="t, s", ylabel="production of entropy, W/K")
    for axes in (left, right):
        axes.legend()
    figure.savefig(path, dpi=100)


if __name__ == "__main__":
    main(*sys.argv[1:2])
