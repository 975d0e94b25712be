"""A disc in rigid rotation, and Couette flow of a Maxwell fluid between cylinders."""

import math
from functools import partial

import numpy as np
from ngsolve import CF, x, y

import ngvisco as nv
from ngvisco.forms.boundary.walls import Conditions
from ngvisco.geometries import annulus, disc
from tests.verification.case import Cases, Curve, Outcome, Plot, Table, measured
from tests.verification.cases.rheology import NAMES
from tests.verification.problems import distance
from tests.verification.rates import RateTable
from tests.verification.setups import KINDS, around, closure, elastic, stokes

CASES = Cases("Exact solutions: rotation, Couette flow")

OMEGA = 1.0


def rotating(kind: str, h: float, steps: int) -> tuple[nv.Simulation, dict[str, float]]:
    """A quarter of a turn of a disc; the body force −Omega² x is its centripetal one.

    Returns the run and the L2 errors of v and of E or H, relative to the exact fields' norms (E: absolute).
    """
    until = 0.5 * math.pi / OMEGA
    law = nv.LinearElastic if kind == "linearised" else nv.ReferentialNeoHookean
    inwards = nv.Gravity((-(OMEGA**2) * x, -(OMEGA**2) * y))
    model = nv.Model(material=law(K_e=10.0, G_e=5.0), viscosity=stokes(0.1), loads=(inwards,))
    exact_v = CF((-OMEGA * y, OMEGA * x))
    run = nv.Simulation(
        disc(1.0, h), model, dt=until / steps, initial=nv.Initial(density=1.0, velocity=exact_v)
    )
    run.run(until)
    c, s = math.cos(OMEGA * until), math.sin(OMEGA * until)
    R = CF((c, -s, 0, s, c, 0, 0, 0, 1), dims=(3, 3))
    tensor, exact = (run.fields["E"], 0 * R) if kind == "linearised" else (run.fields["H"], R)
    error_v = distance(run.fields["velocity"], exact_v, run.mesh) / math.sqrt(math.pi / 2)
    return run, {"v": error_v, "z": distance(tensor, exact, run.mesh)}


def _rotation(kind: str) -> Outcome:
    """The linearised model over meshes and steps; the finite-strain model over steps."""
    tables, values = [], {}
    in_tau = RateTable("errors after a quarter of a turn, over tau, h = 0.4 m")
    for steps in (8, 16, 32):
        run, errors = rotating(kind, 0.4, steps)
        in_tau.add(run.dt, **errors)
    tables.append(in_tau.table("tau, s"))
    spread = max(in_tau.errors["v"]) / min(in_tau.errors["v"])
    values = {"error of v, largest / smallest over tau": spread}
    if kind == "finite":
        values["rate of H in tau"] = in_tau.last("z")
    else:
        in_h = RateTable("errors after a quarter of a turn, over h, 8 steps")
        for h in (0.8, 0.4, 0.2):
            run, errors = rotating(kind, h, 8)
            in_h.add(h, **errors)
        tables.append(in_h.table("h, m"))
        values |= {"rate of v in h": in_h.last("v"), "rate of E in h": in_h.last("z")}
    return measured({**values}, *tables, in_tau.plot("tau, s", "L2 error"))


for kind in KINDS:
    finite = kind == "finite"
    claim = (
        "F = R(t), to first order in tau" if finite else "E = 0 and v, up to the mesh's error, for any step"
    )
    rate = "H in tau >= 0.85: implicit Euler" if finite else "[v; E] in h >= 1.5: v.n = 0 on curved cells, P2"
    CASES(f"""rotation-{kind}{" (reduced)" * (not finite)}
        A disc in rigid rotation stays so: {claim}.
        label: {"ED-Euler-large2" if finite else "ZJ"}
        setting: Disc of radius 1 m with slip (curved cells), 1 turn in 2 pi s, K_e = 10 Pa, G_e = 5 Pa, K_v =
          G_v = 0.1 Pa s, centripetal body force; a quarter of a turn in 8, 16, 32 steps, h = 0.4
          m{"." if finite else "; and h = 0.8, 0.4, 0.2 m with 8 steps."}
        - rate of {rate}
        - error of v, largest / smallest over tau <= 1.1: the mesh's error alone, for any step
        - closure
        """)(partial(_rotation, kind))


COUETTE = {"linearised": (0.5, 0.25), "finite": (0.7, 0.35), "finite-b": (0.7, 0.35)}
"""Cell sizes, m: a finite-strain step costs ten times as much."""

R_I, R_O, TURN, MODULUS, ETA = 1.0, 2.0, 0.05, 10.0, 1.0


def _couette(kind: str) -> Outcome:
    """Steady shear stress between a resting and a rotating cylinder, at small Weissenberg number."""
    r = np.linspace(1.1, 1.9, 9)
    exact = 2 * ETA * TURN * R_O**2 / (R_O**2 - R_I**2) * R_I**2 / r**2
    curves, rows, errors = [], [], []
    for h in COUETTE[kind]:
        model = nv.Model(
            material=elastic(kind, 2 * MODULUS, MODULUS), viscosity=stokes(0.01), creep=nv.Creep(G_m=2 * ETA)
        )
        walls: Conditions = {"outer": nv.PrescribedTangential((-TURN * y, TURN * x)), "inner": nv.NoSlip()}
        mesh = annulus(R_I, R_O, h)
        run = nv.Simulation(mesh, model, dt=0.5, walls=walls, initial=nv.Initial(density=0.1))
        run.run(2.0)
        found = around(run, r)[1]
        errors.append(float(np.abs(found / exact - 1).max()))
        rows.append([h, mesh.ne, errors[-1], closure(run)])
        curves.append(Curve(f"h = {h:g} m", r, found, "o"))
    curves.append(Curve("closed form", r, exact, "k-"))
    return measured(
        {
            "largest relative error of the shear stress on the finer mesh": errors[-1],
            "error on the finer / on the coarser mesh": errors[-1] / errors[0],
        },
        Table("shear stress at nine radii", "h, m | cells | largest error | closure", rows),
        Plot("Couette flow between cylinders", "r, m", "shear stress, Pa", curves),
    )


for kind in NAMES:
    finite = kind != "linearised"
    CASES(f"""couette-{kind}
        The shear stress of a Maxwell fluid between cylinders in {NAMES[kind]} is eta times that of the closed
          form.
        label: {"Euler-small-flow-rule" if not finite else "ED-Euler-large3"}
        setting: Annulus of 1 and 2 m, the outer wall turns at 0.05/s, G = 10 Pa, eta = 1 Pa s (Wi = 0.01),
          density 0.1, 4 steps of 0.5 s; h = {COUETTE[kind][0]} and {COUETTE[kind][1]} m.
        - largest relative error of the shear stress on the finer mesh <= {0.04 if finite else 0.02}: P2
          velocity, P1 stress
        - error on the finer / on the coarser mesh <= 0.6: converges
        - closure
        """)(partial(_couette, kind))
