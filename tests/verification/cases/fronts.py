"""The first Stokes problem."""

import math
from functools import partial

import numpy as np
from ngsolve import CF, erf, y

import ngvisco as nv
from ngvisco.forms.boundary.walls import Conditions
from ngvisco.geometries import box
from tests.verification.case import Cases, Curve, Outcome, Plot, measured
from tests.verification.problems import distance
from tests.verification.rates import RateTable
from tests.verification.setups import elastic, stokes

CASES = Cases("Exact solutions: layers and fronts")


def _stokes(creeping: bool) -> Outcome:
    """Viscosity 1e-2 Pa s, as a Stokes viscosity or as the creep of a Maxwell fluid (lambda = 1 ms)."""
    eta, top, begin, end = 1e-2, 0.1, 0.25, 1.0
    # exact fluid at t = 0.25 s: the wall's jump has become a layer of 0.05 m
    profile = top * erf(y / (2 * math.sqrt(eta * begin)))
    exact = top * erf(y / (2 * math.sqrt(eta * end)))
    table, curves = RateTable("error of v_1 at t = 1 s, relative to 0.1 m/s"), []
    ys = np.linspace(0.0, 1.0, 41)
    for steps in (5, 10, 20):
        model = nv.Model(
            material=elastic("linearised", *((20.0, 10.0) if creeping else (1e-6, 1e-6))),
            viscosity=None if creeping else stokes(eta),
            creep=nv.Creep(G_m=2 * eta) if creeping else None,
        )
        walls: Conditions = {"bottom": nv.NoSlip(), "top": nv.PrescribedTangential((top, 0.0))}
        # a Maxwell fluid starts with the stress of the layer it starts with
        slope = profile.Diff(y) * (eta / 20.0 if creeping else 0.0)
        E_0 = CF((0, slope, 0, slope, 0, 0, 0, 0, 0), dims=(3, 3))
        initial = nv.Initial(velocity=(profile, 0.0), values={"E": E_0})
        mesh = box((0.2, 1.0), 0.1, periodic="x")
        orders = nv.Discretisation(k=3, m=2)
        run = nv.Simulation(
            mesh, model, dt=(end - begin) / steps, walls=walls, initial=initial, discretisation=orders
        )
        run.run(end - begin)
        error = distance(run.fields["velocity"][0], exact, mesh) / (top * math.sqrt(0.2))
        table.add(run.dt, v=error)
        v = [run.fields["velocity"](mesh(0.05, min(s, 1 - 1e-12)))[0] for s in ys]
        curves.append(Curve(f"{steps} steps", ys, v, "."))
    curves.append(Curve("exact", ys, [top * math.erf(s / 0.2) for s in ys], "k-"))
    return measured(
        {
            "rate in tau": table.last("v"),
            "relative error, extrapolated": abs(2 * table.errors["v"][-1] - table.errors["v"][-2]),
        },
        table.table("tau, s"),
        Plot("First Stokes problem at t = 1 s", "y, m", "v_1, m/s", curves),
    )


for name, what, creeping in (
    ("viscous", "a fluid of Stokes viscosity", False),
    ("maxwell", "a Maxwell body in its fluid limit (relaxation time 1 ms)", True),
):
    CASES(f"""stokes-layer-{name}{" (reduced)" * (not creeping)}
        The first Stokes problem, v = 0.1 erf(x/(2 sqrt(mu t))), is met by {what}.
        label: Euler-small-viscoelastodyn+; benchmarks: first Stokes problem
        setting: Column of 0.2 m x 1 m, periodic in x, at rest below, 0.1 m/s above, rho = 1, mu = 1e-2 Pa s;
          from the exact layer at t = 0.25 s to t = 1 s in 5, 10, 20 steps; k = 3, m = 2, cells of 0.1 m.
        - rate in tau >= 0.85: implicit Euler
        - relative error, extrapolated <= 5e-3: one extrapolation, cells of 0.1 m
        - closure
        """)(partial(_stokes, creeping))
