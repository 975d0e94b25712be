"""Error over seconds by order, cells, step and scheme: ``python -m tests.benchmarks.answers [PROBLEM ...]``.

The kinetic energy at the end of a run against that of a finer one, with steps of half the length by the
midpoint rule and velocities of degree 3.  Seconds are the processor's, of one thread, set-up left out; only
their ratios within one call travel.  Of each problem's runs those are marked that no cheaper one beats.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from itertools import product

from ngsolve import CF, SetNumThreads, cos, pi, sin, x, y

import ngvisco as nv
from ngvisco.geometries import structured_box

SCHEMES = ("backward-euler", "midpoint")
ORDERS = ((2, 1), (3, 2))
CELLS = (3, 6)
STEPS = (5, 20)
REFERENCE = ((3, 2), 9, 40, "midpoint")
UNTIL = 0.2
"""s."""

SOLID = nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1)
VISCOSITY = nv.StokesViscosity(K_v=0.01, G_v=0.01)


def swirl(cells: int, **options: object) -> nv.Simulation:
    """The swirl of ``case`` in a box with walls."""
    hyper = nv.HyperViscosity(mu=1e-5, p=4)
    model = nv.Model(material=SOLID, viscosity=VISCOSITY, hyperviscosity=hyper)
    velocity = (sin(pi * x) * cos(pi * y), -cos(pi * x) * sin(pi * y))
    mesh = structured_box((1, 1), (cells, cells))
    return nv.Simulation(mesh, model, initial=nv.Initial(velocity=velocity), **options)  # type: ignore[arg-type]


def shear_wave(cells: int, **options: object) -> nv.Simulation:
    """A standing wave of 10 % strain in a periodic cell."""
    model = nv.Model(material=SOLID, viscosity=VISCOSITY)
    initial = nv.Initial(velocity=CF((0.0, 0.1 * 5**0.5 * cos(2 * pi * x))))
    mesh = structured_box((1, 1), (cells, cells), periodic="xy")
    return nv.Simulation(mesh, model, initial=initial, **options)  # type: ignore[arg-type]


PROBLEMS: dict[str, Callable[..., nv.Simulation]] = {"swirl": swirl, "shear wave": shear_wave}


def measured(name: str, order: tuple[int, int], cells: int, steps: int, scheme: str) -> tuple[float, float]:
    """The kinetic energy at the end, J, and seconds."""
    k, m = order
    discretisation = nv.Discretisation(k=k, m=m)
    run = PROBLEMS[name](cells, dt=UNTIL / steps, scheme=scheme, discretisation=discretisation)
    began = time.process_time()
    ledger = run.run(UNTIL)
    return float(ledger.column("kinetic")[-1]), time.process_time() - began


def main(names: list[str]) -> None:
    """Print a table of each problem, the cheapest run first."""
    SetNumThreads(1)
    for name in names or list(PROBLEMS):
        exact, seconds = measured(name, *REFERENCE)
        rows = []
        for choice in product(ORDERS, CELLS, STEPS, SCHEMES):
            kinetic, took = measured(name, *choice)
            rows.append((took, abs(kinetic / exact - 1), choice))
        print(f"\n| {name} | k, m | cells | dt, s | error | time, s | best |\n|" + "---|" * 7)
        least = float("inf")
        for took, error, ((k, m), cells, steps, scheme) in sorted(rows):
            best, least = "*" if error < least else "", min(error, least)
            values = f"{k}, {m} | {2 * cells**2} | {UNTIL / steps:g} | {error:.2%} | {took:.1f} | {best}"
            print(f"| {scheme} | {values} |", flush=True)
        print(f"\nReference: {exact:.6g} J, {seconds:.0f} s.", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
