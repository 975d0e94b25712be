"""The first Stokes problem, and a compression pulse with a steep front."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from ngsolve import CF, Det, erf, pi, sin, x, y

from ngvisco.forms.initial import Initial
from ngvisco.forms.spaces import Discretisation
from ngvisco.forms.walls import Conditions
from ngvisco.geometries import box
from ngvisco.physics.materials import LinearElastic, NeoHookean, ReferentialNeoHookean
from ngvisco.physics.model import Model
from ngvisco.physics.rheology import Creep, StokesViscosity
from ngvisco.physics.walls import NoSlip, PrescribedTangential
from ngvisco.run.simulation import Simulation
from ngvisco.verification.case import Bound, Case, Curve, Outcome, Plot, Table
from ngvisco.verification.problems import distance
from ngvisco.verification.rates import RateTable
from ngvisco.verification.setups import closure

THEME = "Exact solutions: layers and fronts"
CLOSURE = Bound("largest |closure|", "<=", 1e-10, "the tolerance of Newton's iteration")


def _stokes(creeping: bool) -> Outcome:
    """Viscosity 1e-2 Pa s, as a Stokes viscosity or as the creep of a Maxwell fluid (lambda = 1 ms)."""
    eta, top, begin, end = 1e-2, 0.1, 0.25, 1.0
    # exact fluid at t = 0.25 s: the wall's jump has become a layer of 0.05 m
    profile = top * erf(y / (2 * math.sqrt(eta * begin)))
    exact = top * erf(y / (2 * math.sqrt(eta * end)))
    table, curves, closures = RateTable("error of v_1 at t = 1 s, relative to 0.1 m/s"), [], []
    ys = np.linspace(0.0, 1.0, 41)
    for steps in (5, 10, 20):
        model = Model(
            material=LinearElastic(K_e=20.0, G_e=10.0) if creeping else LinearElastic(K_e=1e-6, G_e=1e-6),
            viscosity=None if creeping else StokesViscosity(K_v=eta, G_v=eta),
            creep=Creep(G_m=2 * eta) if creeping else None,
        )
        walls: Conditions = {"bottom": NoSlip(), "top": PrescribedTangential((top, 0.0))}
        # a Maxwell fluid starts with the stress of the layer it starts with
        slope = profile.Diff(y) * (eta / 20.0 if creeping else 0.0)
        E_0 = CF((0, slope, 0, slope, 0, 0, 0, 0, 0), dims=(3, 3))
        initial = Initial(velocity=(profile, 0.0), values={"E": E_0})
        mesh = box((0.2, 1.0), 0.1, periodic="x")
        orders = Discretisation(k=3, m=2)
        run = Simulation(
            mesh, model, dt=(end - begin) / steps, walls=walls, initial=initial, discretisation=orders
        )
        run.run(end - begin)
        error = distance(run.fields["velocity"][0], exact, mesh) / (top * math.sqrt(0.2))
        table.add(run.dt, v=error)
        closures.append(closure(run))
        v = [float(run.fields["velocity"](mesh(0.05, min(s, 1 - 1e-12)))[0]) for s in ys]
        curves.append(Curve(f"{steps} steps", [float(s) for s in ys], v, "."))
    points = [float(s) for s in ys]
    curves.append(Curve("exact", points, [top * math.erf(s / 0.2) for s in points], "k-"))
    return Outcome(
        values={
            "rate in tau": table.last("v"),
            "relative error, extrapolated": abs(2 * table.errors["v"][-1] - table.errors["v"][-2]),
            "largest |closure|": max(closures),
        },
        tables=[table.table("tau, s")],
        plots=[Plot("First Stokes problem at t = 1 s", "y, m", "v_1, m/s", curves)],
    )


def _pulse(kind: str) -> Outcome:
    """A pulse that steepens; rho J and rho det F should stay rho_0 = 1."""
    material = (
        NeoHookean(K_e=1.0, G_e=0.5, epsilon=0.5)
        if kind == "J and det F"
        else ReferentialNeoHookean(K_e=1.0, G_e=0.5)
    )
    table = RateTable("L2 distance to rho det F = rho_0 at t = 0.4 s")
    curves, closures, rows = [], [], []
    for cells, steps in ((10, 20), (20, 40), (40, 80), (80, 160)):
        mesh = box((1.0, 2 / cells), 1 / cells, periodic="xy")
        model = Model(material=material, viscosity=StokesViscosity(K_v=0.02, G_v=0.02))
        run = Simulation(mesh, model, dt=0.4 / steps, initial=Initial(velocity=(sin(2 * pi * x), 0.0)))
        rho, z = run.fields["density"], run.fields
        # det H of H = J^(-5/6) F is det F^(-3/2)
        det_F = Det(z["F"]) if "F" in z else Det(z["H"]) ** (-2 / 3)
        line = np.linspace(0.01, 0.99, 99)
        steepest, front, at, largest = 0.0, np.ones_like(line), 0.0, 0.0
        for _ in range(steps):
            run.advance()
            profile = rho(mesh(line, np.full_like(line, 0.5 / cells))).ravel()
            slope = float(np.abs(profile[2:] - profile[:-2]).max() / (line[2] - line[0]))
            largest = max(largest, distance(rho * det_F, CF(1.0), mesh) * math.sqrt(cells / 2))
            if slope > steepest:
                steepest, front, at = slope, profile, run.t
        defects = {
            "rho J": distance(rho * z["J"], CF(1.0), mesh),
            "rho det F": distance(rho * det_F, CF(1.0), mesh),
        }
        table.add(1 / cells, **{n: d * math.sqrt(cells / 2) for n, d in defects.items()})
        closures.append(closure(run))
        rows.append([1 / cells, float(run.ledger.column("rho_max").max()), steepest, at, largest])
        label = f"{cells} cells, t = {at:.2g} s"
        curves.append(Curve(label, [float(s) for s in line], [float(r) for r in front], "-"))
    return Outcome(
        values={
            "rate of rho J − rho_0 in h ~ tau": table.last("rho J"),
            "rate of rho det F − rho_0 in h ~ tau": table.last("rho det F"),
            "largest compression rho/rho_0": float(rows[-1][1]),
            "steepest slope of rho/rho_0, 1/m": float(rows[-1][2]),
            "largest |closure|": max(closures),
        },
        tables=[
            table.table("h, m"),
            Table(
                "the front, and the largest defect until 0.4 s",
                [
                    "h, m",
                    "max rho/rho_0",
                    "steepest slope, 1/m",
                    "at t, s",
                    "max of the L2 defect of rho det F",
                ],
                rows,
            ),
        ],
        plots=[Plot("Density of the pulse where it is steepest", "x, m", "kg/m3", curves)],
    )


CASES = (
    *(
        Case(
            name=f"stokes-layer-{name}",
            theme=THEME,
            statement=f"The first Stokes problem, v = 0.1 erf(x/(2 sqrt(mu t))), is met by {what}.",
            label="Euler-small-viscoelastodyn+; benchmarks: first Stokes problem",
            setting="Column of 0.2 m x 1 m, periodic in x, at rest below, 0.1 m/s above, rho = 1, mu = "
            "1e-2 Pa s; from the exact layer at t = 0.25 s to t = 1 s in 5, 10, 20 steps; k = 3, "
            "m = 2, cells of 0.1 m.",
            bounds=(
                Bound("rate in tau", ">=", 0.85, "implicit Euler"),
                Bound("relative error, extrapolated", "<=", 5e-3, "one extrapolation, cells of 0.1 m"),
                CLOSURE,
            ),
            run=partial(_stokes, creeping),
            reduced=not creeping,
        )
        for name, what, creeping in (
            ("viscous", "a fluid of Stokes viscosity", False),
            ("maxwell", "a Maxwell body in its fluid limit (relaxation time 1 ms)", True),
        )
    ),
    *(
        Case(
            name=f"pulse-{name}",
            theme=THEME,
            statement="In a strong compression pulse with a steep front rho det F stays rho_0 in the "
            f"limit, though rho and {what} are transported apart.",
            label="1/J-continuity-eq, DT-det-extended",
            setting="Periodic tube of 1 m, v = sin(2 pi x) m/s at first, K_e = 1 Pa, G_e = 0.5 Pa, K_v "
            "= G_v = 0.02 Pa s, until 0.4 s; 10, 20, 40, 80 cells with twice as many steps.",
            bounds=(
                Bound("rate of rho J − rho_0 in h ~ tau", ">=", 0.8, "first order in tau ~ h"),
                Bound("rate of rho det F − rho_0 in h ~ tau", ">=", 0.8, "first order in tau ~ h"),
                Bound("largest compression rho/rho_0", ">=", 1.5, "a strong pulse"),
                Bound("steepest slope of rho/rho_0, 1/m", ">=", 10.0, "a front: doubled over 0.1 m"),
                CLOSURE,
            ),
            run=partial(_pulse, what),
            explanation="Of the same start the referential material makes a strong pulse (rho/rho_0 = 1.8) "
            "but no front as steep as the neo-Hookean one: 6 in place of 36 1/m.",
        )
        for name, what in (("neo-hookean", "J and det F"), ("referential", "J and J^(-5/6) F"))
    ),
)
