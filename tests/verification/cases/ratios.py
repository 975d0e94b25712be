"""Two bodies of any ratio of stiffnesses and of densities, unloaded, with k = 1 and m = 0."""

from collections.abc import Iterator
from typing import Any, Literal

import numpy as np
from ngsolve import CF, IfPos, x
from ngsolve.meshes import MakeStructured2DMesh

import ngvisco as nv
from ngvisco.geometries import box
from tests.verification.case import Cases, Measured, Table
from tests.verification.cases.discs import Balance
from tests.verification.setups import SWIRL

CASES = Cases("Bodies and their interfaces")

FAR = 1e4
RATIOS = tuple((a, b) for a in (1 / FAR, 1.0, FAR) for b in (1 / FAR, 1.0, FAR))
"""Ratios of the moduli and of the densities, each of the first body over the second one."""
STEP, STEPS, SHORT, STRETCH = 0.02, 8, (4e-3, 2e-3), 0.05
"""Step, s; number of steps; the midpoint rule's steps, s; stretch of the strip's second half."""
Scheme = Literal["backward-euler", "midpoint"]


def _bodies(where: object, stiffer: float, denser: float) -> tuple[nv.Body, ...]:
    """Two bodies: the second has K_e = 10 Pa, G_e = 1 Pa and 1 kg/m^3; the moduli and the density of the
    first are larger by the ratios."""
    first = nv.ReferentialNeoHookean(K_e=10 * stiffer, G_e=stiffer)
    return (
        nv.Body(name="first", where=where, material=first, density=denser),
        nv.Body(name="second", material=nv.ReferentialNeoHookean(K_e=10.0, G_e=1.0), density=1.0),
    )


def carried(
    stiffer: float, denser: float, scheme: Scheme, k: int = 1, m: int = 0, tau: float = STEP
) -> nv.Simulation:
    """Two bodies in rigid translation through a periodic strip; the first one is stretched."""
    mesh = MakeStructured2DMesh(quads=False, nx=6, ny=1, periodic_x=True, mapping=lambda s, t: (s, t / 6))
    inside = (x - 0.25) * (0.75 - x)
    stretch = 1 + STRETCH * IfPos(inside, 1.0, 0.0)
    F = CF((1, 0, 0, 0, stretch, 0, 0, 0, 1 / stretch), dims=(3, 3))
    start = nv.Initial(velocity=(1.0, 0.0), F=F)
    return _run(mesh, _bodies(inside, stiffer, denser), start, scheme, k, m, tau)


def stirred(
    stiffer: float, denser: float, scheme: Scheme, k: int = 1, m: int = 0, tau: float = STEP
) -> nv.Simulation:
    """A disc in a solid, both with the velocity of an eddy at the start."""
    bodies = _bodies(nv.Ball((0.5, 0.5), 0.25), stiffer, denser)
    return _run(box((1, 1), 0.35), bodies, nv.Initial(velocity=0.5 * CF(SWIRL)), scheme, k, m, tau)


def _run(
    mesh: object, bodies: tuple[nv.Body, ...], start: nv.Initial, scheme: Scheme, k: int, m: int, tau: float
) -> nv.Simulation:
    time = nv.TimeSteps(dt=tau, scheme=scheme, velocity_scale=1.0, halvings=0)
    orders = nv.Discretisation(k=k, m=m)
    return nv.Simulation(mesh, nv.Model(bodies=bodies), time=time, initial=start, discretisation=orders)


PROBLEMS = {"strip": carried, "disc": stirred}


def _least(run: nv.Simulation) -> float:
    """The smallest value in a step of each dissipation and of the scheme's columns, over the energies."""
    ledger = run.ledger
    names = [entry.name for entry in ledger.entries if entry.kind == "dissipation"]
    rates = [ledger.column(name)[1:].min() for name in names]
    scale = (ledger.column("kinetic") + np.abs(ledger.column("stored")))[0]
    taken = [ledger.column(name)[1:].min() for name in ("inertial", "bregman")]
    return float(min(min(rates) * STEP, *taken) / scale)


def table(
    orders: tuple[int, int], schemes: tuple[Scheme, ...], ratios: tuple[tuple[float, float], ...] = RATIOS
) -> Iterator[tuple[Balance | None, list[Any]]]:
    """For each problem, scheme and ratio: the balance, or None if a step has no solution, and a row of the
    table."""
    for problem, make in PROBLEMS.items():
        for scheme in schemes:
            for stiffer, denser in ratios:
                run = make(stiffer, denser, scheme, *orders)
                name = f"{problem}, {scheme}"
                try:
                    found = Balance(name, run, STEPS * STEP)
                except nv.StepError:
                    yield None, [name, stiffer, denser, "no", *[float("nan")] * 6]
                    continue
                column = run.ledger.column
                iterations = float(column("newton_iterations")[1:].mean())
                signs = [
                    found.rise,
                    found.negative,
                    found.limiter,
                    _least(run),
                    column("limited_cells").sum(),
                ]
                yield found, [name, stiffer, denser, "yes", iterations, *map(float, signs)]


HEAD = (
    "run | moduli | densities | solved | iterations | largest rise | bregman < 0 at points | limiter < 0 | "
    "least entry | limited cells"
)


@CASES(f"""bodies-of-any-ratio
    With k = 1 and m = 0 steps of two bodies with any ratio of stiffnesses and of densities have solutions;
      unloaded bodies gain no energy with backward Euler, entry by entry, and with the midpoint rule to third
      order.
    label: FORMULATION.md, Section 9
    setting: K_e = 10 Pa, G_e = 1 Pa and 1 kg/m3, of the first body times {1 / FAR:g}, 1 and {FAR:g}, moduli
      and densities each by itself; a strip of 12 triangles, carried with 1 m/s, the first body stretched by
      {STRETCH:g}; a disc of 0.25 m in a unit box of 0.35 m cells, turned by an eddy of 0.5 m/s; {STEPS}
      steps of {STEP:g} s, midpoint of {SHORT[0]:g} and {SHORT[1]:g} s for its order; over the first kinetic
      energy.
    - steps without a solution, k = 1, m = 0 <= 0.0: none
    - limited cells over all, k = 1, m = 0 <= 0.0: constants in cells do not overshoot
    - largest rise in a step, backward Euler <= 1e-9: never, but for rounding and tolerance
    - bregman's negative parts at points, backward Euler <= 1e-9: phi is jointly convex
    - smallest dissipation of all entries, backward Euler >= -1e-9: each is >= 0 by itself
    - least order of the largest remainder, midpoint >= 2.5: three in theory
    - closure
    """)
def _any_ratio() -> Measured:
    euler, midpoint = (list(table((1, 0), (scheme,))) for scheme in ("backward-euler", "midpoint"))
    solved = [balance for balance, _ in euler if balance is not None]
    rows = [row for _, row in (*euler, *midpoint)]
    yield "steps without a solution, k = 1, m = 0", sum(row[3] == "no" for row in rows)
    yield "limited cells over all, k = 1, m = 0", sum(row[9] for row in rows)
    yield "largest rise in a step, backward Euler", max(balance.rise for balance in solved)
    yield "bregman's negative parts at points, backward Euler", max(balance.negative for balance in solved)
    yield "smallest dissipation of all entries, backward Euler", min(row[8] for _, row in euler)
    found = []
    for make, ratio in ((carried, 1 / FAR), (stirred, 1.0), (stirred, 1 / FAR)):
        both = [Balance("midpoint", make(ratio, ratio, "midpoint", tau=tau), 4 * tau) for tau in SHORT]
        found.append(np.log2(both[0].remainder / both[1].remainder))
    yield "least order of the largest remainder, midpoint", min(found)
    yield Table("k = 1, m = 0", HEAD, rows)
    further = tuple((stiffer, 1.0) for stiffer in (1.0, 0.1))  # the ratio 0.01 would take longest
    second = [row for _, row in table((2, 1), ("backward-euler",), further)]
    yield Table("k = 2, m = 1 beside it", HEAD, second)
