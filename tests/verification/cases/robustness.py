"""Robustness over a grid of parameters, and runs that leave their bounds at points."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, partial
from itertools import product

import numpy as np
from ngsolve import Mesh, cos, pi, sin, x, y

import ngvisco as nv
from ngvisco.geometries import box
from ngvisco.run.stepping import Accepted, FixedStepper
from tests.verification.case import Cases, Curve, Measured, Plot, Table
from tests.verification.setups import KINDS, LABELS, block, closure, drift, elastic, lid_driven

CASES = Cases("Robustness of the scheme")

# --- a grid of parameters ------------------------------------------------------------------------------

STIFFNESS = (1.0, 1e2, 1e4, 1e6)
RATIOS = (2.0, 1e4)
"""K_e/G_e: compressible, nearly incompressible."""

VISCOSITIES = (0.0, 0.1, 10.0)
TAUS = (1e-3, 1e-2, 1e-1, 1.0, 10.0)
STEPS = 3


DRIFT = (1 + 0.5 * sin(2 * pi * x) * cos(2 * pi * y), 0.5 - 0.5 * cos(2 * pi * x) * sin(2 * pi * y))
"""An eddy that the mean flow carries: what is left of it when a long step has damped it still has its
Courant number."""


@cache
def drifting_mesh() -> Mesh:
    """The unit box, periodic in both directions."""
    return box((1, 1), 0.4, periodic="xy")


LATER = "After a step that is not solved the later ones of its run count as not solved."
ROUNDING = (
    "At 1e6 Pa and tau = 10 s rounding of the stress, 1e-10 Pa, moves the mean flow by up to 7e-9 m/s: there "
    "Newton ends, above its tolerance, by what rounding changes in its increment (solver/newton.py)."
)


class FirstTry(FixedStepper):
    """Fixed steps that note whether Newton converged from the old state without any help."""

    def __init__(self, dt: float) -> None:
        super().__init__(dt)
        self.directly = self.helped = 0

    def advance(self, simulation: nv.Simulation, stop: float) -> Accepted:
        integrator = simulation.integrator
        try:
            taken = integrator.advance(simulation.t, self.dt)
            self.directly += 1
        except nv.StepError:
            taken = integrator.advance(simulation.t, self.dt)
            self.helped += 1
        return Accepted((simulation.number + 1) * self.dt, taken)


@dataclass
class Tally:
    """What the steps of some configurations did."""

    tried: int = 0
    directly: int = 0
    helped: int = 0
    iterations: int = 0
    closure: float = 0.0
    cfl: float = 0.0

    def add(self, other: Tally) -> None:
        """Add another tally to this one."""
        for name in ("tried", "directly", "helped", "iterations"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        self.closure, self.cfl = max(self.closure, other.closure), max(self.cfl, other.cfl)

    @property
    def row(self) -> list[float]:
        """Steps, shares at first try and in the end, mean iterations, closure, CFL number."""
        solved = self.directly + self.helped
        shares = [self.directly / self.tried, solved / self.tried]
        return [self.tried, *shares, self.iterations / max(solved, 1), self.closure, self.cfl]


def attempt(kind: str, stiffness: float, ratio: float, viscosity: float, tau: float) -> tuple[Tally, str]:
    """Three steps of one configuration, and how it failed, if it did."""
    tally = Tally(tried=STEPS)
    run = block(
        kind,
        tau,
        mesh=drifting_mesh(),
        of=elastic(kind, ratio * stiffness, stiffness),
        viscosity=viscosity,
        initial=nv.Initial(density=1 + 0.2 * cos(2 * pi * x), velocity=DRIFT),
    )
    run.stepper = stepper = FirstTry(tau)
    failure = ""
    for _ in range(STEPS):
        try:
            run.advance()
        except nv.StepError as error:
            failure = f"step {run.number + 1}: {str(error).split(': ', 1)[-1][:100]}"
            break
    ledger = run.ledger
    tally.directly, tally.helped = stepper.directly, stepper.helped
    if len(ledger.rows) > 1:
        tally.iterations = int(ledger.column("newton_iterations").sum())
        tally.closure = float(np.abs(ledger.column("closure_relative")).max())
        tally.cfl = float(ledger.column("cfl").max())
    return tally, failure


AXES = {"stiffness, Pa": STIFFNESS, "K_e/G_e": RATIOS, "viscosity, Pa s": VISCOSITIES, "tau, s": TAUS}


def measure(kind: str) -> Measured:
    """The whole grid, summed along each of its axes."""
    sums = {(name, value): Tally() for name, values in AXES.items() for value in values}
    total = Tally()
    failures: list[list[str | float]] = []
    for point in product(*AXES.values()):
        stiffness, ratio, viscosity, tau = point
        tally, failure = attempt(kind, stiffness, ratio, viscosity, tau)
        total.add(tally)
        for name, value in zip(AXES, point, strict=True):
            sums[name, value].add(tally)
        if failure:
            failures.append([*point, tally.directly + tally.helped, failure])
    rows: list[list[str | float]] = [[name, value, *tally.row] for (name, value), tally in sums.items()]
    rows.append(["all", "", *total.row])
    columns = ["", "value", "steps", "first try", "solved", "its a step", "closure", "CFL"]
    curves = [
        Curve("at first try", TAUS, [sums["tau, s", tau].row[1] for tau in TAUS]),
        Curve("solved", TAUS, [sums["tau, s", tau].row[2] for tau in TAUS], "s--"),
    ]
    tables = [Table("shares of the steps, summed over the other parameters", columns, rows)]
    if failures:
        tables.append(Table("what fails", [*AXES, "steps solved", "why"], failures))
    yield "share of the steps solved at the first try", total.row[1]
    yield "share of the steps solved", total.row[2]
    yield "largest CFL number", total.cfl
    yield from tables
    yield Plot("Steps solved, over tau", "tau, s", "share", curves, log="x")
    yield from [LATER] + ([ROUNDING] if kind == "finite" else [])


for kind in KINDS:
    CASES(f"""robustness-{kind}
        In {KINDS[kind]} steps are solved over six decades of stiffness, four of tau, viscosity 0 to 10 Pa s,
          compressible to nearly incompressible, at CFL numbers up to 20 and beyond.
        label: {LABELS[kind]}
        setting: A periodic box of 1 m x 1 m, density 1 + 0.2 cos(2 pi x), an eddy of 0.5 m/s in a mean flow
          of (1, 0.5) m/s, cells of 0.4 m, three steps of each of
          {len(STIFFNESS) * len(RATIOS) * len(VISCOSITIES) * len(TAUS)} configurations: shear modulus 1 to 1e6
          Pa, K_e/G_e = 2 and 1e4, viscosity 0, 0.1, 10 Pa s, tau = 1e-3 to 10 s.
        - share of the steps solved at the first try >= 0.9: a scheme for daily use
        - share of the steps solved >= 0.98: a scheme for daily use
        - largest |closure| <= 1e-10: wherever a step is solved
        - largest CFL number >= 20.0: what the grid is to cover
        """)(partial(measure, kind))


# --- a body that is torn -------------------------------------------------------------------------------

DT, END = 0.02, 0.4
SCHEMES = ("backward-euler", "midpoint", "sdirk2")


def cavity(scheme: str, limiter: bool) -> nv.Simulation:
    """The body of demos/cavity; without a limiter steps are not tried in other ways."""
    steps = None if limiter else nv.AdaptiveSteps(dt_min=DT, dt_max=DT)
    time = nv.TimeSteps(dt=DT, scheme=scheme, limiter=limiter, adaptive=steps)  # type: ignore[arg-type]
    of = nv.NeoHookean(K_e=20.0, G_e=0.05, epsilon=0.1, elastic_state="F")
    return lid_driven(box((1, 1), 0.1), of, time=time)


@CASES(f"""limited-cavity
    A body under a lid that starts at full speed, up to its corners, is torn there: cells whose means are
      positive are limited, mass and the energy's balance kept, and the run goes on.
    label: Zhang and Shu, J. Comput. Phys. 229 (2010); paper: Euler-large-ass-phi
    setting: demos/cavity: a unit box of 230 triangles, the lid at 1 m/s from t = 0 on, other walls without
      slip; neo-Hookean, K_e = 20, G_e = 0.05, epsilon = 0.1 Pa, viscosities 0.01 Pa s, mu = 1e-5, p = 4; 20
      steps of 0.02 s.
    - time reached with a limiter, s >= {END * (1 - 1e-09)}: the run's end
    - latest time reached without, s <= 0.3: the finding: it ends
    - closure
    - largest |mass drift| <= 1e-11: rounding, and the transport's tolerance
    - most iterations of a solve <= 30.0: an impulsive start and none harder after it
    """)
def _measured() -> Measured:
    rows: list[list[str | float]] = []
    curves, worst = [], dict.fromkeys(("closure", "mass", "iterations"), 0.0)
    reached, ended = END, 0.0
    for scheme in SCHEMES:
        for limiter in (True, False):
            run = cavity(scheme, limiter)
            try:
                run.run(END)
            except nv.StepError:
                ended = max(ended, run.t)
            ledger = run.ledger
            column = {name: ledger.column(name)[1:] for name in ("newton_iterations", "limited_cells")}
            off, mass = closure(run), drift(run)
            its = column["newton_iterations"]
            solved = run.t, its[0], np.median(its), its.max()
            limited = column["limited_cells"].sum(), ledger.column("limiter").sum()
            rows.append([scheme, "on" if limiter else "off", *solved, *limited, off, mass])
            if limiter:
                reached = min(reached, run.t)
                stages = run.scheme.stages
                worst["closure"], worst["mass"] = max(worst["closure"], off), max(worst["mass"], mass)
                worst["iterations"] = max(worst["iterations"], float(its.max()) / stages)
                curves.append(Curve(scheme, ledger.column("time")[1:], column["limited_cells"], ".-"))
    yield "time reached with a limiter, s", reached
    yield "latest time reached without, s", ended
    yield "largest |closure|", worst["closure"]
    yield "largest |mass drift|", worst["mass"]
    yield "most iterations of a solve", worst["iterations"]
    yield Table(
        "runs with and without",
        "scheme | limiter | t reached, s | iterations: first step | median | most | limited cells | "
        "limiter, J | |closure| | |mass drift|",
        rows,
    )
    yield Plot("Cells that were limited", "time, s", "cells", curves)
    yield (
        "Limited cells are counted once for each step. Without a limiter a run ends with the first "
        "solution that is not positive at a point."
    )
