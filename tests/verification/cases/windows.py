"""Bodies under stress between windows: matter that crosses an open wall does not push them."""

import warnings
from typing import Any, Literal

import numpy as np
from netgen.occ import Circle, OCCGeometry, WorkPlane
from ngsolve import BND, CF, BoundaryFromVolumeCF, Integrate, Mesh, cos, exp, specialcf, sqrt, x, y, z
from scipy.signal import residue

import ngvisco as nv
from ngvisco.forms.boundary.walls import Conditions
from ngvisco.geometries import annulus, box, structured_box
from tests.verification.case import Cases, Measured, Table
from tests.verification.setups import elastic, fluid, followed, stokes

CASES = Cases("Bodies and their interfaces")

BULK, SHEAR = 10.0, 5.0


def _solid(kind: str) -> nv.Material:
    if kind == "E":
        return nv.LinearElastic(K_e=BULK, G_e=SHEAR)
    return nv.ReferentialNeoHookean(K_e=BULK, G_e=SHEAR, elastic_state="F" if kind == "F" else "B")


def _momentum(run: nv.Simulation) -> np.ndarray:
    return np.array(Integrate(run.fields["density"] * run.fields["velocity"], run.mesh))


def _carried_out(run: nv.Simulation) -> float:
    """Flux of the momentum along the bar through the windows, N."""
    v, n = run.fields["velocity"], specialcf.normal(run.mesh.dim)
    return float(Integrate(BoundaryFromVolumeCF(run.fields["density"]) * v[0] * (v * n), run.mesh, BND))


RUNS: list[tuple[str, Any, Any, int]] = (
    [("E", scheme, "split", 2) for scheme in ("backward-euler", "midpoint", "sdirk2")]
    + [(kind, scheme, "split", 2) for kind in ("F", "B") for scheme in ("backward-euler", "midpoint")]
    + [(kind, "backward-euler", "coupled", 2) for kind in "EFB"]
    + [("E", "backward-euler", "split", 3), ("B", "midpoint", "split", 3)]
)


@CASES("""bar-pulled-at-both-ends
    A bar, pulled at both ends by equal tractions, stays in its place, although matter enters at the ends.
    label: none, Newton's third law
    setting: A bar of 1 x 0.55 m (3D: x 0.5 m) between slip and Open walls with a traction of 0.5 Pa, K_e =
      10, G_e = 5 Pa, K_v = G_v = 0.3 Pa s, density 1; an unstructured mesh that is no mirror image of
      itself, cells of 0.23 m (3D: 0.6 m), steps of 0.05 s until 5 s. The impulse of sound is traction x
      area x length/c.
    - change of the momentum along the bar, over the impulse of sound <= 1e-4: matter carries this
      momentum through the windows while the bar is set in motion; with values of rest at the ends it was 5e-2
      and grew as exp(t/2)
    - change of the momentum by backward Euler plus the momentum carried out, over the impulse of sound
      <= 1e-8: nothing pushes
    - change of the momentum from 3 s to 5 s, over the impulse of sound <= 1e-8: nothing pushes
    - closure
    """)
def _bar() -> Measured:
    c, pull, rows = (BULK + 4 / 3 * SHEAR) ** 0.5, 0.5, []
    for kind, scheme, solver, dim in RUNS:
        size = (1.0, 0.55, 0.5)[:dim]
        run = nv.Simulation(
            box(size, 0.23 if dim == 2 else 0.6),
            nv.Model(material=_solid(kind), viscosity=stokes(0.3)),
            time=nv.TimeSteps(dt=0.05, scheme=scheme),
            walls={("left", "right"): nv.Open(pressure=-pull, backflow=False)},
            initial=nv.Initial(density=1.0),
            solver=solver,
        )
        impulse, found = pull * np.prod(size[1:]) / c, []
        _, carried = followed(run, 60, _carried_out)
        found.append(_momentum(run)[0] / impulse)
        run.run(5.0)
        found.append(_momentum(run)[0] / impulse)
        rest = found[0] + 0.05 * carried[1:].sum() / impulse if scheme == "backward-euler" else 0.0
        rows.append([kind, scheme, solver, f"{dim}D", found[1], rest, found[1] - found[0]])
    of_sound = "over the impulse of sound"
    yield f"change of the momentum along the bar, {of_sound}", max(abs(row[4]) for row in rows)
    yield (
        f"change of the momentum by backward Euler plus the momentum carried out, {of_sound}",
        max(abs(row[5]) for row in rows),
    )
    yield f"change of the momentum from 3 s to 5 s, {of_sound}", max(abs(row[6]) for row in rows)
    heads = "by | scheme | solver | space | at 5 s | without what is carried | from 3 s"
    yield Table(f"momentum, {of_sound}", heads, rows)


INNER, OUTER, PRESSED = 1.0, 2.0, 0.02


def _ring(is_whole: bool, maxh: float) -> Mesh:
    """A ring, or a quarter of a ring between the axes, with curved cells."""
    ring = Circle((0, 0), OUTER).Face() - Circle((0, 0), INNER).Face()
    if not is_whole:
        ring = ring * WorkPlane().Rectangle(2 * OUTER, 2 * OUTER).Face()
    for edge in ring.edges:
        ends = [(p.x, p.y) for p in (edge.start, edge.end)]
        edge.name = "outer" if np.hypot(*ends[0]) > (INNER + OUTER) / 2 else "inner"
        if not is_whole and any(max(abs(end[i]) for end in ends) < 1e-9 for i in (0, 1)):
            edge.name = "axis"
    mesh = Mesh(OCCGeometry(ring, dim=2).GenerateMesh(maxh=maxh))
    return mesh.Curve(2)


@CASES("""ring-under-pressure
    A quarter of a ring under internal pressure widens by Lame's formula; a whole ring does so, and stays in
    its place.
    label: Lame 1852
    setting: Radii 1 and 2 m, pressure 0.02 Pa inside, linear elastic, K_e = 10, G_e = 5 Pa, K_v = G_v = 1
      Pa s, plane strain; Open walls inside and outside, slip on the axes; cells of 0.4 m (whole: 0.5 m),
      steps of 0.5 s until 40 s.
    - relative error of the widening of the inner wall, [quarter; whole] <= 0.01: cells of a third of the
      radius
    - error of rest: largest velocity at the end of the quarter, m/s <= 1e-9: at rest
    - distance that the whole ring goes in 20 s, over its widening <= 1e-3: it stays
    - closure
    """)
def _ring_under_pressure() -> Measured:
    share = PRESSED * INNER**2 / (OUTER**2 - INNER**2)
    wanted, rows = share * (INNER / (2 * (BULK + SHEAR / 3)) + OUTER**2 / (2 * SHEAR * INNER)), []
    for name, maxh in (("quarter", 0.4), ("whole", 0.5)):
        mesh = _ring(name == "whole", maxh)
        run = nv.Simulation(
            mesh,
            nv.Model(material=_solid("E"), viscosity=stokes(1.0)),
            dt=0.5,
            walls={"inner": nv.Open(pressure=PRESSED, stiffness=(1e-12, 0.0)), "outer": nv.Open()},
            initial=nv.Initial(density=1.0),
        )
        run.run(20.0)
        _, velocities = followed(run, 40, lambda run: _momentum(run) / run.ledger.column("mass")[-1])
        gone = 0.5 * float(np.linalg.norm(velocities[1:].sum(axis=0))) / wanted
        outward, inner = run.fields["displacement_inner"] * CF((x, y)) / INNER, mesh.Boundaries("inner")
        length, total = Integrate(CF((1.0, outward)), mesh, BND, definedon=inner)
        rows.append([name, total / length, wanted, run.ledger.column("v_max")[-1], gone])
    for name, widening, *_ in rows:
        yield f"relative error of the widening of the inner wall, {name}", abs(widening / wanted - 1)
    yield "error of rest: largest velocity at the end of the quarter, m/s", rows[0][3]
    yield "distance that the whole ring goes in 20 s, over its widening", rows[1][4]
    yield Table("the inner wall, m", "ring | widening | exact | v_max, m/s | way over widening", rows)


@CASES("""stretched-between-windows
    A block with open sides, stretched by a piston to twice its length, has the stress of uniaxial tension.
    label: none, neo-Hookean uniaxial tension
    setting: A cube of 1 m, held by slip on three sides, pulled by PrescribedNormal at 0.1 m/s on the
      fourth, the other two Open: the matter goes out through the piston's window and comes in through the
      sides'. Shear modulus 1 Pa, K_e = 400 Pa, by F and by B, density 1e-3; 12 tetrahedra, 40 steps of the
      midpoint rule until the stretch is 2.
    - stress along the pull, Pa, off 3.5 by [F; B] <= 0.07: lambda^2 - 1/lambda of the incompressible one;
      0.39 was found with values of rest at the sides
    - error of the stress across the pull, Pa <= 0.035: the sides are free
    - closure
    """)
def _stretched() -> Measured:
    rate, rows = 0.1, []
    until = float(np.log(2)) / rate
    for kind in "FB":
        material = nv.ReferentialNeoHookean(K_e=400.0, G_e=0.5, elastic_state="F" if kind == "F" else "B")
        walls: Conditions = {"right": nv.PrescribedNormal(velocity=rate), ("back", "top"): nv.Open()}
        run = nv.Simulation(
            box((1, 1, 1), 0.9),
            nv.Model(material=material, viscosity=stokes(0.01)),
            time=nv.TimeSteps(dt=until / 40, scheme="midpoint"),
            walls=walls,
            initial=nv.Initial(density=1e-3, velocity=(rate * x, -rate / 2 * y, -rate / 2 * z)),
        )
        run.run(until)
        for place in ((0.5, 0.5, 0.5), (0.9, 0.95, 0.5), (0.5, 0.1, 0.95)):
            T = run.fields["cauchy_stress"](run.mesh(*place))
            rows.append([kind, *map(str, place), T[0], max(abs(T[4]), abs(T[8]))])
    for kind in "FB":
        yield (
            f"stress along the pull, Pa, off 3.5 by {kind}",
            max(abs(row[4] - 3.5) for row in rows if row[0] == kind),
        )
    yield "error of the stress across the pull, Pa", max(row[5] for row in rows)
    yield Table("stress at the end, Pa", "by | x | y | z | along | across", rows)


@CASES("""maxwell-body-that-comes-in (reduced)
    Pure shear of a Maxwell body is uniform, also at inlets.
    label: none, Maxwell 1867
    setting: A square of 1 m whose walls are Inflow by (x, -y)/s: matter comes in above and below. K_e = 200
      MPa, G_m = 2 G_e = 200 MPa, a Maxwell time of 1 s; cells of 0.5 m, 80 steps of midpoint until 8 s.
      Half the difference of the normal stresses is 2 eta x rate (1 - exp(-t/lambda)) = 199.93 MPa.
    - relative error of half the difference of the normal stresses at [the middle; the inlet; the outlet]
      <= 1e-4: the midpoint rule; 0.051 at an inlet of values of rest
    - closure
    """)
def _maxwell() -> Measured:
    model = nv.Model(material=nv.LinearElastic(K_e=2e8, G_e=1e8), creep=nv.Creep(G_m=2e8))
    flow: Any = (x, -y)
    run = nv.Simulation(
        box((1, 1), 0.5),
        model,
        time=nv.TimeSteps(dt=0.1, scheme="midpoint"),
        walls={("left", "right", "bottom", "top"): nv.Inflow(velocity=flow)},
        initial=nv.Initial(density=1.0, velocity=flow),
    )
    run.run(8.0)
    exact, rows = 200.0 * (1 - np.exp(-8.0)), []
    for name, place in (("the middle", (0.5, 0.5)), ("the inlet", (0.5, 0.98)), ("the outlet", (0.98, 0.3))):
        T = np.array(run.fields["cauchy_stress"](run.mesh(*place))) / 1e6
        rows.append([name, (T[0] - T[4]) / 2, exact])
        found = abs(rows[-1][1] / exact - 1)
        yield f"relative error of half the difference of the normal stresses at {name}", found
    yield Table("after 8 Maxwell times", "place | MPa | exact", rows)


PLATE, FOUNDATION = (200e3, 30e3), 3300 * 9.81
"""Half a wave and the thickness, m; weight of the displaced matter below, Pa/m."""
K_PLATE, G_PLATE, YEAR = 1e11, 5e10, 3.15576e7


def _plate(eta: float, times: np.ndarray) -> np.ndarray:
    """Heights of the lower and upper face at the crest of the load, divided by the load, m/Pa, at times in
    years.

    Equal loads s cos(q x) on both faces of a layer move the faces by C a s, and opposite loads +-s cos(q x)
    by C c s (Airy 1863), where 1/C is the modulus of plane strain. In the Laplace transform, with the
    relaxation time as unit of time, G is replaced by the modulus of Maxwell's body.
    """
    q, height = np.pi / PLATE[0], PLATE[1]
    a = 2 / q * (np.cosh(q * height) - 1) / (np.sinh(q * height) + q * height)
    c = 2 / q * (np.cosh(q * height) + 1) / (np.sinh(q * height) - q * height)
    above = np.array([K_PLATE + 4 / 3 * G_PLATE, K_PLATE])  # the ratio above/below is C (s + 1)
    above, below = np.polymul([1, 1], above), 4 * G_PLATE * np.array([K_PLATE + G_PLATE / 3, K_PLATE, 0])
    bent = np.polyadd(below, (a + c) / 2 * FOUNDATION * above)
    lower = -(c - a) / 2 * above, np.polymul(bent, [1, 0])
    rest = np.polyadd((a + c) / 2 * bent, -((a - c) ** 2) / 4 * FOUNDATION * above)
    upper = np.polymul(-above, rest), np.polymul(np.polymul(below, bent), [1, 0])
    found = []
    for over, under in (lower, upper):
        shares, roots, _ = residue(over, under)
        t, value, power = times * YEAR * G_PLATE / eta, np.zeros(len(times)), 0
        for i, (share, root) in enumerate(zip(shares.real, roots.real, strict=True)):
            power = power + 1 if i and abs(root - roots[i - 1]) < 1e-6 else 0
            value = value + share * t**power * np.exp(root * t)
        found.append(value)
    return np.array(found).T


@CASES(f"""plate-on-a-foundation
    A plate on an elastic foundation sinks under a load, first like an elastic body, and then relaxes towards
      the load over the foundation's stiffness; the face without springs also has a field of displacement.
    label: none, Airy 1863
    setting: Half a wave of {PLATE[0] / 1e3:g} km of a plate of {PLATE[1] / 1e3:g} km, K_e = 100, G_e = 50
      GPa, viscosity 1e21 or 1e25 Pa s, between slip walls; Open above under a pressure p cos(pi x/L), and
      below with springs of 3300 kg/m3 x 9.81 m/s2; 6 x 2 x 2 triangles, steps of 500 years of SDIRK2 until
      4000 years (1e25 Pa s: 1000 years), so long that it is quasi-static.
    - relative error of the sinking of the [lower; upper] face under 5 MPa <= 0.005: steps of two
      thirds of the fastest time, half a percent of the thickness
    - relative error of the sinking of the [lower; upper] face under 50 MPa <= 0.051: the closed form
      neglects the displacement over the thickness
    - closure
    """)
def _plate_on_a_foundation() -> Measured:
    worst, rows = dict[tuple[str, float], float](), []
    for load in (5e6, 50e6):
        for eta, until in ((1e21, 4000), (1e25, 1000)):
            run = nv.Simulation(
                structured_box(PLATE, (6, 2)),
                nv.Model(material=nv.LinearElastic(K_e=K_PLATE, G_e=G_PLATE), creep=nv.Creep(G_m=2 * eta)),
                time=nv.TimeSteps(dt=500 * YEAR, scheme="sdirk2"),
                walls={
                    "top": nv.Open(pressure=load * cos(np.pi / PLATE[0] * x), displacement=True),
                    "bottom": nv.Open(stiffness=(FOUNDATION, 0.0)),
                },
                initial=nv.Initial(density=3300.0),
            )
            _, heights = followed(run, until // 500, _crests)
            years = run.ledger.column("time") / YEAR
            for row in zip(years[1:], heights[1:], load * _plate(eta, years[1:]), strict=True):
                for face, found, wanted in zip(("lower", "upper"), *row[1:], strict=True):
                    worst[face, load] = max(worst.get((face, load), 0.0), abs(found / wanted - 1))
            last = zip(("lower", "upper"), heights[-1], load * _plate(eta, years[-1:])[0], strict=True)
            rows += [[f"{eta:g}", load / 1e6, years[-1], *face] for face in last]
    for (face, load), found in worst.items():
        yield f"relative error of the sinking of the {face} face under {load / 1e6:g} MPa", found
    yield Table("the load's crest", "viscosity, Pa s | MPa | years | face | m | exact", rows)


def _crests(run: nv.Simulation) -> list[float]:
    """The cosine's amplitudes in the displacements of the lower and the upper face, m."""
    wave = cos(np.pi / PLATE[0] * x)
    return [
        2 / PLATE[0] * Integrate(run.fields[f"displacement_{name}"][1] * wave, run.mesh.Boundaries(name))
        for name in ("bottom", "top")
    ]


REBOUND, BULK_OF_ROCK = 2 * np.pi, 100.0
"""Wave number of a load, 1/m; bulk modulus, Pa, of a half-space with G = 1 Pa and a Maxwell time of 1 s."""


def _rebound(times: np.ndarray) -> np.ndarray:
    """Depth by which a half-space sinks under the load p cos(k x) since t = 0, divided by p/k, on springs of
    k Pa/m that represent its weight.

    In the Laplace transform the surface has the stiffness 2 k mu (lambda + mu)/(lambda + 2 mu), with the mu =
    s/(1 + s) of Maxwell's body (Wu and Peltier 1982).
    """
    # these are the coefficients of (lambda + 2 mu) (1 + s)
    waves = np.array([BULK_OF_ROCK + 4 / 3, BULK_OF_ROCK])
    stiff = 2 * np.array([BULK_OF_ROCK + 1 / 3, BULK_OF_ROCK, 0])
    over = np.polymul([1, 1], waves)
    shares, roots, _ = residue(over, np.polymul(np.polyadd(over, stiff), [1, 0]))
    return (shares * np.exp(np.outer(times, roots))).sum(1).real


@CASES("""rebound-of-a-half-space
    A Maxwell half-space under a load sinks at once like an elastic body, and then in the relaxation time of
      the rebound, Maxwell's time times 1 + 2 k G/(rho g), which depends on the load's width.
    label: none, Wu and Peltier 1982
    setting: One wave length of 1 m, periodic along x, 1 m deep and clamped below; G = 1, K = 100 Pa,
      Maxwell's time 1 s, density 1e-4; Open above with p cos(k x) from t = 0 on and springs of 2 k G/2, so
      that the rebound takes three Maxwell times; 6 x 8 squares with a diagonal, k = 3, m = 2, SDIRK2,
      steps of 0.1 s.
    - sinking over the closed form's at [0.5; 1; 3; 9] s in [0.99, 1.01]: six cubic cells in a wave, inertia
      of 1e-4; without relaxation 0.76 at 0.5 s, with Maxwell's time alone 1.44 at 1 s
    - closure
    """)
def _rebound_of_a_half_space() -> Measured:
    k, load, rows = REBOUND, 1e-3, []
    run = nv.Simulation(
        structured_box((1.0, 1.0), (6, 8), periodic="x"),
        nv.Model(material=nv.LinearElastic(K_e=BULK_OF_ROCK, G_e=1.0), creep=nv.Creep(G_m=2.0)),
        time=nv.TimeSteps(dt=0.1, scheme="sdirk2"),
        walls={
            "top": nv.Open(pressure=load * k * cos(k * x), stiffness=(k, 0.0)),
            "bottom": nv.NoSlip(),
        },
        initial=nv.Initial(density=1e-4),
        discretisation=nv.Discretisation(k=3, m=2),
    )
    for t in (0.5, 1.0, 3.0, 9.0):
        run.run(t)
        sunk = -run.fields["displacement_top"][1] * cos(k * x)
        found = 2 / load * Integrate(sunk, run.mesh.Boundaries("top"), order=8)
        rows.append([t, found, _rebound(np.array([t]))[0]])
        yield f"sinking over the closed form's at {t:g} s", rows[-1][1] / rows[-1][2]
    yield Table("sinking over that of an unending load", "t, s | found | exact", rows)


# --- a squeezed film --------------------------------------------------------------------------------------
"""A viscous fluid is between two discs of distance h, and the upper disc comes down with the speed V. The
flow v_r = 3 V r z (h - z)/h^3, v_z = -V (3 z^2/h^2 - 2 z^3/h^3) with the pressure p = -3 eta V r^2/h^3 - 6
eta V z (h - z)/h^3 solves Stokes' equations for all h/R. The mesh keeps its height, and fluid comes in
through its upper side.
"""

FILM, DESCENT, VISCOSITY = 0.5, 0.1, 1.0


def _film(of_wall: float = 1.0) -> tuple[float, float]:
    """The force on the upper disc and v_r in the film, each divided by its exact value."""
    h, V, eta = FILM, DESCENT, VISCOSITY
    grown = 1 - exp(-4 * nv.time)
    p = -3 * eta * V * (1 + 2 * y * (h - y)) / h**3
    traction = (-p + 6 * eta * V * y * (h - y) / h**3, 3 * eta * V * (h - 2 * y) / h**3)
    forces = nv.WallForces(["top"])
    run = nv.Simulation(
        structured_box((1, h), (8, 4)),
        nv.Model(material=fluid(1e3), viscosity=stokes(eta)),
        dt=0.25,
        symmetry="axisymmetric",
        initial=nv.Initial(density=1e-3),
        walls={
            "top": nv.Inflow(velocity=(0.0, -V * grown)),
            "bottom": nv.NoSlip(),
            "right": nv.Open(traction=tuple(of_wall * t * grown for t in traction)),
        },
        discretisation=nv.Discretisation(k=3, m=2),
        observers=[forces],
    )
    run.run(4.0)
    v_r = run.fields["velocity"](run.mesh(0.7, h / 2))[0]
    return forces.column("top.force_2")[-1] / (-0.75 * eta * V / h**3), v_r / (0.525 * V / h)


@CASES(f"""squeezed-film (reduced)
    A viscous film between discs, one of which comes down, bears the force, and flows out, by the closed form.
    label: benchmark: the flow between approaching discs (Stefan 1875), exact for Stokes' equations
    setting: Body of revolution, 1 m x {FILM:g} m, 8 x 4 rectangles, k = 3, m = 2; the disc comes down with
      {DESCENT:g} m/s; viscosity {VISCOSITY:g} Pa s, K = 1000 Pa; the stress of the closed form at r = 1 m.
    - force over the exact one in [0.99, 1.01]: pressures of 2.4 Pa change volumes by 0.24 %
    - radial velocity in the film over the exact one in [0.99, 1.01]: as above
    - error of the force with 0.9 of the stress at r = 1 m >= 0.05: a control
    - closure
    """)
def _squeezed() -> Measured:
    force, velocity = _film()
    yield "force over the exact one", force
    yield "radial velocity in the film over the exact one", velocity
    yield "error of the force with 0.9 of the stress at r = 1 m", abs(_film(0.9)[0] - 1)


# --- a strip that is bent to a closed ring ----------------------------------------------------------------
"""A strip of incompressible neo-Hookean matter is bent to the ring 1/2 < r < 1 (Rivlin): lambda_t = r/r_0
with r_0^2 = 1/2, T_rr = W(r/r_0) - W(1/(2 r_0)), W(l) = G/2 (l^2 + 1/l^2), and both sides are free. The start
has the strains of the ring without its pressure. Therefore waves of compression begin, and cross 25
cells in a step. The midpoint rule does not damp these waves, so that v changes its sign from step to step.
"""

RING_BULK, RING_SHEAR, RING_STEP, RING_END = 200.0, 1.0, 0.1, 3.0
MOMENT, INNER, OUTER = 0.06109, -1.16895, 1.18049
"""Moment, N, and T_tt, Pa, at r = 0.55 and 0.95 m, by the formulas above."""


def _bent_ring(scheme: Literal["backward-euler", "midpoint"]) -> tuple[float, float, float, float]:
    """Moment and T_tt at 0.55 and 0.95 m, each over its exact value, and the root mean square of v, m/s."""
    r, r_0 = sqrt(x * x + y * y), 0.5**0.5
    along, c, s = r / r_0, x / r, y / r
    F = CF((c / along, -along * s, 0, s / along, along * c, 0, 0, 0, 1), dims=(3, 3))
    run = nv.Simulation(
        annulus(0.5, 1.0, 0.25),
        nv.Model(
            material=elastic("finite", RING_BULK, RING_SHEAR), viscosity=nv.StokesViscosity(K_v=1.0, G_v=0.2)
        ),
        dt=RING_STEP,
        scheme=scheme,
        walls={"inner": nv.Open(), "outer": nv.Open()},
        discretisation=nv.Discretisation(k=2, m=1),
        initial=nv.Initial(density=0.05, F=F),
    )
    run.run(RING_END)
    radii, angles = np.linspace(0.505, 0.995, 50), np.linspace(0, 2 * np.pi, 36, endpoint=False)
    e_t = np.array([-np.sin(angles), np.cos(angles)])

    def hoop(radius: float) -> float:
        T = run.fields["cauchy_stress"](run.mesh(radius * np.cos(angles), radius * np.sin(angles)))
        return float(np.einsum("in,nij,jn->n", e_t, T.reshape(-1, 3, 3)[:, :2, :2], e_t).mean())

    T_tt = np.array([hoop(radius) for radius in radii])
    moment = np.trapezoid(T_tt * radii, radii) + 0.005 * (T_tt[0] * radii[0] + T_tt[-1] * radii[-1])
    v = run.fields["velocity"]
    speed = (Integrate(v * v, run.mesh) / Integrate(CF(1.0), run.mesh)) ** 0.5
    return float(moment) / MOMENT, hoop(0.55) / INNER, hoop(0.95) / OUTER, float(speed)


@CASES(f"""bent-ring
    A strip that is bent to a closed ring between open walls has Rivlin's moment and stays at rest; by the
      midpoint rule, which does not damp the waves of the start, the velocity alternates from step to step.
    label: benchmark: Rivlin 1949, bending of a strip
    setting: A ring of 0.5 to 1 m, cells of 0.25 m, K_e = {RING_BULK:g}, G_e = {RING_SHEAR:g} Pa, K_v = 1,
      G_v = 0.2 Pa s, 0.05 kg/m3; strains of the ring at the start; steps of {RING_STEP:g} s until
      {RING_END:g} s, backward Euler.
    - moment over the exact one in [0.98, 1.02]: volumes change by 0.5 %
    - hoop stress at 0.55 m over the exact one in [0.98, 1.02]: as above
    - hoop stress at 0.95 m over the exact one in [0.98, 1.02]: as above
    - error of rest, root mean square of v, m/s <= 1e-3: 0.3 mm of the radius in the run
    - control: root mean square of v by the midpoint rule, m/s >= 0.01: waves that nothing damps
    - control: warnings of waves that alternate, by the midpoint rule in [1, 1]: once in a run
    - closure
    """)
def _bent() -> Measured:
    moment, inner, outer, speed = _bent_ring("backward-euler")
    yield "moment over the exact one", moment
    yield "hoop stress at 0.55 m over the exact one", inner
    yield "hoop stress at 0.95 m over the exact one", outer
    yield "error of rest, root mean square of v, m/s", speed
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", nv.RingingWarning)
        yield "control: root mean square of v by the midpoint rule, m/s", _bent_ring("midpoint")[-1]
    ringing = sum(one.category is nv.RingingWarning for one in said)
    yield "control: warnings of waves that alternate, by the midpoint rule", ringing
