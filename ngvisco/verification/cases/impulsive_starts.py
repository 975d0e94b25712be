"""Impulsive starts: what the first step takes from rest, or from data that jump.

All that is tried for the step counts: each of its parts, and the attempts that failed before.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial

from ngsolve import CF, IfPos, Mesh, x, y

from ngvisco.errors import StepError
from ngvisco.forms.boundary.walls import Conditions
from ngvisco.forms.start.initial import Initial
from ngvisco.geometries import box, structured_box
from ngvisco.physics.flow_rules import Creep
from ngvisco.physics.materials import NeoHookean
from ngvisco.physics.model import Model
from ngvisco.physics.rheology import HyperViscosity, StokesViscosity
from ngvisco.physics.walls import NoSlip, PrescribedTangential
from ngvisco.run.simulation import Simulation
from ngvisco.run.stepping import Rejection
from ngvisco.solver.options import NewtonOptions
from ngvisco.solver.solution import iterations
from ngvisco.verification.case import Bound, Case, Outcome, Table
from ngvisco.verification.cases import robustness

DT = 0.02
"""s: the lid's Courant number is 0.2, 0.4 and 0.8 on the three meshes of triangles, 0.16 on the cube."""

STIFF = Creep(G_m=1e-4)
"""A Maxwell time far below a step."""

MOST = 30
"""Iterations of a first step, all its parts and what failed of them together."""


@dataclass(frozen=True)
class Start:
    """A run of which the first step counts; ``of_lid`` says that its lid sets a body at rest in motion."""

    name: str
    make: Callable[[], Simulation]
    of_lid: bool = True


class Tried:
    """Adds up the iterations of steps that were rejected."""

    def __init__(self) -> None:
        self.iterations = 0

    def start(self, simulation: Simulation) -> None:
        """Nothing is tried before a step."""

    def step(self, simulation: Simulation, row: dict[str, float]) -> None:
        """The ledger has the iterations of accepted parts."""

    def finish(self, simulation: Simulation) -> None:
        """Nothing is left to add."""

    def rejected(self, simulation: Simulation, rejection: Rejection) -> None:
        """All attempts at it."""
        self.iterations += len(iterations(rejection.history))


@dataclass(frozen=True)
class FirstStep:
    """What it took: ``iterations`` of its accepted parts, ``rejected`` those of what failed before."""

    iterations: int
    rejected: int
    parts: int
    retries: int
    limited: int
    closure: float
    seconds: float
    failure: str = ""


def first_step(run: Simulation) -> FirstStep:
    """Take the step, in as many parts as it needs."""
    tried, failure, began = Tried(), "", time.process_time()
    run.observers.append(tried)
    rejected = 0
    try:
        run.run(run.dt)
    except StepError as error:
        rejected, failure = len(iterations(error.history)), str(error.__cause__ or error)[-200:]
    rows = run.ledger.rows[1:]
    return FirstStep(
        iterations=int(sum(row["newton_iterations"] for row in rows)),
        rejected=rejected + tried.iterations,
        parts=len(rows),
        retries=run.solver.retried,
        limited=int(sum(row["limited_cells"] for row in rows)),
        closure=max((float(abs(row["closure_relative"])) for row in rows), default=0.0),
        seconds=time.process_time() - began,
        failure=failure,
    )


# --- the starts -------------------------------------------------------------------------------------------


@cache
def square(maxh: float) -> Mesh:
    """The unit box: 230, 942 and 3,720 triangles at 0.1, 0.05 and 0.025 m."""
    return box((1, 1), maxh)


def cube() -> Mesh:
    """The unit cube of 3,072 tetrahedra."""
    return structured_box((1, 1, 1), (8, 8, 8))


def cavity(
    p: float, dim: int, creep: Creep | None, dt: float, options: NewtonOptions, mesh: Mesh | None = None
) -> Simulation:
    """The body of demos/cavity under a lid of full speed; in 3D the lid of a cube of 384 tetrahedra."""
    model = Model(
        material=NeoHookean(K_e=20.0, G_e=0.05, epsilon=0.1, elastic_state="B" if creep else "F"),
        viscosity=StokesViscosity(K_v=0.01, G_v=0.01),
        hyperviscosity=HyperViscosity(mu=1e-5, p=p),
        creep=creep,
    )
    if mesh is None:
        mesh = box((1, 1), 0.1) if dim == 2 else structured_box((1, 1, 1), (4, 4, 4))
    others = tuple(sorted(set(mesh.GetBoundaries()) - {"top"}))
    walls: Conditions = {"top": PrescribedTangential((1.0, *(0.0,) * (dim - 1))), others: NoSlip()}
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


def rough(p: float, options: NewtonOptions) -> Simulation:
    """A body whose velocity jumps by 2 m/s along a line, and its density by a half along another."""
    inside = IfPos(x - 0.1, 1.0, 0.0) * IfPos(0.9 - x, 1.0, 0.0)
    velocity = CF((inside * IfPos(y - 0.5, 1.0, -1.0), 0.0))
    initial = Initial(density=1 + 0.5 * IfPos(x - 0.5, 1.0, 0.0), velocity=velocity)
    return Simulation(square(0.1), _solid(p), dt=DT, initial=initial, newton=options)


def lid(p: float, mesh: Callable[[], Mesh]) -> Simulation:
    """The lid-driven cavity."""
    domain = mesh()
    return cavity(p, domain.dim, None, DT, NewtonOptions(), domain)


def starts() -> tuple[Start, ...]:
    """Lids, stiff creep under one, released loads, rough data."""
    options = NewtonOptions()
    meshes: dict[str, Callable[[], Mesh]] = {f"h = {h:g}": partial(square, h) for h in (0.1, 0.05, 0.025)}
    of_lids = [
        Start(f"lid, {name}, p = {p:g}", partial(lid, p, mesh))
        for name, mesh in (meshes | {"a cube": cube}).items()
        for p in (2.0, 4.0)
    ]
    creeping = Start("lid, stiff creep, p = 4", partial(cavity, 4.0, 2, STIFF, DT, options))
    others = [
        Start(f"{name}, p = {p:g}", make, of_lid=False)
        for p in (2.0, 4.0)
        for name, make in (
            ("released load", partial(released, p, DT, options)),
            ("rough data", partial(rough, p, options)),
        )
    ]
    return *of_lids, creeping, *others


COLUMNS = (
    *("start", "cells", "iterations", "of these rejected", "parts", "coupled retries"),
    *("limited cells", "|closure|", "processor time, s", "why it ended"),
)


def outcome(of: Sequence[Start]) -> Outcome:
    """The most iterations and retries of the starts, and a row for each."""
    rows: list[list[str | float]] = []
    most, retries, closure, failed = {True: 0, False: 0}, 0, 0.0, 0
    for one in of:
        run = one.make()
        took = first_step(run)
        whole = took.iterations + took.rejected
        most[one.of_lid] = max(most[one.of_lid], whole)
        retries, closure = retries + took.retries, max(closure, took.closure)
        failed += bool(took.failure)
        rows.append(
            [
                *(one.name, run.cells, whole, took.rejected, took.parts, took.retries, took.limited),
                *(took.closure, took.seconds, took.failure),
            ]
        )
    return Outcome(
        values={
            "most iterations of a first step under a lid": float(most[True]),
            "most iterations of another first step": float(most[False]),
            "coupled retries": float(retries),
            "first steps that are not solved": float(failed),
            "largest |closure|": closure,
        },
        tables=[Table("first steps", COLUMNS, rows)],
        remarks=[
            "Iterations are of the whole step: of its parts, and of what was rejected before them. Processor "
            "time is of the step alone, beside other processes."
        ],
    )


CASES = (
    Case(
        name="impulsive-starts",
        theme=robustness.THEME,
        statement="The first step of a body at rest under a lid that has full speed at once, of a released "
        "load, with stiff creep and from rough data takes at most 30 iterations, by the split solver alone.",
        label="Euler-large-viscoelastodyn+disc",
        setting="Steps of 0.02 s. Lids: demos/cavity on 230, 942 and 3,720 triangles and in a cube of 3,072 "
        "tetrahedra, p = 2 and 4, and with a Maxwell time of 2 ms. On 230 triangles: a body sheared by 0.3 "
        "in one half and let go; velocity that jumps by 2 m/s and density by a half.",
        bounds=(
            Bound("most iterations of a first step under a lid", "<=", MOST, "none that takes minutes"),
            Bound("most iterations of another first step", "<=", MOST, "none that takes minutes"),
            Bound("coupled retries", "<=", 0.0, "none is needed"),
            Bound("first steps that are not solved", "<=", 0.0, "each is solved"),
            Bound("largest |closure|", "<=", 1e-10, "the tolerance of Newton's iteration"),
        ),
        run=lambda: outcome(starts()),
    ),
)
