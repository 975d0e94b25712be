"""Manufactured solutions: the sources checked without NGSolve, rates of the transport alone and in time."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from itertools import pairwise

from ngvisco.forms.context import time
from ngvisco.forms.start.initial import Initial
from ngvisco.geometries import box
from ngvisco.run.simulation import Simulation
from tests.verification.case import Bound, Case, Curve, Outcome, Plot, Table
from tests.verification.convergence import errors, transport_rates
from tests.verification.differences import mismatch
from tests.verification.manufactured import Exact
from tests.verification.models import coefficients, model
from tests.verification.rates import RateTable
from tests.verification.setups import separation
from tests.verification.sources import Sources

THEME = "Convergence: manufactured solutions"
NAMES = {"linear": "linearised", "neo-hookean": "finite"}
LABELS = {"linear": "Euler-small-viscoelastodyn+disc", "neo-hookean": "Euler-large-viscoelastodyn+disc"}
TERMS = "creep, gravity, Stokes viscosity, hyperviscosity p = 4, delta (r = 4) and epsilon (p = 4)"
AGREES = 1e-6
"""Of differences of eighth order with the analytic sources, relative."""

CONTROLS = {
    "K_e": ("momentum", 1.01),
    "G_e": ("momentum", 1.01),
    "K_v": ("momentum", 1.01),
    "G_v": ("momentum", 1.01),
    "mu": ("momentum", 1.01),
    "p": ("momentum", 1.01),
    "g": ("momentum", 1.01),
    "damping": ("momentum", 1.2),
    "R": ("F", 1.01),
    "delta_fields": ("F", 1.01),
    "delta": ("continuity", 1.01),
}
"""Coefficient: the equation that must notice it, and the factor that it is wrong by."""


def _sources(kind: str) -> Outcome:
    rows: list[list[str | float]] = []
    largest, t, tau = 0.0, 0.3, 0.05
    for dim in (2, 3):
        sources = Sources(model(kind, dim, 4.0, True), dim, tau)
        found = mismatch(coefficients(kind, 4.0, True), sources, kind, t, box((1,) * dim, 1.0))
        for name, value in found.items():
            rows.append([f"{dim}D", name, "–", value])
            largest = max(largest, value)
    mesh, seen = box((1, 1), 1.0), math.inf
    sources = Sources(model(kind, 2, 4.0, True), 2, tau)
    for name, (equation, factor) in CONTROLS.items():
        right = coefficients(kind, 4.0, True)
        wrong = replace(right, **{name: factor * getattr(right, name)})
        where = "E" if equation == "F" and kind == "linear" else equation
        value = mismatch(wrong, sources, kind, t, mesh)[where]
        rows.append(["2D", where, f"{name} x {factor:g}", value])
        seen = min(seen, value)
    return Outcome(
        values={
            "largest difference of a source and its independent residual": largest,
            "smallest difference with a wrong coefficient": seen,
        },
        tables=[
            Table(
                "relative differences at eight random points", ["", "equation", "control", "difference"], rows
            )
        ],
    )


def _transport(kind: str, dim: int, orders: tuple[int, ...], maxh: float, levels: int) -> Outcome:
    values, tables, curves = {}, [], []
    for m in orders:
        table = transport_rates(kind, dim, m, maxh, levels)
        tables.append(table.table("h, m"))
        for name in table.errors:
            values[f"rate of {name}, m = {m}"] = table.last(name)
            curves.append(Curve(f"{name}, m = {m}", table.sizes, table.errors[name]))
    plot = Plot(f"Transport alone, {kind}, {dim}D", "h, m", "L2 error", curves, log="xy")
    return Outcome(values=values, tables=tables, plots=[plot])


def _time(kind: str) -> Outcome:
    """Sources with the derivative in time (a step of 1e-6 s); what half the step changes is of order tau.

    On one mesh the error in space is in every run alike, and larger than that in time.
    """
    system, duration = model(kind, 2, 4.0, True), 0.4
    table = RateTable("distance to the run with half the step, k = 2, m = 1, h = 0.3 m")
    total = RateTable("errors against the exact fields (the one in space is in them)")
    mesh, runs = box((1, 1), 0.3), []
    for steps in (2, 4, 8, 16):
        time.Set(0.0)
        exact = Exact(system, 2, time)
        run = Simulation(
            mesh,
            system,
            dt=duration / steps,
            initial=Initial(density=exact.rho, velocity=exact.v, values=exact.values),
            sources=Sources(system, 2, 1e-6),
        )
        run.run(duration)
        total.add(run.dt, **errors(run, exact))
        runs.append(run)
    for coarse, fine in pairwise(runs):
        table.add(coarse.dt, **separation(coarse, fine))
    return Outcome(
        values={f"rate of {name}": table.last(name) for name in table.errors},
        tables=[table.table("tau, s"), total.table("tau, s")],
        plots=[table.plot("tau, s", "L2")],
    )


def _cases(kind: str) -> tuple[Case, ...]:
    name = NAMES[kind]
    label = LABELS[kind]
    checked = Case(
        name=f"manufactured-sources-{name}",
        theme=THEME,
        statement="Each manufactured source is the strong residual of the exact fields, found "
        "independently by finite differences in NumPy; a coefficient that is wrong is noticed.",
        label=label,
        setting=f"{TERMS}; 2D and 3D, eight random points.",
        bounds=(
            Bound("largest difference of a source and its independent residual", "<=", AGREES, "differences"),
            Bound("smallest difference with a wrong coefficient", ">=", 10 * AGREES, "the negative control"),
        ),
        run=partial(_sources, kind),
        reduced=kind == "linear",
    )
    carried = Case(
        name=f"manufactured-transport-{name}",
        theme=THEME,
        statement="Density and fields alone, with the exact velocity, converge with order m + 1 in 2D.",
        label="Euler-small-viscoelastodyn+0disc, Euler-small-viscoelastodyn+2disc"
        if kind == "linear"
        else "DT-det-extended, ED-Euler-large2",
        setting="Unit square, 0.4 m refined twice, two steps of 0.25 s (CFL up to 3), m = 0, 1, 2.",
        bounds=tuple(
            Bound(f"rate of {what}, m = {m}", ">=", m + 0.85, "order m + 1")
            for m in (0, 1, 2)
            for what in ("rho", "z")
        ),
        run=partial(_transport, kind, 2, (0, 1, 2), 0.4, 3),
        reduced=kind == "linear",
    )
    carried_3d = Case(
        name=f"manufactured-transport-3d-{name}",
        theme=THEME,
        statement="Density and fields alone converge with at least order m + 1/2 in 3D.",
        label=carried.label,
        setting="Unit cube, 12 tetrahedra refined twice (m = 0, 1) to 768, two steps of 0.25 s.",
        bounds=tuple(
            Bound(f"rate of {what}, m = {m}", ">=", m + 0.5, "the theory of upwind transport")
            for m in (0, 1)
            for what in ("rho", "z")
        ),
        run=partial(_transport, kind, 3, (0, 1), 1.0, 3),
    )
    in_time = Case(
        name=f"manufactured-time-{name}",
        theme=THEME,
        statement="The coupled system with all its terms converges with first order in time.",
        label=label,
        setting=f"{TERMS}; sources with the derivative in time; unit square, h = 0.3 m, until 0.4 s in "
        "2, 4, 8, 16 steps, each run against that of half the step.",
        bounds=tuple(Bound(f"rate of {what}", ">=", 0.8, "implicit Euler") for what in ("v", "rho", "z")),
        run=partial(_time, kind),
    )
    return checked, carried, carried_3d, in_time


CASES = tuple(case for kind in NAMES for case in _cases(kind))
