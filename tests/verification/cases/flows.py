"""Transport alone, and rigid rotation in a disc."""

from __future__ import annotations

import math
from functools import partial

from ngsolve import CF, Mesh, cos, sin, x, y
from ngsolve.meshes import MakeStructured2DMesh

import ngvisco as nv
from ngvisco.geometries import disc
from tests.verification.case import Bound, Case, Curve, Outcome, Plot
from tests.verification.problems import distance
from tests.verification.rates import RateTable
from tests.verification.setups import CLOSURE, KINDS, closure

THEME = "Exact solutions: transport, rotation, Couette flow"
WEAK = 1e-9
"""Moduli so small that nothing disturbs the uniform flow, Pa."""

PROFILE = 0.2


def strip(n: int) -> Mesh:
    """1 m x 0.5 m, periodic in both directions, of n x n/2 squares cut in two."""
    return MakeStructured2DMesh(
        quads=False, nx=n, ny=n // 2, periodic_x=True, periodic_y=True, mapping=lambda x, y: (x, 0.5 * y)
    )


def travelling(
    kind: str, m: int, n: int, steps: int, until: float = 0.2
) -> tuple[nv.Simulation, float, float]:
    """A profile 1 + 0.2 sin(2 pi x) of density and E_11 or J, carried at 1 m/s through a periodic strip.

    Returns the run and its errors against the exact profile with the implicit step's own factor
    1/(1 + i k tau), so that what remains is the error in space.
    """
    k = 2 * math.pi
    wave = 1 + PROFILE * sin(k * x)
    if kind == "linearised":
        material: nv.Material = nv.LinearElastic(K_e=WEAK, G_e=WEAK)
        values = {"E": CF((wave - 1, 0, 0, 0, 0, 0, 0, 0, 0), dims=(3, 3))}
    else:
        material, values = nv.BarotropicFluid(B=WEAK, gamma=1.4), {"J": wave}
    run = nv.Simulation(
        strip(n),
        nv.Model(material=material, viscosity=nv.StokesViscosity(K_v=10.0, G_v=10.0)),
        dt=until / steps,
        initial=nv.Initial(density=wave, velocity=(CF(1.0), 0.0), values=values),
        discretisation=nv.Discretisation(m=m),
    )
    run.run(until)
    factor = (1 / (1 + 1j * k * run.dt)) ** steps
    # sin(k x) is the imaginary part of exp(i k x)
    exact = 1 + PROFILE * (factor.real * sin(k * x) + factor.imag * cos(k * x))
    carried = run.fields["E"][0, 0] + 1 if kind == "linearised" else run.fields["J"]
    root = math.sqrt(0.5)
    return (
        run,
        distance(run.fields["density"], exact, run.mesh) / root,
        distance(carried, exact, run.mesh) / root,
    )


def _travelling(kind: str) -> Outcome:
    values, tables, plots, runs = {}, [], [], []
    for m in (0, 1, 2):
        table = RateTable(f"error in space of a travelling profile, m = {m}")
        for n in (4, 8, 16):
            run, rho, z = travelling(kind, m, n, 5)
            runs.append(run)
            table.add(1 / n, rho=rho, z=z)
        values[f"rate of rho, m = {m}"] = table.last("rho")
        values[f"rate of z, m = {m}"] = table.last("z")
        tables.append(table.table("h, m"))
        plots.append(table.plot("h, m", "error in L2"))
    curves = [Curve(f"{t.title[-5:]}", t.curves[0].x, t.curves[0].y) for t in plots]
    return Outcome(
        values={**values, "largest |closure|": closure(*runs)},
        tables=tables,
        plots=[Plot("Travelling profile: error of the density", "h, m", "L2", curves, log="xy")],
    )


OMEGA = 1.0


def rotating(kind: str, h: float, steps: int) -> tuple[nv.Simulation, dict[str, float]]:
    """A quarter of a turn of a disc; the body force −Omega² x is its centripetal one.

    Returns the run and the L2 errors of v and of E or H, relative to the exact fields' norms (E: absolute).
    """
    until = 0.5 * math.pi / OMEGA
    if kind == "linearised":
        material: nv.Material = nv.LinearElastic(K_e=10.0, G_e=5.0)
    else:
        material = nv.ReferentialNeoHookean(K_e=10.0, G_e=5.0)
    model = nv.Model(
        material=material,
        viscosity=nv.StokesViscosity(K_v=0.1, G_v=0.1),
        loads=(nv.Gravity((-(OMEGA**2) * x, -(OMEGA**2) * y)),),
    )
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
    runs, tables, values = [], [], {}
    in_tau = RateTable("errors after a quarter of a turn, over tau, h = 0.4 m")
    for steps in (8, 16, 32):
        run, errors = rotating(kind, 0.4, steps)
        runs.append(run)
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
            runs.append(run)
            in_h.add(h, **errors)
        tables.append(in_h.table("h, m"))
        values |= {"rate of v in h": in_h.last("v"), "rate of E in h": in_h.last("z")}
    return Outcome(
        values={**values, "largest |closure|": closure(*runs)},
        tables=tables,
        plots=[in_tau.plot("tau, s", "L2 error")],
    )


def _cases(kind: str) -> tuple[Case, ...]:
    finite = kind == "finite"
    carried = "J" if finite else "E"
    travel = Case(
        name=f"travelling-{kind}",
        theme=THEME,
        statement=f"A smooth profile of rho and {carried} in uniform flow is carried with order m + 1/2 "
        f"at least.",
        label="Euler-small-viscoelastodyn+0disc, " + ("DT-det-extended" if finite else "ZJ"),
        setting="Strip of 1 m x 0.5 m, periodic, v = 1 m/s, profile 1 + 0.2 sin(2 pi x), moduli of 1e-9 "
        "Pa, viscosity 10 Pa s (which holds v uniform); "
        "until 0.2 s in 5 steps; nested meshes of 4, 8, 16 cells a metre; the exact profile has the "
        "implicit step's own damping.",
        bounds=(
            *(
                Bound(f"rate of {what}, m = {m}", ">=", m + 0.5, "theory of upwind transport; m + 1 is usual")
                for m in (0, 1, 2)
                for what in ("rho", "z")
            ),
            CLOSURE,
        ),
        run=partial(_travelling, kind),
        reduced=not finite,
    )
    kept = Bound("error of v, largest / smallest over tau", "<=", 1.1, "the mesh's error alone, for any step")
    if finite:
        error: tuple[Bound, ...] = (Bound("rate of H in tau", ">=", 0.85, "implicit Euler"), kept)
    else:
        error = (
            Bound("rate of v in h", ">=", 1.5, "v.n = 0 on curved cells, P2"),
            Bound("rate of E in h", ">=", 1.5, "v.n = 0 on curved cells, P2"),
            kept,
        )
    rotation = Case(
        name=f"rotation-{kind}",
        theme=THEME,
        statement="A disc in rigid rotation stays so: "
        + (
            "F = R(t), to first order in tau."
            if finite
            else "E = 0 and v, up to the mesh's error, for any step."
        ),
        label="ED-Euler-large2" if finite else "ZJ",
        setting="Disc of radius 1 m with slip (curved cells), 1 turn in 2 pi s, K_e = 10 Pa, G_e = 5 Pa, "
        "K_v = G_v = 0.1 Pa s, centripetal body force; a quarter of a turn in 8, 16, 32 steps, h = 0.4 m"
        + ("." if finite else "; and h = 0.8, 0.4, 0.2 m with 8 steps."),
        bounds=(*error, CLOSURE),
        run=partial(_rotation, kind),
        reduced=not finite,
    )
    return travel, rotation


CASES = tuple(case for kind in KINDS for case in _cases(kind))
