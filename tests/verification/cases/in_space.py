"""The themes of the plane in three dimensions, small: stability, estimates, limits, invariants and more."""

from __future__ import annotations

from functools import partial

import numpy as np
from ngsolve import CF, cos, pi, sin, x, y, z

import ngvisco as nv
from ngvisco.geometries import box
from tests.verification.case import Bound, Case, Curve, Outcome, Plot, Table
from tests.verification.cases import hyper, robustness, sequence, stability, whole_scheme
from tests.verification.cases.invariants import RHO_MAX, converging
from tests.verification.rates import RateTable
from tests.verification.setups import CLOSURE, KINDS, LABELS, closure, cube_mesh, separation, slope_line

THEME = "Three dimensions"
CUBE = (
    "The block of the plane's cases as a cube of 1 m, its eddy multiplied by 1 + 0.3 cos(pi z), gravity, "
    "where there is any, along -z; "
)
COARSE, FINE = 1.0, 0.5
"""Sizes of the cells, m: 12 and 28 tetrahedra."""

# --- stability, estimates, limits: the plane's measurements on other meshes -----------------------------

TAUS = {"linearised": (1e-3, 1e-1, 10.0), "finite": (1e-3, 1e-2, 1e-1)}
"""s; at finite strain no longer ones, for the time that they take."""

SIZES = (1e-2, 1e-3)


def stable(kind: str) -> Outcome:
    """``stability`` on a cube."""
    return stability.measure(kind, 0.0, cube_mesh(FINE), TAUS[kind], 3)


def estimated(kind: str) -> Outcome:
    """``whole_scheme`` on cubes."""
    return whole_scheme.estimates(kind, {h: cube_mesh(h) for h in (COARSE, FINE)}, SIZES, 4)


def limits(kind: str) -> Outcome:
    """``sequence`` on a cube."""
    return sequence.sequence(
        kind,
        {FINE: cube_mesh(FINE)},
        sequence.STEPS,
        sequence.SIZES[kind][-2:] if kind == "finite" else SIZES,
    )


# --- invariants -------------------------------------------------------------------------------------------


def invariants(kind: str) -> Outcome:
    """Mass, and the range of density and Jacobian in a tube with the cut-off, for m = 0 and 1."""
    rows: list[list[str | float]] = []
    curves, runs = [], []
    for m, delta in ((0, 0.0), (1, 0.0), (1, 1e-3)):
        law = nv.Regularisation(delta_density=delta, rho_max=RHO_MAX)
        run, end = converging(kind, law, 1 / 8, 0.02, m, 3)
        ledger = run.ledger
        runs.append(run)
        extrema = [float(ledger.column("rho_min").min()), float(ledger.column("rho_max").max())]
        drift, volume = np.abs(ledger.column("mass_drift")).max(), ledger.column("cutoff_volume").max()
        J = float(ledger.column("J_min").min())
        rows.append([m, delta, *extrema, J, float(drift), float(volume) * 64, closure(run), end])
        times = [float(t) for t in ledger.column("time")]
        densest = [float(rho) for rho in ledger.column("rho_max")]
        curves.append(Curve(f"m = {m}, delta = {delta:g}", times, densest))
    values = {
        "largest rho": max(float(row[3]) for row in rows),
        "smallest rho": min(float(row[2]) for row in rows),
        "largest relative drift of the mass": max(float(row[5]) for row in rows),
        "share of the volume where the cut-off acts": min(float(row[6]) for row in rows),
        "runs that ended early": float(sum(bool(row[8]) for row in rows)),
        "largest |closure|": closure(*runs),
    }
    if kind == "finite":
        values["smallest J"] = min(float(row[4]) for row in rows)
    columns = ["m", "delta", "min rho", "max rho", "min J", "mass drift", "volume cut", "closure", "end"]
    return Outcome(
        values=values,
        tables=[Table("range of the density", columns, rows)],
        plots=[Plot("Largest density", "t, s", "kg/m3", curves)],
    )


# --- hyperviscosity ---------------------------------------------------------------------------------------

MUS, HYPER_STEPS = (1e-4, 1e-5, 1e-6), 4


def vanishing(kind: str) -> Outcome:
    """mu -> 0 for p = 4 and 2 against no hyperviscosity."""
    mesh, values, runs, tables, plots = cube_mesh(FINE), {}, [], [], []
    without = hyper.run_of(kind, None, mesh=mesh, steps=HYPER_STEPS)
    for p in (4.0, 2.0):
        table = RateTable(f"distance to mu = 0 at t = {HYPER_STEPS * hyper.TAU:g} s, p = {p:g}")
        for mu in MUS:
            run = hyper.run_of(kind, nv.HyperViscosity(mu=mu, p=p), mesh=mesh, steps=HYPER_STEPS)
            runs.append(run)
            table.add(mu, **separation(run, without))
        values[f"last rate of v as mu -> 0, p = {p:g}"] = table.last("v")
        plot, line = table.plot("mu", "distance in L2"), slope_line(table.sizes, table.errors["v"], 1.0)
        plots.append(Plot(plot.title, plot.xlabel, plot.ylabel, [*plot.curves, line], log="xy"))
        tables.append(table.table("mu"))
    values["largest |closure|"] = closure(without, *runs)
    values["smallest rho"] = min(float(run.ledger.column("rho_min").min()) for run in runs)
    return Outcome(values=values, tables=tables, plots=plots)


# --- robustness -------------------------------------------------------------------------------------------

AXES = {
    "stiffness, Pa": (1.0, 1e4),
    "K_e/G_e": (2.0, 1e4),
    "viscosity, Pa s": (0.1,),
    "tau, s": (1e-2, 1.0, 10.0),
}
DRIFT = (
    1 + 0.5 * sin(2 * pi * x) * cos(2 * pi * y) * cos(2 * pi * z),
    0.5 - 0.5 * cos(2 * pi * x) * sin(2 * pi * y) * cos(2 * pi * z),
    CF(0.25),
)


def robust(kind: str) -> Outcome:
    """``robustness`` on a periodic cube, for a part of its grid."""
    return robustness.measure(kind, AXES, box((1, 1, 1), 0.4, periodic="xyz"), DRIFT)


# --- the cases --------------------------------------------------------------------------------------------


def _cases(kind: str) -> tuple[Case, ...]:
    finite = kind == "finite"
    small = [Bound("smallest J", ">=", 0.1, "positive, with distance")] if finite else []
    return (
        Case(
            name=f"space-stability-{kind}",
            theme=THEME,
            statement=f"In three dimensions too energy never rises in a step of {KINDS[kind]}.",
            label="Euler-large-energy-balance-disc" if finite else "Euler-ED-basic-energy-balance-disc",
            setting=f"{CUBE}cells of {FINE} m, three steps each of tau = 1e-3, "
            f"{'0.01 and 0.1' if finite else '0.1 and 10'} s.",
            bounds=stability.BOUNDS,
            run=partial(stable, kind),
        ),
        Case(
            name=f"space-estimates-{kind}",
            theme=THEME,
            statement=f"In three dimensions too the estimates of {KINDS[kind]} hold with all its terms.",
            label="Euler-large-est, Euler-large-est+" if finite else "Euler-small-est, Euler-small-est+",
            setting=f"{CUBE}all terms of the scheme; cells of {COARSE} and {FINE} m, four steps of "
            f"{whole_scheme.TAU} s, epsilon = delta = 1e-2 and 1e-3.",
            bounds=whole_scheme.bounds(kind),
            run=partial(estimated, kind),
        ),
        Case(
            name=f"space-limits-{kind}",
            theme=THEME,
            statement=f"In three dimensions too {KINDS[kind]} converges as tau, delta and epsilon -> 0 in "
            "turn.",
            label=f"{LABELS[kind]}, "
            + ("ED-Euler-large-polyconvex-eta" if finite else "Euler-small-converge+"),
            setting=f"{CUBE}all terms of the scheme; cells of {FINE} m, until {sequence.DURATION} s; 8 to 32 "
            f"steps, then delta, then epsilon of {'1e-4 and 1e-5' if finite else '1e-2 and 1e-3'}.",
            bounds=sequence.bounds(kind),
            run=partial(limits, kind),
        ),
        Case(
            name=f"space-invariants-{kind}",
            theme=THEME,
            statement=f"In three dimensions too mass is conserved and the density stays in (0, rho_max + 1] "
            f"in {KINDS[kind]} with the cut-off, with and without delta.",
            label="cut-off, Euler-small-est-1+, Euler-small-est3+++",
            setting="A soft tube of 1 m x 0.125 m x 0.125 m as in the plane, v = 3 sin(2 pi x) m/s, "
            f"rho_max = {RHO_MAX:g}; cells of 1/8 m, tau = 0.02 s, until 0.3 s.",
            bounds=(
                Bound("largest rho", "<=", RHO_MAX + 1, "the paper's bound"),
                Bound("smallest rho", ">=", 1e-3, "positive, with distance"),
                Bound("largest relative drift of the mass", "<=", 1e-12, "rounding"),
                Bound("share of the volume where the cut-off acts", ">=", 0.05, "it must act"),
                Bound("runs that ended early", "<=", 0, "no step is refused"),
                *small,
                CLOSURE,
            ),
            run=partial(invariants, kind),
        ),
        Case(
            name=f"space-hyperviscosity-{kind}",
            theme=THEME,
            statement=f"In three dimensions too runs of {KINDS[kind]} go to that without hyperviscosity as "
            "mu -> 0.",
            label=f"Euler-small-viscoelastodyn+1, {LABELS[kind]}",
            setting=f"{CUBE}cells of {FINE} m, {HYPER_STEPS} steps of {hyper.TAU} s; mu = 1e-4 to 1e-6, "
            "p = 4 and 2.",
            bounds=(
                *(
                    Bound(f"last rate of v as mu -> 0, p = {p}", ">=", 0.8, "a smooth solution: its size")
                    for p in (4, 2)
                ),
                Bound("smallest rho", ">=", 0.3, "positive, with distance"),
                CLOSURE,
            ),
            run=partial(vanishing, kind),
        ),
        Case(
            name=f"space-robustness-{kind}",
            theme=THEME,
            statement=f"In three dimensions too steps of {KINDS[kind]} are solved over decades of "
            "parameters.",
            label=LABELS[kind],
            setting="A periodic cube of 1 m, cells of 0.4 m, an eddy in a mean flow of (1, 0.5, 0.25) m/s; "
            "three steps of each of 12 configurations: shear modulus 1 and 1e4 Pa, K_e/G_e = 2 and 1e4, "
            "viscosity 0.1 Pa s, tau = 0.01, 1 and 10 s.",
            bounds=(
                Bound("share of the steps solved at the first try", ">=", 0.9, "as in the plane"),
                Bound("share of the steps solved", ">=", 0.98, "as in the plane"),
                Bound("largest |closure|", "<=", 1e-10, "wherever a step is solved"),
                Bound("largest CFL number", ">=", 20.0, "as in the plane"),
            ),
            run=partial(robust, kind),
        ),
    )


CASES = tuple(case for kind in KINDS for case in _cases(kind))
