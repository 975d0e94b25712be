"""Couette flow of a Maxwell fluid between cylinders."""

from __future__ import annotations

from functools import partial

import numpy as np
from ngsolve import x, y

import ngvisco as nv
from ngvisco.forms.boundary.walls import Conditions
from ngvisco.geometries import annulus
from tests.verification.case import Bound, Case, Curve, Outcome, Plot, Table
from tests.verification.cases.flows import THEME
from tests.verification.cases.rheology import NAMES
from tests.verification.setups import CLOSURE, closure

COUETTE = {"linearised": (0.5, 0.25), "finite": (0.7, 0.35), "finite-b": (0.7, 0.35)}
"""Cell sizes, m: a finite-strain step costs ten times as much."""

R_I, R_O, TURN, MODULUS, ETA = 1.0, 2.0, 0.05, 10.0, 1.0


def _couette(kind: str) -> Outcome:
    """Steady shear stress between a resting and a rotating cylinder, at small Weissenberg number."""
    r = np.linspace(1.1, 1.9, 9)
    exact = 2 * ETA * TURN * R_O**2 / (R_O**2 - R_I**2) * R_I**2 / r**2
    angles = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    c, s = np.cos(angles), np.sin(angles)
    material: nv.Material = (
        nv.LinearElastic(K_e=2 * MODULUS, G_e=MODULUS)
        if kind == "linearised"
        else nv.ReferentialNeoHookean(
            K_e=2 * MODULUS, G_e=MODULUS / 2, elastic_state="B" if kind == "finite-b" else "F"
        )
    )
    curves, rows, runs, errors = [], [], [], []
    for h in COUETTE[kind]:
        model = nv.Model(
            material=material,
            viscosity=nv.StokesViscosity(K_v=0.01, G_v=0.01),
            creep=nv.Creep(G_m=2 * ETA),
        )
        walls: Conditions = {"outer": nv.PrescribedTangential((-TURN * y, TURN * x)), "inner": nv.NoSlip()}
        mesh = annulus(R_I, R_O, h)
        run = nv.Simulation(mesh, model, dt=0.5, walls=walls, initial=nv.Initial(density=0.1))
        run.run(2.0)
        runs.append(run)
        found = []
        for radius in r:
            T = run.fields["cauchy_stress"](mesh(radius * c, radius * s)).reshape(-1, 3, 3)
            found.append(float(np.mean(c * s * (T[:, 1, 1] - T[:, 0, 0]) + (c**2 - s**2) * T[:, 0, 1])))
        errors.append(float(np.abs(np.array(found) / exact - 1).max()))
        rows.append([h, mesh.ne, errors[-1], closure(run)])
        curves.append(Curve(f"h = {h:g} m", [float(v) for v in r], found, "o"))
    curves.append(Curve("closed form", [float(v) for v in r], [float(v) for v in exact], "k-"))
    return Outcome(
        values={
            "largest relative error of the shear stress on the finer mesh": errors[-1],
            "error on the finer / on the coarser mesh": errors[-1] / errors[0],
            "largest |closure|": closure(*runs),
        },
        tables=[Table("shear stress at nine radii", ["h, m", "cells", "largest error", "closure"], rows)],
        plots=[Plot("Couette flow between cylinders", "r, m", "shear stress, Pa", curves)],
    )


def _case(kind: str) -> Case:
    finite = kind != "linearised"
    return Case(
        name=f"couette-{kind}",
        theme=THEME,
        statement=f"The shear stress of a Maxwell fluid between cylinders in {NAMES[kind]} is eta times "
        f"that of the closed form.",
        label="Euler-small-flow-rule" if not finite else "ED-Euler-large3",
        setting="Annulus of 1 and 2 m, the outer wall turns at 0.05/s, G = 10 Pa, eta = 1 Pa s (Wi = 0.01), "
        f"density 0.1, 4 steps of 0.5 s; h = {COUETTE[kind][0]} and {COUETTE[kind][1]} m.",
        bounds=(
            Bound(
                "largest relative error of the shear stress on the finer mesh",
                "<=",
                0.04 if finite else 0.02,
                "P2 velocity, P1 stress",
            ),
            Bound("error on the finer / on the coarser mesh", "<=", 0.6, "converges"),
            CLOSURE,
        ),
        run=partial(_couette, kind),
    )


CASES = tuple(_case(kind) for kind in NAMES)
