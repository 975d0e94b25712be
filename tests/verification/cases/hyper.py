"""The role of hyperviscosity: mu -> 0, and exponents at which the analysis does not work (p <= 3)."""

from functools import partial

import numpy as np
from ngsolve import Integrate, Mesh

import ngvisco as nv
from ngvisco.forms.mesh.quadrature import Sampler
from ngvisco.physics.tensors import square
from tests.verification.case import Cases, Outcome, Table, measured
from tests.verification.rates import RateTable
from tests.verification.setups import KINDS, LABELS, SETTING, block, closure, separation, square_mesh

CASES = Cases("The role of hyperviscosity")

TAU, STEPS, MAXH = 0.02, 8, 0.35
SIZES = (1e-3, 1e-4, 1e-5, 1e-6)
MESHES = (0.5, 0.25, 0.125)
EXPONENTS = (1.5, 2.0, 2.5, 3.0, 3.5, 4.0)


def run_of(
    kind: str, law: nv.HyperViscosity | None, maxh: float = MAXH, mesh: Mesh | None = None, steps: int = STEPS
) -> nv.Simulation:
    """The block with this hyperviscosity after its steps."""
    run = block(kind, TAU, mesh=mesh or square_mesh(maxh), hyperviscosity=law, creep=2.0)
    run.run(steps * TAU)
    return run


def describe(run: nv.Simulation) -> list[float]:
    """Share of the energy that hyperviscosity took, int |grad v|^2, least rho, iterations, closure."""
    ledger = run.ledger
    energy = ledger.column("kinetic")[0]
    hyper = 0.0
    if run.model.hyperviscosity is not None:
        hyper = float(ledger.column("dissipation_hyper").sum() * TAU / energy)
    gradient = float(Integrate(square(run.rothe_step.now.grad_v), run.mesh, order=6)) ** 0.5
    iterations = float(np.mean(ledger.column("newton_iterations")[1:]))
    return [hyper, gradient, float(ledger.column("rho_min").min()), iterations, closure(run)]


def refinement(kind: str) -> Table:
    """The block on finer meshes, with p > 3, p <= 3 and without hyperviscosity."""
    rows: list[list[str | float]] = []
    for p in (4.0, 2.0, None):
        for h in MESHES:
            law = None if p is None else nv.HyperViscosity(mu=1e-4, p=p)
            run = run_of(kind, law, h)
            u = run.rothe_step.now
            _, steepest = Sampler(run.mesh, run.rothe_step.quadrature).extrema(square(u.grad_v))
            hyper, gradient, lowest, iterations, closes = describe(run)
            rows.append(
                ["none" if p is None else p, h, hyper, lowest, gradient, steepest**0.5, iterations, closes]
            )
    columns = "p | h, m | share of the energy | min rho | |∇v| in L2 | max |∇v| | Newton its | closure"
    return Table("refinement of h, mu = 1e-4", columns, rows)


def measure(kind: str) -> Outcome:
    """mu -> 0 for p = 2 and p = 4 against no hyperviscosity; then p from 1.5 to 4."""
    without = run_of(kind, None)
    rows: list[list[str | float]] = [["none", "", *describe(without)]]
    tables, plots, values = [], [], {}
    for p in (4.0, 2.0):
        table = RateTable(f"distance to mu = 0 at t = {STEPS * TAU:g} s, p = {p:g}")
        for mu in SIZES:
            run = run_of(kind, nv.HyperViscosity(mu=mu, p=p))
            rows.append([p, mu, *describe(run)])
            table.add(mu, **separation(run, without))
        values[f"last rate of v as mu -> 0, p = {p:g}"] = table.last("v")
        plots.append(table.plot("mu", "distance in L2", 1.0, "v"))
        tables.append(table.table("mu"))
    for p in EXPONENTS:
        run = run_of(kind, nv.HyperViscosity(mu=1e-3, p=p))
        rows.append([p, 1e-3, *describe(run)])
    refined = refinement(kind)
    columns = ["p", "mu", "share of the energy", "|∇v| in L2", "min rho", "Newton its", "closure"]
    return measured(
        {
            **values,
            "smallest rho": min(float(r[i]) for table, i in ((rows, 4), (refined.rows, 3)) for r in table),
        },
        *tables,
        Table("all runs", columns, rows),
        refined,
        *plots,
        "The analysis needs p > 3, so that grad v is bounded in L1(I; L-infinity) and rho, J stay "
        "positive; the scheme runs, and its ledger closes, with any p > 1 and without hyperviscosity. "
        "The last table refines h: what is bounded without it on this problem, which the analysis says "
        "nothing of.",
    )


for kind in KINDS:
    CASES(f"""hyperviscosity-{kind}
        In {KINDS[kind]} runs with mu -> 0 go to the run without hyperviscosity, and the energy closes for
          exponents p <= 3 too, where the analysis does not apply.
        label: Euler-small-viscoelastodyn+1, {LABELS[kind]}
        setting: {SETTING}, creep with G_m = 2 Pa s; cells of {MAXH} m, {STEPS} steps of {TAU} s; mu = 1e-3 to
          1e-6 with p = 4 and 2, p = 1.5 to 4 with mu = 1e-3, and cells of 0.5 to 0.125 m with mu = 1e-4.
        - last rate of v as mu -> 0, p = 4 >= 0.8: a smooth solution on a fixed mesh: its size
        - last rate of v as mu -> 0, p = 2 >= 0.8: a smooth solution on a fixed mesh: its size
        - closure
        - smallest rho >= 0.3: positive, with distance
        """)(partial(measure, kind))
