"""A-priori estimates: bounds that do not depend on epsilon and delta, and the size of the delta-terms."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from ngsolve import Integrate

import ngvisco as nv
from ngvisco.physics.tensors import square
from tests.verification.case import Bound, Case, Curve, Outcome, Plot, Table
from tests.verification.functionals import DeltaTerms
from tests.verification.rates import RateTable
from tests.verification.setups import CLOSURE, KINDS, SETTING, block, closure, slope_line

THEME = "A-priori estimates"
SIZES = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
TAU, STEPS = 0.02, 8
SPREAD = {
    "sup |sqrt(rho) v|²": "Euler-small-est1",
    "∫∫ D eps(v):eps(v)": "Euler-small-est2",
    "∫∫ mu |∇²v|^p": "Euler-small-est2",
    "sup stored energy": "Euler-small-est3",
}

SLOPES = {
    "sup ‖∇rho‖ in L4": "Euler-small-est-rho",
    "sup ‖∇z‖ in L2": "Euler-small-est-E",
}
"""Which the paper bounds as delta -> 0; of the cells' own gradients."""


def run_of(kind: str, size: float) -> nv.Simulation:
    """The block with epsilon = delta = ``size``, not run yet."""
    law = nv.Regularisation(delta_density=size, delta_fields=size, epsilon=size)
    return block(kind, TAU, creep=2.0, hyperviscosity=nv.HyperViscosity(mu=1e-4, p=4), regularisation=law)


def bounds_measured(kind: str) -> Outcome:
    """The norms of the estimates for a sequence of epsilon = delta."""
    rows: list[list[str | float]] = []
    closures, balances = [], []
    for size in SIZES:
        run = run_of(kind, size)
        slopes = [0.0, 0.0]
        for _ in range(STEPS):
            run.advance()
            slopes = [max(pair) for pair in zip(slopes, gradients(run), strict=True)]
        ledger = run.ledger
        energy = ledger.column("kinetic") + ledger.column("stored")
        spent = sum(
            ledger.column(entry.name) * TAU for entry in ledger.entries if entry.kind == "dissipation"
        )
        balances.append(float((energy + np.cumsum(spent)).max() / energy[0]))
        closures.append(closure(run))
        viscous = ledger.column("dissipation_stokes_bulk") + ledger.column("dissipation_stokes_shear")
        rows.append(
            [
                size,
                2 * float(ledger.column("kinetic").max()),
                float(viscous.sum() * TAU),
                float(ledger.column("dissipation_hyper").sum() * TAU),
                float(ledger.column("stored").max()),
                float(ledger.column("dissipation_epsilon").sum() * TAU),
                float(ledger.column("dissipation_delta_fields").sum() * TAU),
                float(ledger.column("density_diffusion").sum() * TAU),
                *slopes,
            ]
        )
    terms = ("eps ∫∫|v|^p", "∫∫ delta-term of z : zeta", "delta ∫∫|∇rho|^r")
    columns = ["eps = delta", *SPREAD, *terms, *SLOPES]
    values = {
        "(energy + dissipated so far) / initial energy − 1": max(balances) - 1,
        "largest |closure|": max(closures),
    }
    for i, name in enumerate(SPREAD, 1):
        column = [float(row[i]) for row in rows]
        values[f"largest of {name} over that at the smallest delta"] = max(column) / column[-1]
    for i, name in enumerate(SLOPES, len(columns) - len(SLOPES)):
        values[f"growth of {name} over the last two decades"] = float(rows[-1][i]) / float(rows[-3][i])
    curves = [Curve(n, list(SIZES), [float(r[i]) for r in rows]) for i, n in enumerate(columns[1:], 1)]
    return Outcome(
        values=values,
        tables=[Table("norms of the estimates", columns, rows)],
        plots=[Plot("Norms over eps = delta", "eps = delta", "norm", curves, log="xy")],
    )


def gradients(run: nv.Simulation) -> tuple[float, float]:
    """Norms of the broken gradients of rho, in L4, and of z, in L2."""
    u = run.rothe_step.now
    rho = square(u.grad_rho)
    return (
        float(Integrate(rho * rho, run.mesh, order=8)) ** 0.25,
        float(Integrate(square(u.grad_z), run.mesh, order=8)) ** 0.5,
    )


DELTAS = (1e-2, 1e-3, 1e-4, 1e-5)


def delta_terms(kind: str) -> Outcome:
    """L2(I x Omega) norms of the delta-terms."""
    table = RateTable("delta-terms of rho and z in L2(I x Omega), compensating force in L4(I; L4/3(Omega))")
    for delta in DELTAS:
        run = run_of(kind, delta)
        terms = DeltaTerms(run.rothe_step)
        squares, force = np.zeros(2), 0.0
        for _ in range(STEPS):
            run.advance()
            squares += TAU * np.square(terms.norms())
            force += TAU * terms.compensating_force() ** 4
        table.add(delta, rho=math.sqrt(squares[0]), z=math.sqrt(squares[1]), force=force**0.25)
    plot = table.plot("delta", "norm")
    line = slope_line(table.sizes, table.errors["z"], 0.5)
    return Outcome(
        values={
            "least rate of div(delta|∇rho|^{r-2}∇rho)": min(table.rates("rho")),
            "least rate of delta Laplace z": min(table.rates("z")),
            "least rate of delta|∇rho|^{r-2}(∇v)∇rho": min(table.rates("force")),
        },
        tables=[table.table("delta")],
        plots=[Plot(plot.title, plot.xlabel, plot.ylabel, [*plot.curves, line], log="xy")],
        remarks=["On one mesh the norms end up proportional to delta, which is better than the bound."],
    )


_FINE = (
    ", creep with G_m = 2 Pa s, hyperviscosity mu = 1e-4, p = 4, all regularising terms (r = 4); "
    "cells of 0.5 m"
)


def _cases(kind: str) -> tuple[Case, Case]:
    estimates = Case(
        name=f"estimates-{kind}",
        theme=THEME,
        statement=f"The energy estimates of {KINDS[kind]} hold with one constant for all epsilon and delta.",
        label="Euler-small-est, Euler-small-est-rho-E-"
        if kind == "linearised"
        else "Euler-large-est, Euler-large-est++",
        setting=f"{SETTING}{_FINE}, {STEPS} steps of {TAU} s; epsilon = delta from 0.1 to 1e-6.",
        bounds=(
            Bound(
                "(energy + dissipated so far) / initial energy − 1",
                "<=",
                1e-10,
                "the discrete energy inequality; its right-hand side has neither epsilon nor delta",
            ),
            CLOSURE,
            *(
                Bound(
                    f"largest of {name} over that at the smallest delta",
                    "<=",
                    1.5,
                    f"{label}: one constant for five decades, from above",
                )
                for name, label in SPREAD.items()
            ),
            *(
                Bound(f"growth of {name} over the last two decades", "<=", 1.05, f"{label}: bounded")
                for name, label in SLOPES.items()
            ),
        ),
        run=partial(bounds_measured, kind),
        reduced=kind == "finite",
    )
    delta = Case(
        name=f"delta-terms-{kind}",
        theme=THEME,
        statement=f"In {KINDS[kind]} the delta-terms vanish in L2(I x Omega) like sqrt(delta) or faster, "
        "and the compensating force like delta.",
        label="Euler-small-est-rho-E"
        if kind == "linearised"
        else "Euler-small-est-rho-E, Euler-large-est++F, Euler-large-est++J",
        setting=f"{SETTING}{_FINE}, {STEPS} steps of {TAU} s; delta from 1e-2 to 1e-5.",
        bounds=(
            Bound("least rate of div(delta|∇rho|^{r-2}∇rho)", ">=", 0.5, "the paper's sqrt(delta)"),
            Bound("least rate of delta Laplace z", ">=", 0.5, "the paper's sqrt(delta)"),
            Bound("least rate of delta|∇rho|^{r-2}(∇v)∇rho", ">=", 0.9, "the paper's delta"),
        ),
        run=partial(delta_terms, kind),
    )
    return estimates, delta


CASES = tuple(case for kind in KINDS for case in _cases(kind))
