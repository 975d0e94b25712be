"""Long steps: ``python -m tests.benchmarks.long_steps [NAME ...]`` in the project's root.

A row for each run: its steps, those taken in parts, iterations, limited cells, the Courant numbers v dt/h and
c dt/h that it reaches, the dearest step over the median, of processor time, and why it ended.  NAMEs are
beginnings of families: "grid 2D, linearised", "grid 3D, finite", cavity, recoil, impact, "shear wave", creep.
"""

import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache, partial
from itertools import product

import numpy as np
from ngsolve import CF, IfPos, Mesh, cos, pi, sin, x, y, z

from ngvisco.errors import StepError
from ngvisco.forms.start.initial import Initial
from ngvisco.geometries import box, structured_box
from ngvisco.physics.flow_rules import Creep
from ngvisco.physics.materials import NeoHookean
from ngvisco.physics.model import Gravity, Model
from ngvisco.physics.rheology import HyperViscosity, StokesViscosity
from ngvisco.physics.walls import NoSlip, PrescribedTangential
from ngvisco.run.scales import scales
from ngvisco.run.simulation import Simulation
from ngvisco.solver.options import NewtonOptions
from tests.verification.cases import riemann, robustness
from tests.verification.setups import KINDS, SWIRL, block

SPLIT = NewtonOptions(method="split")

STIFF = Creep(G_m=1e-4)
"""A Maxwell time far below a step."""

LARGEST_ELASTIC = 100.0
"""Courant number c dt/h of longitudinal waves up to which a point of the grid counts."""

TAUS = {2: (0.014, 0.14, 0.4, 1.0), 3: (0.03, 0.3, 1.0, 3.0)}
"""s, by dimension: flow Courant numbers to 10, those of waves as near to 100 as the stiffnesses allow."""

GRID_STEPS = 8

DRIFT_IN_SPACE = (
    1 + 0.5 * sin(2 * pi * x) * cos(2 * pi * y) * cos(2 * pi * z),
    0.5 - 0.5 * cos(2 * pi * x) * sin(2 * pi * y) * cos(2 * pi * z),
    CF(0.25),
)

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
    solved, halved : int
        Steps that were solved, and those of them that were taken in parts.
    iterations : list of int
        Of each accepted part of a step.
    courant, elastic : float
        The largest Courant numbers v dt/h, of the accepted parts, and c dt/h of longitudinal waves at the
        start.
    failure : str
        Why the run ended before its last step; empty where it did not.
    """

    seconds: list[float] = field(default_factory=list)
    solved: int = 0
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
        costs.solved += 1
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
    viscosities = robustness.VISCOSITIES if dim == 2 else (0.1,)
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
    drift = robustness.DRIFT if dim == 2 else DRIFT_IN_SPACE
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


def cavity(p: float, dim: int, creep: Creep | None, dt: float, options: NewtonOptions) -> Simulation:
    """The body of demos/cavity under a lid of full speed; in 3D the lid of a cube of 384 tetrahedra."""
    model = Model(
        material=NeoHookean(K_e=20.0, G_e=0.05, epsilon=0.1, elastic_state="B" if creep else "F"),
        viscosity=StokesViscosity(K_v=0.01, G_v=0.01),
        hyperviscosity=HyperViscosity(mu=1e-5, p=p),
        creep=creep,
    )
    mesh = box((1, 1), 0.1) if dim == 2 else structured_box((1, 1, 1), (4, 4, 4))
    others = tuple(sorted(set(mesh.GetBoundaries()) - {"top"}))
    walls = {"top": PrescribedTangential((1.0, *(0.0,) * (dim - 1))), others: NoSlip()}
    return Simulation(mesh, model, dt=dt, walls=walls, newton=options)


def _solid(p: float) -> Model:
    return Model(
        material=NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1, elastic_state="F"),
        viscosity=StokesViscosity(K_v=0.01, G_v=0.01),
        hyperviscosity=HyperViscosity(mu=1e-5, p=p),
    )


def released(p: float, dt: float, options: NewtonOptions) -> Simulation:
    """A body of which one half is sheared at first, without anything that would hold it so."""
    shear = IfPos(x - 0.5, 0.3, 0.0)
    F = CF((1, shear, 0, 0, 1, 0, 0, 0, 1), dims=(3, 3))
    return Simulation(box((1, 1), 0.1), _solid(p), dt=dt, initial=Initial(values={"F": F}), newton=options)


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


# --- the table ------------------------------------------------------------------------------------------

COLUMNS = (
    *("run", "steps", "in parts", "iterations: median", "most", "limited cells"),
    *("v dt/h", "c dt/h", "dearest/median", "closure", "why it ended"),
)


def all_runs() -> Iterator[LongRun]:
    """The grids by kind and dimension, and the others."""
    for kind, dim in product(KINDS, (2, 3)):
        yield from grid(kind, dim)
    yield from runs()


def main(names: list[str]) -> None:
    """Print the table, a row as soon as it is known."""
    print("| " + " | ".join(COLUMNS) + " |", "|" + "---|" * len(COLUMNS), sep="\n")
    for one in all_runs():
        if names and not one.family.startswith(tuple(names)):
            continue
        costs = measured(one.make(SPLIT), one.steps)
        its = costs.iterations or [0]
        cells = [f"{one.family}: {one.name}", f"{costs.solved} of {one.steps}", costs.halved]
        cells += [f"{np.median(its):g}", max(its), costs.limited, f"{costs.courant:.2g}"]
        cells += [f"{costs.elastic:.2g}", f"{costs.dearest:.1f}", f"{costs.closure:.0e}", costs.failure]
        print("| " + " | ".join(map(str, cells)) + " |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
