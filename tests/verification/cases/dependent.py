"""Variables that depend on each other: J -> det F, H -> Cof F, A -> 1/J, K -> ln J/J as delta, tau, h -> 0.

The scheme transports them independently, as the paper does; they are consistent in the limit only.
"""

import math
from dataclasses import dataclass
from functools import partial
from typing import Any

from ngsolve import CF, CoefficientFunction, Cof, Det, cos, log, pi, sin, x, y, z

import ngvisco as nv
from ngvisco.physics.variables import Cofactor, Distortion, Jacobian, Values, Variable
from tests.verification.case import Cases, Outcome, measured
from tests.verification.problems import distance, refinements
from tests.verification.rates import RateTable
from tests.verification.setups import SETTING, block, square_mesh

CASES = Cases("Dependent variables")

COFACTORS = nv.MooneyRivlin(K_e=10.0, G_e=3.0, G_mr=2.0, epsilon=0.1, elastic_state="F")
LOGARITHMIC = nv.LogarithmicNeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1)
DURATION = 0.096
LEVELS = (0.8, 0.4, 0.2, 0.1)
STEP = 0.02
"""tau / h: the first waves take 0.3 s"""
DELTAS = (1e-1, 1e-2, 1e-3, 1e-4)


def defects(run: nv.Simulation) -> dict[str, float]:
    """L2 distances of each dependent variable and what it should be."""
    fields = run.fields
    pairs: dict[str, tuple[CoefficientFunction, CoefficientFunction]] = {}
    if "F" in fields:
        pairs["J - det F"] = fields["J"], Det(fields["F"])
        pairs["H - Cof F"] = fields["H"], Cof(fields["F"])
    else:  # H = J^(-5/6) F, so that det H = J^(-3/2) = A^(3/2)
        pairs["A - 1/J"] = fields["A"], Det(fields["H"]) ** (2 / 3)
        pairs["K - ln J/J"] = fields["K"], -fields["A"] * log(fields["A"])
    return {name: distance(a, b, run.mesh) for name, (a, b) in pairs.items()}


def _run(material: nv.Material, h: float, delta: float, **options: Any) -> nv.Simulation:
    """The block at its end, tau proportional to h."""
    law = nv.Regularisation(delta_density=delta, delta_fields=delta) if delta else None
    mesh = square_mesh(h)
    run = block("finite", STEP * h, mesh=mesh, of=material, regularisation=law, speed=0.5, **options)
    run.run(DURATION)
    return run


def in_h_and_tau(material: nv.Material, with_delta: bool) -> tuple[RateTable, list[nv.Simulation]]:
    """delta proportional to h^2."""
    what = "delta, tau and h" if with_delta else "tau and h"
    table, runs = RateTable(f"defects as {what} go to zero"), []
    for h in LEVELS[:3] if with_delta else LEVELS:
        run = _run(material, h, 0.1 * h * h if with_delta else 0.0)
        runs.append(run)
        table.add(h, **defects(run))
    return table, runs


def measure(material: nv.Material) -> Outcome:
    """The three refinements."""
    plain, runs = in_h_and_tau(material, with_delta=False)
    together, more = in_h_and_tau(material, with_delta=True)
    alone = RateTable("defects as delta alone goes to zero (beyond those of delta = 0)")
    rest = defects(runs[1])
    for delta in DELTAS:
        run = _run(material, LEVELS[1], delta)
        more.append(run)
        alone.add(delta, **{name: abs(value - rest[name]) for name, value in defects(run).items()})
    return measured(
        {
            **{f"last rate of {name}, tau and h": plain.last(name) for name in plain.errors},
            **{f"last rate of {name}, delta, tau and h": together.last(name) for name in together.errors},
            **{f"last rate of {name}, delta alone": alone.last(name) for name in alone.errors},
            "least J": min(_least(run) for run in runs),
        },
        plain.table("h, m"),
        together.table("h, m"),
        alone.table("delta, m2/s"),
        *[table.plot("h, m", "defect in L2", 1.0) for table in (plain, together)],
        *[
            "In plane strain H_33 is the only entry of Cof F that is not linear in F: both defects are "
            "one (in space they differ: dependent-cofactor-3d).  Of the coarsest mesh, two cells a "
            "side, no rate is to be taken."
        ]
        * ("J - det F" in plain.errors),
    )


def _least(run: nv.Simulation) -> float:
    values = [row["J_min"] for row in run.ledger.rows]
    return math.nan if any(map(math.isnan, values)) else min(values)


@dataclass(frozen=True)
class PrintedCofactor(Cofactor):
    """Cof F by the row that the paper prints, (Cof' F)(L F - F Pi), with F where ours has H."""

    def rate(self, z: Values, L: CoefficientFunction, Pi: CoefficientFunction) -> CoefficientFunction:
        F = z["F"]
        change = L * F - F * Pi
        return Cof(F + change) - Cof(F) - Cof(change)  # Cof is quadratic: its derivative


@dataclass(frozen=True, kw_only=True)
class PrintedMooneyRivlin(nv.MooneyRivlin):
    """With that row."""

    @property
    def variables(self) -> tuple[Variable, ...]:
        return (Distortion(), PrintedCofactor(), Jacobian())


@CASES(f"""dependent-cofactor-printed
    The row of H as it is printed, with F^k in it, and ours, with H^k, are two schemes of first order for one
      equation: their difference vanishes with their distances from Cof F.
    label: Euler-large-viscoelastodyn-H, H-flow-rule
    setting: {SETTING}; MooneyRivlin, creep with G_m = 2 Pa s, 0.5 m/s; h = 0.8, 0.4 and 0.2 m with tau = 0.02
      h, until {DURATION} s.
    - last rate of [difference; ours; printed] >= 0.8: first order in tau ~ h
    - difference over the sum of the defects <= 2.0: one, but for the two runs' own F
    - largest |closure| <= 1e-10: both rows are in the balance
    """)
def measure_printed() -> Outcome:
    """Two runs, by the printed row of H and by ours, as tau and h go to zero.

    By the coupled solver: the split one takes rates to be linear in the variables; the printed one is not.
    """
    table = RateTable("H of the two runs as tau and h go to zero")
    materials = COFACTORS, PrintedMooneyRivlin(K_e=10.0, G_e=3.0, G_mr=2.0, epsilon=0.1, elastic_state="F")
    for h in LEVELS[:3]:
        ours, printed = (_run(of, h, 0.0, creep=2.0, solver="coupled") for of in materials)
        table.add(
            h,
            difference=distance(ours.fields["H"], printed.fields["H"], ours.mesh),
            ours=defects(ours)["H - Cof F"],
            printed=defects(printed)["H - Cof F"],
        )
    return measured(
        {
            **{f"last rate of {name}": table.last(name) for name in table.errors},
            "difference over the sum of the defects": table.errors["difference"][-1]
            / (table.errors["ours"][-1] + table.errors["printed"][-1]),
        },
        table.table("h, m"),
        table.plot("h, m", "distance in L2"),
    )


for name, (a, b), label, of in (
    (
        "cofactor",
        ("J - det F", "H - Cof F"),
        "DT-det-extended, H-flow-rule, rem-polyconvex-general",
        COFACTORS,
    ),
    ("reciprocal", ("A - 1/J", "K - ln J/J"), "DT-det-inverse, exa-neo-Hookean-ref", LOGARITHMIC),
):
    CASES(f"""dependent-{name}
        {a} and {b} vanish as delta, tau and h go to zero, though each variable is transported on its own.
        label: {label}
        setting: {SETTING}; {type(of).__name__}, 0.5 m/s; h = 0.8, 0.4, 0.2 m with tau = 0.02 h and delta =
          0.1 h² or 0 (then also h = 0.1 m), until {DURATION} s; delta alone from 0.1 to 1e-4 at h = 0.4 m.
        - last rate of [{a}; {b}], tau and h >= 0.8: first order in tau ~ h
        - last rate of [{a}; {b}], delta, tau and h >= 0.8: first order in tau ~ h, and delta ~ h²
        - last rate of [{a}; {b}], delta alone >= 0.5: the size sqrt(delta) of the delta-terms
        - closure
        - least J >= 0.5: far from folding over
        """)(partial(measure, of))


SPATIAL = (
    sin(pi * x) * cos(pi * y) * cos(pi * z),
    cos(pi * x) * sin(pi * y) * cos(pi * z),
    -2 * cos(pi * x) * cos(pi * y) * sin(pi * z),
)
"""Free of divergence, with slip on the walls of the unit cube, and no plane motion."""


@CASES(f"""dependent-cofactor-3d
    In three dimensions J - det F and H - Cof F vanish as tau and h go to zero.
    label: DT-det-extended, H-flow-rule, rem-polyconvex-general
    setting: A cube of 1 m with slip, density 1 + 0.2 cos(pi x) kg/m3, MooneyRivlin with K_e = 10 Pa, K_v =
      G_v = 0.1 Pa s, v = 0.5 (sin cos cos, cos sin cos, -2 cos cos sin) m/s of pi x, pi y, pi z; 12, 96 and
      768 tetrahedra, h = 1, 0.5, 0.25 m, with 3, 6, 12 steps until {DURATION} s.
    - last rate of [J - det F; H - Cof F] >= 0.8: first order in tau ~ h
    - closure
    - least J >= 0.5: far from folding over
    """)
def measure_in_space() -> Outcome:
    """J - det F and H - Cof F as tau and h go to zero together, in three dimensions."""
    table, least = RateTable("defects as tau and h go to zero, in 3D"), []
    for h, mesh in refinements(3, 1.0, 3):
        initial = nv.Initial(density=1 + 0.2 * cos(pi * x), velocity=CF(tuple(0.5 * v for v in SPATIAL)))
        # the mesh is refined in place: everything of a run is read off at once
        run = block("finite", DURATION * h / 3, mesh=mesh, of=COFACTORS, initial=initial)
        run.run(DURATION)
        table.add(h, **defects(run))
        least.append(_least(run))
    return measured(
        {
            **{f"last rate of {name}": table.last(name) for name in table.errors},
            "least J": min(least),
        },
        table.table("h, m"),
        table.plot("h, m", "defect in L2", 1.0, "H - Cof F"),
        "Twelve tetrahedra do not see the motion; the rate is that of the other two meshes.",
    )
