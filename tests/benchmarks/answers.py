"""Error over seconds by order, cells, step and scheme: ``python -m tests.benchmarks.answers [PROBLEM ...]``.

The error is that of the kinetic energy at the end, against a finer run with the midpoint rule, half of the
smallest step and velocities of degree 3; for the ball, against the closed form.  For the soft disc it is the
distance of the centroid, over the length of its path, from the path by another method on 128 x 128 cells
(``tests/verification/immersed.py``), which has rows for coarser grids too.  The other problems have rows of
Lagrangian elements of degree 2 by the midpoint rule (``tests/verification/lagrangian_solid.py``).  Seconds
are processor time of one thread without the set-up.  The column "relative" has the seconds over those of the
run ``UNIT``, which is made before and after each problem. Relative seconds are comparable between calls.  A
table marks a problem's runs for which no cheaper run has a smaller error.  The last table has the seconds of
the cheapest run within a given error.
"""

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product
from typing import TypeAlias

import numpy as np
from ngsolve import (
    CF,
    Det,
    IfPos,
    InnerProduct,
    Periodic,
    SetNumThreads,
    VectorH1,
    cos,
    log,
    pi,
    sin,
    sqrt,
    x,
    y,
    z,
)

import ngvisco as nv
from ngvisco.geometries import box, sphere, structured_box
from ngvisco.physics.variables import Jacobian
from ngvisco.threads import computing
from tests.benchmarks.table import add_files, against, read, write
from tests.verification.cases.soft_disc import PATH
from tests.verification.immersed import CAVITY, computed
from tests.verification.lagrangian_solid import LagrangianSolid, neo_hookean

SCHEMES = ("backward-euler", "midpoint")
UNIT = ("shear wave", (2, 1), 6, 20, "midpoint")
"""The reference run, whose time is the unit of the column "relative": problem, orders, cells a side, number
of steps and scheme."""
ERRORS = (0.1, 0.03, 0.01, 0.003)
"""Errors of the last table."""
REFERENCE = ((3, 2), 9, 40, "midpoint")
"""Orders, cells a side, number of steps and scheme of the finer run."""

BULK, SHEAR, EPSILON, ETA = 10.0, 5.0, 0.1, 0.01
"""K_e, G_e and epsilon, Pa, and the viscosity, Pa s, of all solids; their density is 1 kg/m^3."""
SOLID = nv.NeoHookean(K_e=BULK, G_e=SHEAR, epsilon=EPSILON)
VISCOSITY = nv.StokesViscosity(K_v=ETA, G_v=ETA)
CENTRE = np.array([0.6, 0.5])
"""The soft disc's centre at the start, m."""


SWIRLING = CF((sin(pi * x) * cos(pi * y), -cos(pi * x) * sin(pi * y)))
WAVING = CF((0.0, 0.1 * SHEAR**0.5 * cos(2 * pi * x)))
"""Velocities at the start of the swirl and of the wave, m/s."""


def swirl(cells: int, **options: object) -> nv.Simulation:
    """The swirl of ``case`` in a box with walls."""
    hyper = nv.HyperViscosity(mu=1e-5, p=4)
    model = nv.Model(material=SOLID, viscosity=VISCOSITY, hyperviscosity=hyper)
    mesh = structured_box((1, 1), (cells, cells))
    return nv.Simulation(mesh, model, initial=nv.Initial(velocity=SWIRLING), **options)  # type: ignore[arg-type]


def shear_wave(cells: int, **options: object) -> nv.Simulation:
    """A standing wave of 10 % strain in a periodic cell."""
    model = nv.Model(material=SOLID, viscosity=VISCOSITY)
    initial = nv.Initial(velocity=WAVING)
    mesh = structured_box((1, 1), (cells, cells), periodic="xy")
    return nv.Simulation(mesh, model, initial=initial, **options)  # type: ignore[arg-type]


def soft_disc(cells: int, **options: object) -> nv.Simulation:
    """The disc of Zhao, Freund and Moser in a lid-driven cavity; cells of 1 m/cells, halved at the lid."""
    fluid = nv.CustomMaterial(transported=(Jacobian(),), stored_energy=lambda J: 25 * (J - 1) * (J - 1) / J)
    solid = nv.IsochoricNeoHookean(K_e=50.0, G_e=0.05, elastic_state="B")
    both = {"viscosity": VISCOSITY, "density": 1.0}
    disc = nv.Body(name="disc", where=nv.Ball(tuple(CENTRE), 0.2), material=solid, **both)  # type: ignore[arg-type]
    rest = nv.Body(name="rest", material=fluid, **both)  # type: ignore[arg-type]
    walls = {"top": nv.PrescribedTangential((1.0, 0.0)), ("left", "right", "bottom"): nv.NoSlip()}
    mesh = box((1, 1), maxh=1 / cells, refine={"top": 0.5 / cells}, split_corners=True)
    return nv.Simulation(mesh, nv.Model(bodies=[rest, disc]), walls=walls, **options)  # type: ignore[arg-type]


ROOT, RADIUS, AMPLITUDE = 4.493409457909064, 0.5, 1e-3
"""The first root of tan s = s; the ball's radius, m, and start velocity, m/s."""
_ALONG = ROOT / RADIUS * sqrt(x * x + y * y + z * z)
_TURNING = (
    AMPLITUDE * ROOT / RADIUS * IfPos(_ALONG - 1e-3, (sin(_ALONG) / _ALONG - cos(_ALONG)) / _ALONG**2, 1 / 3)
)
TURNING = CF((-_TURNING * y, _TURNING * x, 0.0))
"""Velocity at the start, m/s: AMPLITUDE j_1(ROOT r/RADIUS) about the z-axis, with the spherical Bessel
function j_1."""


def ball(cells: int, **options: object) -> nv.Simulation:
    """A ball that is turned about the z-axis, in its first torsional mode, with its surface at rest.

    Cells have the size of the diameter over ``cells``.
    """
    model = nv.Model(material=nv.LinearElastic(K_e=BULK, G_e=SHEAR), viscosity=VISCOSITY)
    mesh, walls = sphere(RADIUS, maxh=2 * RADIUS / cells), {"wall": nv.NoSlip()}
    return nv.Simulation(mesh, model, initial=nv.Initial(velocity=TURNING), walls=walls, **options)  # type: ignore[arg-type]


def kept_of_ball(t: float) -> np.ndarray:
    """Kinetic energy, divided by its start value, of a mode of the wave equation with viscous damping."""
    per_length = (ROOT / RADIUS) ** 2
    decay = ETA * per_length / 2
    rate = (SHEAR * per_length - decay**2) ** 0.5
    return np.array([(np.exp(-decay * t) * (np.cos(rate * t) - decay / rate * np.sin(rate * t))) ** 2])


def kept(run: nv.Simulation) -> np.ndarray:
    """The kinetic energy divided by its start value."""
    return np.array([run.ledger.rows[-1]["kinetic"] / run.ledger.rows[0]["kinetic"]])


def kinetic(run: nv.Simulation) -> np.ndarray:
    """The kinetic energy, J."""
    return np.array([run.ledger.rows[-1]["kinetic"]])


def displacement(run: nv.Simulation) -> np.ndarray:
    """Displacement of the disc's centroid, m."""
    amount = run.rothe_step.now.z_tensors["n_disc"]
    volume, *moments = run.rothe_step.quadrature.integrate_cells(CF((amount, amount * x, amount * y)))
    return np.array(moments) / volume - CENTRE


@dataclass(frozen=True)
class Problem:
    """A problem: how to make a run, and the numbers that are compared.

    Attributes
    ----------
    make : callable
        Makes a run with a number of cells a side.
    answer : callable
        Returns the numbers at the end of a run.
    until : float
        End of the run, s.
    orders, cells, steps : tuple
        The pairs k and m, the cells a side, and the numbers of steps.
    schemes : tuple, optional
        The schemes of time.
    exact : array, optional
        The exact answer; the default is the answer of ``REFERENCE``.
    peers : callable, optional
        Makes runs by other methods, given the problem and its exact answer.
    """

    make: Callable[..., nv.Simulation]
    answer: Callable[[nv.Simulation], np.ndarray] = kinetic
    until: float = 0.2
    orders: tuple[tuple[int, int], ...] = ((2, 1), (3, 2))
    cells: tuple[int, ...] = (3, 6)
    steps: tuple[int, ...] = (5, 20)
    schemes: tuple[str, ...] = SCHEMES
    exact: np.ndarray | None = None
    peers: Callable[["Problem", np.ndarray], Iterator["Row"]] = lambda *_: iter(())


Row: TypeAlias = tuple[dict, np.ndarray, np.ndarray, float]
"""A run by another method: its choices, its answer, the exact answer, and its seconds."""


def immersed(problem: Problem, exact: np.ndarray) -> Iterator[Row]:
    """The soft disc by Lagrangian triangles in a fixed grid."""
    for cells in (32, 64):
        began = time.process_time()
        path = computed(CAVITY, cells, np.array([0.0, problem.until]))
        choice = {"scheme": "immersed triangles, explicit", "cells": cells}
        yield choice, path[-1, 1:3] - CENTRE, exact, time.process_time() - began


def per_reference(F: CF) -> CF:
    """The energy of ``SOLID`` per referential volume, in plane strain."""
    J, square = Det(F), InnerProduct(F, F) + 1
    bulk = BULK / 2 * (J - 1 + EPSILON / BULK) ** 2
    return J * (bulk + SHEAR * J ** (-2 / 3) * square - EPSILON * log(J))


def lagrangian_swirl(cells: int, order: int) -> LagrangianSolid:
    """The swirl without hyperviscosity on a moving mesh."""
    mesh = structured_box((1, 1), (cells, cells))
    space = VectorH1(mesh, order=order, dirichletx="left|right", dirichlety="top|bottom")
    return LagrangianSolid(space, SWIRLING, per_reference, 1.0, ETA)


def lagrangian_wave(cells: int, order: int) -> LagrangianSolid:
    """The wave on a moving mesh."""
    space = Periodic(VectorH1(structured_box((1, 1), (cells, cells), periodic="xy"), order=order))
    return LagrangianSolid(space, WAVING, per_reference, 1.0, ETA)


def lagrangian_ball(cells: int, order: int) -> LagrangianSolid:
    """The ball on a moving mesh."""
    space = VectorH1(sphere(RADIUS, maxh=2 * RADIUS / cells), order=order, dirichlet=".*")
    return LagrangianSolid(space, TURNING, neo_hookean(BULK, SHEAR), 1.0, ETA)


def lagrangian(
    make: Callable[[int, int], LagrangianSolid], is_share: bool = False, has_own_reference: bool = False
) -> Callable[[Problem, np.ndarray], Iterator[Row]]:
    """Runs on a moving mesh by the midpoint rule, with the cells and steps of the problem.

    The answer is the kinetic energy, which is divided by its start value if ``is_share``. If
    ``has_own_reference``, the runs are compared with a finer run of degree 3 on a moving mesh.
    """

    def answer(cells: int, steps: int, until: float, order: int = 2) -> tuple[np.ndarray, float]:
        solid = make(cells, order)
        first, began = solid.kinetic if is_share else 1.0, time.process_time()
        with computing():
            solid.advance(until, until / steps)
        return np.array([solid.kinetic / first]), time.process_time() - began

    def rows(problem: Problem, exact: np.ndarray) -> Iterator[Row]:
        if has_own_reference:
            (order, _), cells, steps, _ = REFERENCE
            exact, _ = answer(cells, steps, problem.until, order)
        for cells, steps in product(problem.cells, problem.steps):
            choice = {"scheme": "Lagrangian P2, midpoint", "cells": cells, "dt": problem.until / steps}
            found, seconds = answer(cells, steps, problem.until)
            yield choice, found, exact, seconds

    return rows


PROBLEMS = {
    "swirl": Problem(swirl, peers=lagrangian(lagrangian_swirl, has_own_reference=True)),
    "shear wave": Problem(shear_wave, peers=lagrangian(lagrangian_wave)),
    "soft disc": Problem(
        soft_disc,
        displacement,
        until=2.0,
        orders=((2, 1), (3, 1)),
        cells=(6, 8),
        steps=(20, 40),
        schemes=("midpoint",),
        exact=PATH[PATH[:, 0] == 2.0][0, 1:] - CENTRE,
        peers=immersed,
    ),
    "ball": Problem(
        ball,
        kept,
        orders=((2, 1),),
        cells=(4, 6, 8),
        schemes=("midpoint",),
        exact=kept_of_ball(0.2),
        peers=lagrangian(lagrangian_ball, is_share=True),
    ),
}


def measured(
    name: str, order: tuple[int, int], cells: int, steps: int, scheme: str
) -> tuple[np.ndarray, float]:
    """The answer of a run, and its seconds."""
    problem, (k, m) = PROBLEMS[name], order
    discretisation = nv.Discretisation(k=k, m=m)
    run = problem.make(cells, dt=problem.until / steps, scheme=scheme, discretisation=discretisation)
    began = time.process_time()
    run.run(problem.until)
    return problem.answer(run), time.process_time() - began


def rows_of(name: str) -> list[dict]:
    """A problem's runs, the cheapest first; a run is "best" if no cheaper run has a smaller error."""
    problem = PROBLEMS[name]
    exact = measured(name, *REFERENCE)[0] if problem.exact is None else problem.exact
    rows: list[dict] = []
    units = [measured(*UNIT)[1]]

    def add(choice: dict, answer: np.ndarray, exact: np.ndarray, seconds: float) -> None:
        size = float(np.linalg.norm(exact))
        error = float(np.linalg.norm(answer - exact)) / size
        rows.append({"problem": name, **choice, "error": error, "seconds": seconds, "exact": size})

    for (k, m), cells, steps, scheme in product(
        problem.orders, problem.cells, problem.steps, problem.schemes
    ):
        choice = {"scheme": scheme, "k": k, "m": m, "cells": cells, "dt": problem.until / steps}
        answer, seconds = measured(name, (k, m), cells, steps, scheme)
        add(choice, answer, exact, seconds)
    for row in problem.peers(problem, exact):
        add(*row)
    units.append(measured(*UNIT)[1])
    rows.sort(key=lambda row: row["seconds"])
    least = float("inf")
    for row in rows:
        row["relative"] = row["seconds"] / float(np.mean(units))
        row["best"] = row["error"] < least
        least = min(least, row["error"])
    return rows


def _choice(row: dict) -> str:
    """Orders, cells a side and step of a run; another method has no orders, and may have no step."""
    orders = f"{row['k']}, {row['m']}" if "k" in row else ""
    return f"{orders} | {row['cells']} | {row.get('dt', ''):{'g' if 'dt' in row else ''}}"


def markdown(rows: list[dict]) -> str:
    """A Markdown table of one problem's rows."""
    lines = [
        f"| {rows[0]['problem']} | k, m | cells a side | dt, s | error | time, s | relative | best |",
        "|" + "---|" * 8,
    ]
    for row in rows:
        cost = f"{row['seconds']:.1f} | {row['relative']:.2g} | {'*' if row['best'] else ''}"
        lines.append(f"| {row['scheme']} | {_choice(row)} | {row['error']:.2%} | {cost} |")
    return "\n".join(
        [*lines, "", f"Size of the exact answer: {next(row for row in rows if 'k' in row)['exact']:.6g}.", ""]
    )


def to_the_same_error(rows: list[dict]) -> str:
    """A Markdown table of the cheapest run of each problem, and of each other method, within each error."""
    head = "| error at most | problem | k, m | cells a side | dt, s | scheme | time, s | relative |"
    lines = [head, "|" + "---|" * 8]
    methods = dict.fromkeys((row["problem"], "k" in row) for row in rows)
    for error, (problem, ours) in product(ERRORS, methods):
        within = [r for r in rows if (r["problem"], "k" in r) == (problem, ours) and r["error"] <= error]
        if not within:
            none = "no run" if ours else "no run of the other method"
            lines.append(f"| {error:.1%} | {problem} | | | | {none} | | |")
            continue
        row = min(within, key=lambda row: row["seconds"])
        what = f"{problem} | {_choice(row)} | {row['scheme']}"
        lines.append(f"| {error:.1%} | {what} | {row['seconds']:.1f} | {row['relative']:.2g} |")
    return "\n".join([*lines, ""])


def main(arguments: list[str] | None = None) -> int:
    """Print a table for each problem, the seconds to the same error, and ratios to an older table."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.answers")
    parser.add_argument(
        "problems", nargs="*", metavar="PROBLEM", help=f"of {', '.join(PROBLEMS)}: default all"
    )
    add_files(parser)
    chosen = parser.parse_args(arguments)
    if unknown := sorted(set(chosen.problems) - set(PROBLEMS)):
        parser.error(f"no problem {unknown[0]!r}: there are {', '.join(PROBLEMS)}")
    older = read(chosen.against)
    SetNumThreads(1)
    rows, text = [], ""
    for name in chosen.problems or PROBLEMS:
        rows += (new := rows_of(name))
        text += f"{markdown(new)}\n"
        print(markdown(new), flush=True)
    compared = against(
        rows, older, ("problem", "scheme", "k", "m", "cells", "dt"), ("seconds", "relative", "error")
    )
    print(last := f"{to_the_same_error(rows)}\n{compared}")
    write(chosen.output, "answers", rows, text + last)
    return 0


if __name__ == "__main__":
    sys.exit(main())
