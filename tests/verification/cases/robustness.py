"""Robustness over a grid of parameters, and runs that leave their bounds at points."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import cache, partial
from itertools import product

import numpy as np
from ngsolve import Mesh, cos, pi, sin, x, y

import ngvisco as nv
from ngvisco.geometries import box
from ngvisco.run.stepping import Accepted, FixedStepper, Stepped
from tests.verification.case import Cases, Curve, Measured, Plot, Table
from tests.verification.setups import KINDS, LABELS, block, drift, elastic, lid_driven

CASES = Cases("Robustness of the scheme")

# --- a grid of parameters ------------------------------------------------------------------------------

STIFFNESS = (1.0, 1e2, 1e4, 1e6)
RATIOS = (2.0, 1e4)
"""Ratios K_e/G_e: compressible and nearly incompressible."""

VISCOSITIES = (0.0, 0.1, 10.0)
TAUS = (1e-3, 1e-2, 1e-1, 1.0, 10.0)
STEPS = 3


DRIFT = (1 + 0.5 * sin(2 * pi * x) * cos(2 * pi * y), 0.5 - 0.5 * cos(2 * pi * x) * sin(2 * pi * y))
"""An eddy carried by a mean flow. A long step damps the eddy, but the mean flow keeps its Courant number."""


@cache
def drifting_mesh() -> Mesh:
    """The unit box, periodic in both directions."""
    return box((1, 1), 0.4, periodic="xy")


class FirstTry(FixedStepper):
    """Fixed steps that record whether Newton converged from the old state in the first attempt."""

    def __init__(self, dt: float) -> None:
        super().__init__(dt)
        self.directly = self.helped = 0

    def advance(self, run: Stepped, stop: float, rejected: Callable[[nv.Rejection], None]) -> Accepted:
        integrator = run.integrator
        try:
            taken = integrator.advance(run.t, self.dt)
            self.directly += 1
        except nv.StepError:
            taken = integrator.advance(run.t, self.dt)
            self.helped += 1
        return Accepted((run.number + 1) * self.dt, taken)


AXES = {"stiffness, Pa": STIFFNESS, "K_e/G_e": RATIOS, "viscosity, Pa s": VISCOSITIES, "tau, s": TAUS}


def attempt(kind: str, stiffness: float, ratio: float, viscosity: float, tau: float) -> list[float]:
    """Numbers of one configuration: steps tried, steps solved at the first attempt, steps solved, and
    iterations.

    The largest closure and Courant number are kept too.  After a step without a solution, all later steps
    count as unsolved."""
    run = block(
        kind,
        tau,
        mesh=drifting_mesh(),
        of=elastic(kind, ratio * stiffness, stiffness),
        viscosity=viscosity,
        initial=nv.Initial(density=1 + 0.2 * cos(2 * pi * x), velocity=DRIFT),
    )
    run.stepper = stepper = FirstTry(tau)
    for _ in range(STEPS):
        try:
            run.advance()
        except nv.StepError:
            break
    solved, column = stepper.directly + stepper.helped, run.ledger.column
    if not solved:
        return [STEPS, 0, 0, 0, 0, 0]
    efforts = column("newton_iterations").sum(), np.abs(column("closure_relative")).max(), column("cfl").max()
    return [STEPS, stepper.directly, solved, *map(float, efforts)]


def measure(kind: str) -> Measured:
    """The whole grid, summed along each of its axes."""
    points = list(product(*AXES.values()))
    found = np.array([attempt(kind, *point) for point in points])

    def row(of: np.ndarray) -> list[float]:
        tried, directly, solved, iterations = of[:, :4].sum(axis=0)
        return [tried, directly / tried, solved / tried, iterations / solved, *of[:, 4:].max(axis=0)]

    rows = [
        [name, value, *row(found[[point[axis] == value for point in points]])]
        for axis, (name, values) in enumerate(AXES.items())
        for value in values
    ]
    total = row(found)
    yield "share of the steps solved at the first try", total[1]
    yield "share of the steps solved", total[2]
    yield "largest CFL number", total[5]
    head = " | value | steps | first try | solved | its a step | closure | CFL"
    yield Table("shares of the steps, summed over the other parameters", head, [*rows, ["all", "", *total]])
    of_tau = np.array([row[3:5] for row in rows[-len(TAUS) :]], dtype=float).T
    curves = [Curve("first try", TAUS, of_tau[0]), Curve("solved", TAUS, of_tau[1], "s--")]
    yield Plot("Steps solved, over tau", "tau, s", "share", curves, log="x")
    hard = [[*point, *of[1:3]] for point, of in zip(points, found, strict=True) if of[2] < STEPS]
    yield Table("what fails", [*AXES, "steps at first try", "solved"], hard)


for kind in KINDS:
    CASES(f"""robustness-{kind}
        In {KINDS[kind]} steps have solutions over six decades of stiffness and four of tau, with viscosities
          of 0 to 10 Pa s, compressible to nearly incompressible, at CFL numbers up to 20 and beyond.
        label: {LABELS[kind]}
        setting: A periodic box of 1 m x 1 m, density 1 + 0.2 cos(2 pi x), an eddy of 0.5 m/s in a mean flow
          of (1, 0.5) m/s, cells of 0.4 m, three steps of each of
          {len(STIFFNESS) * len(RATIOS) * len(VISCOSITIES) * len(TAUS)} configurations: shear modulus 1 to 1e6
          Pa, K_e/G_e = 2 and 1e4, viscosity 0, 0.1, 10 Pa s, tau = 1e-3 to 10 s.
        - share of the steps solved at the first try >= 0.9: a scheme for daily use
        - share of the steps solved >= 0.98: a scheme for daily use
        - largest |closure| <= 1e-10: wherever a step is solved
        - largest CFL number in [20, 60]: the grid's range; 1.5 m/s for 10 s in cells of 0.4 m
        """)(partial(measure, kind))


# --- a body that is torn -------------------------------------------------------------------------------

DT, END = 0.02, 0.4
SCHEMES = ("backward-euler", "midpoint", "sdirk2")


def cavity(scheme: str, limiter: bool) -> nv.Simulation:
    """The body of demos/cavity at the end of its run, or when the run fails.

    Without a limiter a step has one attempt only."""
    steps = None if limiter else nv.AdaptiveSteps(dt_min=DT, dt_max=DT)
    time = nv.TimeSteps(dt=DT, scheme=scheme, limiter=limiter, adaptive=steps, drift=1.0)  # type: ignore[arg-type]
    of = nv.NeoHookean(K_e=20.0, G_e=0.05, epsilon=0.1, elastic_state="F")
    run = lid_driven(box((1, 1), 0.1), of, time=time)
    with suppress(nv.StepError):
        run.run(END)
    return run


@CASES(f"""limited-cavity
    A body under a lid that starts at full speed up to its corners is torn there: cells with positive means
      are limited, mass is conserved, the energy balance closes, and the run continues.
    label: Zhang and Shu, J. Comput. Phys. 229 (2010); paper: Euler-large-ass-phi
    setting: demos/cavity: a unit box of 230 triangles, the lid at 1 m/s from t = 0 on, other walls without
      slip; neo-Hookean, K_e = 20, G_e = 0.05, epsilon = 0.1 Pa, viscosities 0.01 Pa s, mu = 1e-5, p = 4; 20
      steps of 0.02 s.
    - time reached with a limiter, s in [{END * (1 - 1e-9)}, {END * (1 + 1e-9)}]: the run's end
    - latest time reached without, s in [0.02, 0.3]: the finding: it ends, after the first step
    - closure
    - largest |mass drift| <= 1e-11: rounding, and the transport's tolerance
    - most iterations of a solve <= 30.0: the impulsive start is the hardest step
    """)
def _measured() -> Measured:
    rows, curves = [], []
    for scheme, limiter in product(SCHEMES, (True, False)):
        run = cavity(scheme, limiter)
        column = run.ledger.column
        its, limited = column("newton_iterations")[1:], column("limited_cells")[1:]
        of_solves = its[0], np.median(its), its.max(), its.max() / run.scheme.stages
        rows.append([scheme, "on" if limiter else "off", run.t, *of_solves, limited.sum(), drift(run)])
        if limiter:
            curves.append(Curve(scheme, column("time")[1:], limited, ".-"))
    on, off = rows[::2], rows[1::2]
    yield "time reached with a limiter, s", min(row[2] for row in on)
    yield "latest time reached without, s", max(row[2] for row in off)
    yield "largest |mass drift|", max(row[8] for row in on)
    yield "most iterations of a solve", max(row[6] for row in on)
    head = (
        "scheme | limiter | t, s | iterations: first | median | most | most of a solve | limited | mass drift"
    )
    yield Table("runs with and without", head, rows)
    yield Plot("Cells that were limited", "time, s", "cells", curves)
