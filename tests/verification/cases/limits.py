"""Limits: tau -> 0, delta -> 0, epsilon -> 0, each with its rate; the energy balance as an equality."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from typing import Any

import ngvisco as nv
from ngvisco.physics.tensors import square
from ngvisco.physics.variables import SmallStrain
from tests.verification.case import Bound, Case, Outcome, Plot
from tests.verification.rates import RateTable
from tests.verification.setups import (
    CLOSURE,
    KINDS,
    LABELS,
    SETTING,
    block,
    closure,
    material,
    separation,
    slope_line,
    square_mesh,
)

THEME = "Limits"
DURATION = 0.16
SIZES = (1e-1, 1e-2, 1e-3, 1e-4)
YOSIDA_SIZES = (1e-2, 1e-3, 1e-4, 1e-5)


def _plot(table: RateTable, size: str, rate: float, what: str = "distance in L2") -> Plot:
    first = next(iter(table.errors.values()))
    plot = table.plot(size, what)
    line = slope_line(table.sizes, first, rate)
    return Plot(plot.title, plot.xlabel, plot.ylabel, [*plot.curves, line], log="xy")


def in_tau(kind: str) -> Outcome:
    """Runs with tau, tau/2, ... against the next finer one, and what they dissipate numerically."""
    table = RateTable(f"distance to the run with half the step, t = {DURATION} s")
    losses = RateTable("numerical dissipation until then, relative to the initial energy")
    runs: list[nv.Simulation] = []
    for steps in (8, 16, 32, 64, 128):
        run = block(kind, DURATION / steps, creep=2.0, gravity=1.0)
        ledger = run.run(DURATION)
        runs.append(run)
        lost = ledger.column("inertial").sum() + ledger.column("bregman").sum()
        energy = ledger.column("kinetic")[0] + ledger.column("stored")[0]
        losses.add(DURATION / steps, inertial_and_bregman=float(lost / energy))
    for coarse, fine in pairwise(runs):
        table.add(coarse.dt, **separation(coarse, fine))
    return Outcome(
        values={
            **{f"last rate of {name}": table.last(name) for name in table.errors},
            "last rate of the numerical dissipation": losses.last("inertial_and_bregman"),
            "largest |closure|": closure(*runs),
        },
        tables=[table.table("tau, s"), losses.table("tau, s")],
        plots=[_plot(table, "tau, s", 1.0), _plot(losses, "tau, s", 1.0, "share of the energy")],
    )


def against_zero(
    kind: str,
    options: Callable[[float], dict[str, Any]],
    name: str,
    sizes: Sequence[float] = SIZES,
    of: nv.Material | None = None,
) -> Outcome:
    """Runs with a regularisation of decreasing size against the one without.

    ``options`` gives ``block``'s for a size; ``of`` is the material of the one without.
    """
    dt, mesh = DURATION / 8, square_mesh(0.35)
    without = block(kind, dt, mesh=mesh, creep=2.0, gravity=1.0, of=of)
    without.run(DURATION)
    table, runs = RateTable(f"distance to {name} = 0, t = {DURATION} s"), [without]
    for size in sizes:
        run = block(kind, dt, mesh=mesh, creep=2.0, gravity=1.0, **options(size))
        run.run(DURATION)
        runs.append(run)
        table.add(size, **separation(run, without))
    return Outcome(
        values={
            **{f"last rate of {field}": table.last(field) for field in table.errors},
            "largest |closure|": closure(*runs),
        },
        tables=[table.table(name)],
        plots=[_plot(table, name, 1.0)],
    )


def _delta(size: float) -> dict[str, Any]:
    return {"regularisation": nv.Regularisation(delta_density=size, delta_fields=size)}


def _epsilon(size: float) -> dict[str, Any]:
    return {"regularisation": nv.Regularisation(epsilon=size)}


def _yosida(of: nv.Material, size: float) -> dict[str, Any]:
    return {"of": nv.Yosida(material=of, eps=size)}


QUARTIC = nv.CustomMaterial(
    transported=(SmallStrain(),), stored_energy=lambda E: 5 * square(E) + 50 * square(E) * square(E)
)
"""5 |E|^2 + 50 |E|^4 Pa: at |E| = 0.3, which the swirl reaches, both are of one size."""


def _rates(limit: float, reason: str, momentum: str = "") -> tuple[Bound, ...]:
    """``momentum`` is the label of the momentum equation, if a case is its own."""
    return tuple(
        Bound(
            f"last rate of {name}",
            ">=",
            limit,
            reason + (f"; {momentum}" if momentum and name == "v" else ""),
        )
        for name in ("v", "rho", "z")
    )


def _cases(kind: str) -> tuple[Case, ...]:
    setting = f"{SETTING}, creep with G_m = 2 Pa s, gravity 1 m/s2, until {DURATION} s"
    tau = Case(
        name=f"limit-tau-{kind}",
        theme=THEME,
        statement=f"As tau -> 0 {KINDS[kind]} converges at first order, and the energy inequality becomes an "
        "equality: what the scheme dissipates numerically vanishes like tau.",
        label=f"{LABELS[kind]}, "
        + (
            "Euler-small-energy-balance-stress"
            if kind == "linearised"
            else "Euler-large-energy-balance-stress"
        ),
        setting=f"{setting}; cells of 0.5 m; 8 to 128 steps, each run compared with the one of half the "
        f"step.",
        bounds=(
            *_rates(
                0.85,
                "implicit Euler is of first order",
                "" if kind == "linearised" else "ED-Euler-large1-polyconvex",
            ),
            Bound("last rate of the numerical dissipation", ">=", 0.9, "order tau"),
            CLOSURE,
        ),
        run=partial(in_tau, kind),
        reduced=kind == "linearised",
    )
    delta = Case(
        name=f"limit-delta-{kind}",
        theme=THEME,
        statement=f"As delta -> 0 the solutions of {KINDS[kind]} go to those without delta-terms.",
        label="Euler-small-converge+" if kind == "linearised" else "ED-Euler-large-polyconvex-eta",
        setting=f"{setting}; cells of 0.35 m, 8 steps; delta from 0.1 to 1e-4 in the density's (r = 4) "
        f"and the fields' diffusion.",
        bounds=(*_rates(0.5, "the size sqrt(delta) of the delta-terms"), CLOSURE),
        run=partial(against_zero, kind, _delta, "delta"),
    )
    epsilon = Case(
        name=f"limit-epsilon-{kind}",
        theme=THEME,
        statement=f"As epsilon -> 0 the solutions of {KINDS[kind]} go to those without epsilon |v|^(p-2) v.",
        label="Euler-small-viscoelastodyn+eps" if kind == "linearised" else "ED-Euler-large-polyconvex-eps",
        setting=f"{setting}; cells of 0.35 m, 8 steps; epsilon from 0.1 to 1e-4, p = 4.",
        bounds=(*_rates(0.9, "a smooth term: its size"), CLOSURE),
        run=partial(against_zero, kind, _epsilon, "epsilon"),
        reduced=kind == "linearised",
    )
    yosida = Case(
        name=f"limit-yosida-{kind}",
        theme=THEME,
        statement=f"As epsilon -> 0 the solutions of {KINDS[kind]} with the Yosida approximation of the "
        f"stored "
        "energy go to those with the energy itself.",
        label="varphi-regularized, ED-Euler-large-polyconvex-eps"
        if kind == "finite"
        else "varphi-regularized",
        setting=f"{setting}; cells of 0.35 m, 8 steps; epsilon from 1e-2 to 1e-5 1/Pa.",
        bounds=(*_rates(0.9, "the approximation is of first order in epsilon"), CLOSURE),
        run=partial(against_zero, kind, partial(_yosida, material(kind)), "epsilon, 1/Pa", YOSIDA_SIZES),
    )
    return tau, delta, epsilon, yosida


CASES = (
    *(case for kind in KINDS for case in _cases(kind)),
    Case(
        name="limit-yosida-quartic",
        theme=THEME,
        statement="As epsilon -> 0 the solutions with the Yosida approximation of an energy that grows like "
        "|E|^4 go to those with the energy itself.",
        label="rem-general-phi, varphi-regularized",
        setting=f"As limit-yosida-linearised, with the energy 5 |E|^2 + 50 |E|^4 Pa until {DURATION} s.",
        bounds=(*_rates(0.9, "the approximation is of first order in epsilon"), CLOSURE),
        run=partial(
            against_zero, "linearised", partial(_yosida, QUARTIC), "epsilon, 1/Pa", YOSIDA_SIZES, QUARTIC
        ),
    ),
)
