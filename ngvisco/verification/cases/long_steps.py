"""Long steps: the share of them that the split solver solves itself, and what the dearest one costs.

A step that is taken in halves counts as the split solver's own, one that the coupled solver would be asked
for does not, nor do the later ones of its run.  A step's cost is the processor time of all that was tried
for it, halves and failures too.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache, partial
from itertools import product

import numpy as np
from ngsolve import CF, IfPos, Mesh, cos, pi, x, z

from ngvisco.errors import StepError
from ngvisco.forms.start.initial import Initial
from ngvisco.geometries import box, structured_box
from ngvisco.physics.flow_rules import Creep
from ngvisco.physics.materials import NeoHookean
from ngvisco.physics.model import Gravity, Model
from ngvisco.physics.rheology import HyperViscosity, StokesViscosity
from ngvisco.run.scales import scales
from ngvisco.run.simulation import Simulation
from ngvisco.solver.options import NewtonOptions
from ngvisco.verification.case import Bound, Case, Outcome, Table
from ngvisco.verification.cases import in_space, riemann, robustness
from ngvisco.verification.cases.impulsive_starts import STIFF, cavity, released
from ngvisco.verification.setups import KINDS, SWIRL, block

ALONE = NewtonOptions(method="split", retry_seconds=1e-3)
"""The split solver, which has no other one to ask: so short a retry is refused."""

SHARE, DEAREST = 0.99, 3.0
"""Of steps that it solves, at least; cost of a step over the median of its run, at most."""

LARGEST_ELASTIC = 100.0
"""Courant number c dt/h of longitudinal waves up to which a point of the grid counts."""

TAUS = {2: (0.014, 0.14, 0.4, 1.0), 3: (0.03, 0.3, 1.0, 3.0)}
"""s, by dimension: flow Courant numbers to 10, those of waves as near to 100 as the stiffnesses allow."""

GRID_STEPS = 8

SOFT = Creep(G_m=0.2)
"""A Maxwell time of half a step."""


@dataclass(frozen=True)
class LongRun:
    """Steps of one run: ``make`` gives it with the options of its solver."""

    family: str
    name: str
    make: Callable[[NewtonOptions], Simulation]
    steps: int


@dataclass
class Costs:
    """What the steps of a run took.

    Attributes
    ----------
    seconds : list of float
        Processor time of each step that was tried, s.
    own : int
        Steps that the split solver solved.
    halved : int
        Those of them that were taken in parts.
    iterations : list of int
        Of each accepted part of a step.
    courant, elastic : float
        The largest Courant numbers v dt/h, of the accepted parts, and c dt/h of longitudinal waves at the
        start.
    failure : str
        Why the run ended before its last step; empty where it did not.
    """

    seconds: list[float] = field(default_factory=list)
    own: int = 0
    halved: int = 0
    iterations: list[int] = field(default_factory=list)
    limited: int = 0
    courant: float = 0.0
    elastic: float = 0.0
    closure: float = 0.0
    failure: str = ""

    @property
    def dearest(self) -> float:
        """The dearest step over the median."""
        return max(self.seconds) / float(np.median(self.seconds))


def elastic_courant(run: Simulation) -> float:
    """c dt/h of longitudinal waves at the start, of the mean density and the median cell."""
    return scales(run).numbers["Courant of longitudinal waves, c dt/h"]


def measured(run: Simulation, steps: int) -> Costs:
    """Take steps of dt, each of as many parts as it needs."""
    costs = Costs(elastic=elastic_courant(run))
    for number in range(1, steps + 1):
        rows, began = max(len(run.ledger.rows), 1), time.process_time()
        try:
            run.run(number * run.dt)
        except StepError as error:
            costs.failure = f"step {number}: {str(error.__cause__ or error)[-200:]}"
        costs.seconds.append(time.process_time() - began)
        if costs.failure:
            break
        costs.own += 1
        costs.halved += len(run.ledger.rows) > rows + 1
    ledger = run.ledger
    if len(ledger.rows) > 1:
        costs.iterations = [int(n) for n in ledger.column("newton_iterations")[1:]]
        costs.limited = int(ledger.column("limited_cells")[1:].sum())
        costs.courant = float(ledger.column("cfl").max())
        costs.closure = float(np.abs(ledger.column("closure_relative")).max())
    return costs


# --- the runs ---------------------------------------------------------------------------------------------


@cache
def periodic_mesh(dim: int) -> Mesh:
    """The unit box, periodic: 98 triangles, 162 tetrahedra."""
    if dim == 2:
        return box((1, 1), 0.15, periodic="xy")
    return structured_box((1, 1, 1), (3, 3, 3), periodic="xyz")


@cache
def _cell(dim: int) -> float:
    """The median size of its cells, m."""
    return scales(block("linearised", 1.0, mesh=periodic_mesh(dim))).cell


def points(dim: int) -> Iterator[tuple[float, float, float, float]]:
    """Stiffness, K_e/G_e, viscosity and dt of the grid of ``robustness``, up to ``LARGEST_ELASTIC``."""
    viscosities = robustness.VISCOSITIES if dim == 2 else in_space.AXES["viscosity, Pa s"]
    for stiffness, ratio, viscosity, tau in product(
        robustness.STIFFNESS, robustness.RATIOS, viscosities, TAUS[dim]
    ):
        fast = float(np.sqrt(stiffness * (ratio + 4 / 3)))  # the mean density is 1 kg/m^3
        if fast * tau / _cell(dim) <= LARGEST_ELASTIC:
            yield stiffness, ratio, viscosity, tau


def block_of(
    kind: str, dim: int, point: tuple[float, float, float, float], options: NewtonOptions
) -> Simulation:
    """The block of ``robustness`` at a point of its grid, carried by a mean flow."""
    stiffness, ratio, viscosity, tau = point
    drift = robustness.DRIFT if dim == 2 else in_space.DRIFT
    return block(
        kind,
        tau,
        mesh=periodic_mesh(dim),
        of=robustness.material(kind, stiffness, ratio),
        viscosity=viscosity,
        initial=Initial(density=1 + 0.2 * cos(2 * pi * x), velocity=drift),
        newton=options,
    )


def grid(kind: str, dim: int) -> Iterator[LongRun]:
    """A run for each of its points."""
    for point in points(dim):
        name = "G = {:g}, K/G = {:g}, viscosity {:g}, dt = {:g}".format(*point)
        yield LongRun(f"grid {dim}D, {kind}", name, partial(block_of, kind, dim, point), GRID_STEPS)


def recoil(dim: int, scheme: str, dt: float, creep: Creep | None, options: NewtonOptions) -> Simulation:
    """The swirl of demos/swirl and demos/swirl3d, which its elasticity brings to rest and back."""
    model = Model(
        material=NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1, elastic_state="B" if creep else "F"),
        viscosity=StokesViscosity(K_v=0.01, G_v=0.01),
        hyperviscosity=HyperViscosity(mu=1e-5, p=4),
        creep=creep,
        loads=(Gravity((0.0,) * (dim - 1) + (-1.0,)),),
    )
    velocity = CF(SWIRL) if dim == 2 else CF((*((1 + z) / 2 * v for v in SWIRL), 0.0))
    mesh = box((1, 1), 0.12) if dim == 2 else structured_box((1, 1, 1), (4, 4, 4))
    return Simulation(mesh, model, dt=dt, scheme=scheme, initial=Initial(velocity=velocity), newton=options)


def impact(scheme: str, options: NewtonOptions) -> Simulation:
    """The Riemann problem of ``riemann`` on 400 triangles: 0.2 of the sound speed, c dt/h = 2."""
    return riemann.strip(0.2, 100, scheme, courant=2.0, newton=options)


def impact_in_space(options: NewtonOptions) -> Simulation:
    """Halves of a periodic bar of 480 tetrahedra that meet at a fifth of the sound speed."""
    h, speed = 0.05, 0.2 * float(np.sqrt(50 / 3))
    model = Model(
        material=NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1, elastic_state="F"),
        viscosity=StokesViscosity(K_v=speed * h / 3, G_v=speed * h / 2),
    )
    mesh = structured_box((1, 2 * h, 2 * h), (20, 2, 2), periodic="xyz")
    initial = Initial(velocity=CF((IfPos(x - 0.5, -speed, speed), 0.0, 0.0)))
    return Simulation(mesh, model, dt=0.01, initial=initial, newton=options)


def shear_wave(dt: float, options: NewtonOptions) -> Simulation:
    """A standing wave of 10 % strain on 384 periodic tetrahedra."""
    model = Model(
        material=NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1, elastic_state="F"),
        viscosity=StokesViscosity(K_v=0.01, G_v=0.01),
    )
    mesh = structured_box((1, 1, 1), (4, 4, 4), periodic="xyz")
    speed = float(np.sqrt(5.0))
    initial = Initial(velocity=CF((0.0, 0.1 * speed * cos(2 * pi * x), 0.0)))
    return Simulation(mesh, model, dt=dt, scheme="midpoint", initial=initial, newton=options)


def runs() -> Iterator[LongRun]:
    """Cavity, recoil, impact, creep and released loads, in 2D and 3D."""
    for p in (2.0, 4.0):
        yield LongRun("cavity", f"2D, p = {p:g}", partial(cavity, p, 2, None, 0.02), 20)
        yield LongRun("cavity", f"3D, p = {p:g}", partial(cavity, p, 3, None, 0.02), 10)
    yield LongRun("cavity", "2D, p = 4, torn: until 1 s", partial(cavity, 4.0, 2, None, 0.02), 50)
    for dim, steps in ((2, 20), (3, 10)):
        for scheme, dt in (("backward-euler", 0.02), ("midpoint", 0.02), ("midpoint", 0.1)):
            name = f"{dim}D, {scheme}, dt = {dt:g}"
            yield LongRun("recoil", name, partial(recoil, dim, scheme, dt, None), steps)
    for p in (2.0, 4.0):
        yield LongRun("recoil", f"2D, released load, p = {p:g}", partial(released, p, 0.02), 20)
    for scheme in ("backward-euler", "midpoint"):
        yield LongRun("impact", f"2D, {scheme}", partial(impact, scheme), 15)
    yield LongRun("impact", "3D", impact_in_space, 15)
    yield LongRun("shear wave", "3D, dt = 0.01", partial(shear_wave, 0.01), 50)
    yield LongRun("shear wave", "3D, dt = 0.1", partial(shear_wave, 0.1), 20)
    for dim, steps in ((2, 20), (3, 10)):
        yield LongRun("creep", f"{dim}D, cavity, stiff", partial(cavity, 4.0, dim, STIFF, 0.02), steps)
        for dt in (0.02, 0.1):
            name = f"{dim}D, recoil, dt = {dt:g}"
            yield LongRun("creep", name, partial(recoil, dim, "backward-euler", dt, SOFT), steps)


# --- the cases --------------------------------------------------------------------------------------------

COLUMNS = (
    *("run", "steps", "own", "in parts", "iterations: median", "most", "limited cells"),
    *("v dt/h", "c dt/h", "dearest/median", "why it ended"),
)


def outcome(of: Iterator[LongRun]) -> Outcome:
    """Shares and costs over the runs, and a table of each."""
    rows: list[list[str | float]] = []
    tried = own = 0
    dearest = closure = courant = elastic = 0.0
    for one in of:
        costs = measured(one.make(ALONE), one.steps)
        tried, own = tried + one.steps, own + costs.own
        dearest, closure = max(dearest, costs.dearest), max(closure, costs.closure)
        courant, elastic = max(courant, costs.courant), max(elastic, costs.elastic)
        its = costs.iterations or [0]
        rows.append(
            [
                *(f"{one.family}: {one.name}", one.steps, costs.own, costs.halved),
                *(float(np.median(its)), max(its), costs.limited),
                *(costs.courant, costs.elastic, costs.dearest, costs.failure),
            ]
        )
    return Outcome(
        values={
            "share of the steps that the split solver solves": own / tried,
            "dearest step over the median of its run": dearest,
            "largest |closure|": closure,
            "largest v dt/h": courant,
            "largest c dt/h": elastic,
        },
        tables=[Table("steps of each run", COLUMNS, rows)],
        remarks=[
            "A step in parts is one; what failed of it counts too. Costs are of processor time, which other "
            "processes disturb by a tenth."
        ],
    )


def _bounds(courant: float, elastic: float) -> tuple[Bound, ...]:
    """What is asked of all runs, and the Courant numbers that they are to reach."""
    return (
        Bound("share of the steps that the split solver solves", ">=", SHARE, "halves count as its own"),
        Bound("dearest step over the median of its run", "<=", DEAREST, "no step that takes minutes"),
        Bound("largest |closure|", "<=", 1e-10, "the tolerance of Newton's iteration"),
        Bound("largest v dt/h", ">=", courant, "what the runs are to cover"),
        Bound("largest c dt/h", ">=", elastic, "what the runs are to cover"),
    )


def _gridded(kind: str, dim: int) -> Outcome:
    return outcome(grid(kind, dim))


STATEMENT = (
    "The split solver itself solves 99 of 100 steps, halves of steps among them, and none costs more than "
    "three times the median of its run"
)
DEAR = (
    "With priority the dearest step is at 2.8.  Beside other processes cavities with p = 4 have reached 3.1 "
    "to 3.4, by the share that factorisations have in a first step (ngvisco/timestepping/README.md)."
)
LABEL = "Euler-small-viscoelastodyn+disc, Euler-large-viscoelastodyn+disc"

CASES = (
    *(
        Case(
            name=f"long-steps-{kind}-{dim}d",
            theme=robustness.THEME,
            statement=f"{STATEMENT}: {KINDS[kind]} at Courant numbers to 10 of the flow and to 100 of waves.",
            label=LABEL,
            setting=f"The grid of robustness-{kind} on {'98 triangles' if dim == 2 else '162 tetrahedra'}, "
            f"dt = {', '.join(f'{tau:g}' for tau in TAUS[dim])} s, where c dt/h <= {LARGEST_ELASTIC:g}; "
            f"{GRID_STEPS} steps each.",
            bounds=_bounds(9.0, 85.0),
            run=partial(_gridded, kind, dim),
        )
        for kind in KINDS
        for dim in (2, 3)
    ),
    Case(
        name="long-steps-runs",
        theme=robustness.THEME,
        statement=f"{STATEMENT}: cavities, recoils, released loads, impacts, shear waves and creep.",
        label=LABEL,
        setting="10 to 50 steps each on 150 to 480 cells in 2D and 3D: impulsive lids (p = 2 and 4, until "
        "the body is torn, stiff creep), the swirl's recoil by two schemes, a body sheared by 0.3 in one "
        "half and let go, bars that meet at a fifth of the speed of sound, a standing shear wave of 10 % "
        "strain.",
        bounds=_bounds(0.4, 4.0),
        run=lambda: outcome(runs()),
        explanation=DEAR,
    ),
)
