"""Elastic layers and inclusions in shear, whose interfaces lie inside cells, against exact and conforming
stresses."""

from netgen.geom2d import SplineGeometry
from ngsolve import (
    BilinearForm,
    CoefficientFunction,
    GridFunction,
    InnerProduct,
    Mesh,
    Periodic,
    Sym,
    VectorH1,
    div,
    dx,
    grad,
    y,
)

import ngvisco as nv
from ngvisco.geometries import structured_box
from tests.verification.case import Cases, Measured, Table

CASES = Cases("Bodies and their interfaces")

BULK, RADIUS, SHEAR = 25.0, 0.3, 2e-3
"""Bulk modulus, Pa, radius of the disc, m, and shear of a box of 1 m."""
RATIO = 10.0
"""The stiffer over the softer shear modulus, which is 1 Pa in layers; a disc's matrix has 1 Pa."""
ROWS, SQUARES = (5, 9), (6, 9)
"""Rows of cells across layers, whose face lies in the middle of a row; squares across a box with a disc."""


def _body(name: str, G: float, layered: bool, where: CoefficientFunction | nv.Ball | None = None) -> nv.Body:
    material = nv.ReferentialNeoHookean(K_e=BULK, G_e=G / 2)
    thin = nv.StokesViscosity(K_v=1e-4, G_v=1e-4)
    return nv.Body(name=name, where=where, material=material, viscosity=thin, density=1e-5, layered=layered)


def _stress(mesh: Mesh, bodies: list[nv.Body], width: float) -> float:
    """Shear stress of a box over its shear, Pa, after one step; the box is 1 m high."""
    run = nv.Simulation(
        mesh,
        nv.Model(bodies=tuple(bodies)),
        dt=1.0,
        walls={"top": nv.PrescribedTangential((SHEAR, 0)), "bottom": nv.NoSlip()},
        discretisation=nv.Discretisation(k=2, m=1),
        newton=nv.NewtonOptions(tolerance=1e-11),
    )
    return float(run.run(1.0).column("power_wall_top")[-1] / (width * SHEAR**2))


def _of_layers(rows: int, layered: bool) -> float:
    """Stress of two layers of equal height over the exact stress."""
    bodies = [_body("low", 1.0, layered, 0.5 - y), _body("high", RATIO, layered)]
    mesh = structured_box((1 / rows, 1.0), (1, rows), periodic="x")
    return _stress(mesh, bodies, 1 / rows) * (0.5 + 0.5 / RATIO)


def _of_disc(squares: int, G: float, layered: bool) -> float:
    """Stress of a box, periodic across, with a disc of modulus G, Pa."""
    bodies = [_body("disc", G, layered, nv.Ball((0.5, 0.5), RADIUS)), _body("matrix", 1.0, layered)]
    return _stress(structured_box((1, 1), (squares, squares), periodic="x"), bodies, 1.0)


def _conforming(G: float, maxh: float = 0.08) -> float:
    """Stress of the box with a disc by linear elasticity with P_3 elements whose edges follow the circle."""
    geometry = SplineGeometry()
    corners = [geometry.AppendPoint(*at) for at in ((0, 0), (1, 0), (1, 1), (0, 1))]
    geometry.Append(["line", corners[0], corners[1]], bc="bottom")
    right = geometry.Append(["line", corners[1], corners[2]], bc="right")
    geometry.Append(["line", corners[2], corners[3]], bc="top")
    geometry.Append(["line", corners[0], corners[3]], bc="left", leftdomain=0, rightdomain=1, copy=right)
    geometry.AddCircle((0.5, 0.5), RADIUS, leftdomain=2, rightdomain=1)
    geometry.SetMaterial(1, "matrix")
    geometry.SetMaterial(2, "disc")
    mesh = Mesh(geometry.GenerateMesh(maxh=maxh))
    mesh.Curve(3)
    space = Periodic(VectorH1(mesh, order=3, dirichlet="bottom|top"))
    u, w = space.TnT()
    modulus = mesh.MaterialCF({"matrix": 1.0, "disc": G})
    form = BilinearForm(space)
    form += 2 * modulus * InnerProduct(Sym(grad(u)), Sym(grad(w))) * dx
    form += (BULK - 2 / 3 * modulus) * div(u) * div(w) * dx
    form.Assemble()
    moved = GridFunction(space)
    moved.Set((1, 0), definedon=mesh.Boundaries("top"))
    inverse = form.mat.Inverse(space.FreeDofs(), inverse="sparsecholesky")
    moved.vec.data -= inverse * (form.mat * moved.vec).Evaluate()
    return float(InnerProduct(moved.vec, (form.mat * moved.vec).Evaluate()))


@CASES(f"""layers
    Layered elastic bodies in one cell bear one shear traction: layers and discs whose interfaces lie inside
      cells bear the exact stress; with one strain rate they are too stiff.
    label: benchmark: layers in series; a disc by conforming elements
    setting: A box of 1 m is sheared by {SHEAR:g} in one step (K = {BULK:g} Pa, ratios of {RATIO:g}, k = 2,
      m = 1); layers on {ROWS[0]} and {ROWS[1]} rows, a disc of {RADIUS:g} m on {SQUARES[0]} x {SQUARES[0]}
      and {SQUARES[1]} x {SQUARES[1]} squares against conforming P_3 elements.
    - layers on {ROWS[0]} rows: stress over the exact one in [0.99, 1.01]: stated before the trials
    - layers on {ROWS[1]} rows: stress over the exact one in [0.99, 1.01]: stated before the trials
    - stiff disc, {SQUARES[0]} squares: stress over the conforming one in [0.95, 1.05]: half of before
    - stiff disc, {SQUARES[1]} squares: stress over the conforming one in [0.98, 1.02]: half of before
    - soft disc, {SQUARES[0]} squares: stress over the conforming one in [0.969, 1.031]: one rate's error
    - soft disc, {SQUARES[1]} squares: stress over the conforming one in [0.98, 1.02]: stated before trials
    - disc of the matrix's modulus: stress over the conforming one in [0.998, 1.002]: no interface is felt
    - control: one strain rate, layers on {ROWS[0]} rows, error >= 0.05: 9 %
    - closure
    """)
def _inclusions() -> Measured:
    table = []

    def compared(name: str, kind: str, layered: float, one_rate: float) -> tuple[str, float]:
        table.append([name, layered, one_rate])
        return f"{name}: stress over the {kind} one", layered

    of_layers = [[_of_layers(rows, layered) for layered in (True, False)] for rows in ROWS]
    for rows, found in zip(ROWS, of_layers, strict=True):
        yield compared(f"layers on {rows} rows", "exact", *found)
    for name, G in (("stiff disc", RATIO), ("soft disc", 1 / RATIO)):
        exact = _conforming(G)
        for squares in SQUARES:
            found = [_of_disc(squares, G, layered) / exact for layered in (True, False)]
            yield compared(f"{name}, {squares} squares", "conforming", *found)
    equal = [_of_disc(SQUARES[0], 1.0, layered) / _conforming(1.0) for layered in (True, False)]
    yield compared("disc of the matrix's modulus", "conforming", *equal)
    yield f"control: one strain rate, layers on {ROWS[0]} rows, error", abs(of_layers[0][1] - 1)
    yield Table("Stress over the exact or the conforming one", "problem | layered | one strain rate", table)
