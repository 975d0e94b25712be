"""The paper's sequence of limits with all terms: tau -> 0, then delta -> 0, then epsilon -> 0."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import pairwise

from ngsolve import CoefficientFunction, Mesh

from ngvisco.run.simulation import Simulation
from ngvisco.verification.case import Bound, Case, Curve, Outcome, Plot
from ngvisco.verification.cases.whole_scheme import THEME, WHOLE, whole
from ngvisco.verification.problems import distance
from ngvisco.verification.rates import RateTable
from ngvisco.verification.setups import KINDS, closure, slope_line, square_mesh, state

DURATION = 0.08
MESHES = (0.35, 0.175)
STEPS = (8, 16, 32)
"""For tau; delta and epsilon go to zero with the middle one."""

SIZES = (1e-2, 1e-3, 1e-4)
DELTA = EPSILON = 1e-2
"""While tau goes to zero, and epsilon while delta does."""


def fields(run: Simulation) -> dict[str, CoefficientFunction]:
    """v, rho, z, the Cauchy stress, and at finite strain Pi and the Mandel stress."""
    u = run.rothe_step.now
    found = state(run) | {"T": run.fields["cauchy_stress"]}
    if "Pi" in u.parts:
        found |= {"Pi": u.Pi, "M": u.context.rates.mandel(u)}
    return found


def separation(one: Simulation, other: Simulation) -> dict[str, float]:
    """L2 distances of the ``fields`` of two runs on one mesh."""
    a, b = fields(one), fields(other)
    return {name: distance(a[name], b[name], one.mesh) for name in a}


def _against(runs: Sequence[tuple[float, Simulation]], limit: Simulation, title: str) -> RateTable:
    table = RateTable(title)
    for size, run in runs:
        table.add(size, **separation(run, limit))
    return table


def sequence(
    kind: str,
    meshes: Mapping[float, Mesh] | None = None,
    numbers: Sequence[int] = STEPS,
    sizes: Sequence[float] = SIZES,
) -> Outcome:
    """Limits in tau, in delta, and without it in epsilon, on meshes by their h, m."""
    meshes = meshes or {h: square_mesh(h) for h in MESHES}
    values: dict[str, float] = {}
    tables, plots, everything = [], [], []
    least: dict[str, dict[str, float]] = {}
    for h, mesh in meshes.items():

        def run_of(steps: int, delta: float, epsilon: float, mesh: Mesh = mesh) -> Simulation:
            run = whole(kind, DURATION / steps, mesh, delta, epsilon)
            run.run(DURATION)
            everything.append(run)
            return run

        at = f"h = {h:g} m, t = {DURATION:g} s"
        in_tau = [(DURATION / n, run_of(n, DELTA, EPSILON)) for n in numbers]
        tau = RateTable(f"tau: distance to the run with half the step, {at}")
        for (size, coarse), (_, fine) in pairwise(in_tau):
            tau.add(size, **separation(coarse, fine))
        steps = numbers[len(numbers) // 2]
        in_delta = [(delta, run_of(steps, delta, EPSILON)) for delta in sizes]
        without_delta = run_of(steps, 0.0, EPSILON)
        delta = _against(in_delta, without_delta, f"delta: distance to delta = 0, {at}")
        in_epsilon = [(epsilon, run_of(steps, 0.0, epsilon)) for epsilon in sizes]
        limit = run_of(steps, 0.0, 0.0)
        epsilon = _against(in_epsilon, limit, f"epsilon: distance to epsilon = 0, {at}")
        for name, table in (("tau", tau), ("delta", delta), ("epsilon", epsilon)):
            rates = {field: table.last(field) for field in table.errors}
            known = least.setdefault(name, rates)
            least[name] = {field: min(rates[field], known[field]) for field in rates}
            tables.append(table.table(name))
            if h == list(meshes)[-1]:
                plots.append(_plot(table, name))
    for name, rates in least.items():
        values |= {f"last rate of {field} in {name}": rate for field, rate in rates.items()}
    return Outcome(values=values | {"largest |closure|": closure(*everything)}, tables=tables, plots=plots)


def _plot(table: RateTable, name: str) -> Plot:
    plot = table.plot(name, "distance in L2")
    line: Curve = slope_line(table.sizes, table.errors["z"], RATES[name][0])
    return Plot(plot.title, plot.xlabel, plot.ylabel, [*plot.curves, line], log="xy")


RATES = {
    "tau": (0.8, "implicit Euler is of first order"),
    "delta": (0.45, "sqrt(delta): the stress of sqrt(delta)/2 |z|^2 and the size of the delta-terms"),
    "epsilon": (0.9, "terms and an approximation of first order in epsilon"),
}

LABELS: dict[str, dict[str, str]] = {
    "linearised": {
        "v": "Euler-small-converge-strong",
        "rho": "Euler-small-converge-strong",
        "z": "Euler-small-converge-strong",
        "T": "Euler-small-converge-strong+, Euler-small-converge-strong-T",
    },
    "finite": {
        "v": "Euler-large-converge",
        "rho": "Euler-large-converge",
        "z": "Euler-large-converge-strong-F",
        "T": "Euler-large-converge-strong+, Euler-large-converge-strong-T",
        "Pi": "Euler-large-converge-Lp, Euler-large-converge-strong-Lp",
        "M": "Euler-large-converge-strong-M",
    },
}


def bounds(kind: str) -> tuple[Bound, ...]:
    """Those of ``sequence``."""
    return (
        *(
            Bound(f"last rate of {field} in {name}", ">=", rate, f"{reason}; {label}")
            for name, (rate, reason) in RATES.items()
            for field, label in LABELS[kind].items()
        ),
        Bound("largest |closure|", "<=", 1e-10, "the tolerance of Newton's iteration"),
    )


def _case(kind: str) -> Case:
    return Case(
        name=f"whole-sequence-{kind}",
        theme=THEME,
        statement=f"With all terms of the scheme of {KINDS[kind]} at once its solutions converge as tau -> "
        "0; these, then, as delta -> 0 with epsilon kept; and those as epsilon -> 0: the paper's sequence.",
        label="Euler-small-viscoelastodyn+disc, Euler-small-converge+, Euler-small-viscoelastodyn+eps"
        if kind == "linearised"
        else "Euler-large-viscoelastodyn+disc, ED-Euler-large-polyconvex-eta, ED-Euler-large-polyconvex-eps",
        setting=f"{WHOLE}; h = 0.35 and 0.175 m, until {DURATION} s; {STEPS[0]} to {STEPS[-1]} steps with "
        f"delta = epsilon = {DELTA:g}, then {STEPS[1]} with delta from {SIZES[0]:g} to {SIZES[-1]:g}, "
        f"then delta = 0 with epsilon from {SIZES[0]:g} to {SIZES[-1]:g}.  The least rate of both "
        "meshes counts.",
        bounds=bounds(kind),
        run=partial(sequence, kind),
    )


CASES = tuple(_case(kind) for kind in KINDS)
