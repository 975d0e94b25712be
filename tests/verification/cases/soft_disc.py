"""A soft disc in a fluid: carried round a lid-driven cavity, and oscillating in a Taylor-Green vortex."""

import numpy as np
from ngsolve import cos, pi, sin, x, y

import ngvisco as nv
from ngvisco.forms.boundary.walls import Conditions
from ngvisco.geometries import box, structured_box
from ngvisco.run.ledger import NUMERICAL
from tests.verification.case import Cases, Curve, Outcome, Plot, Table, measured
from tests.verification.immersed import CAVITY, COLUMNS, TAYLOR_GREEN, Problem, computed
from tests.verification.setups import closure, fluid, stokes

CASES = Cases()

PATH = np.array(
    [
        (0.5, 0.57623, 0.49479),
        (1.0, 0.53026, 0.49215),
        (1.5, 0.47261, 0.50153),
        (2.0, 0.41192, 0.52883),
        (2.5, 0.35574, 0.57722),
        (3.0, 0.31153, 0.64569),
        (3.5, 0.28912, 0.72597),
        (4.0, 0.30168, 0.80011),
        (4.5, 0.36036, 0.85044),
        (5.0, 0.46990, 0.86540),
        (5.5, 0.59797, 0.84920),
        (6.0, 0.68490, 0.79768),
        (6.5, 0.69545, 0.71165),
        (7.0, 0.65560, 0.63424),
        (7.5, 0.59831, 0.58921),
        (8.0, 0.53819, 0.57744),
    ]
)
"""Time, s, and centroid of the disc in the cavity, m, by ``immersed.computed(CAVITY, 128, ...)``.

On 64 x 64 cells it is at most 0.0098 m away from that (at 5.5 to 6 s).
"""


def model_of(problem: Problem, K_e: float) -> nv.Model:
    """Fluid and neo-Hookean disc of bulk modulus ``K_e``, Pa."""
    solid = nv.IsochoricNeoHookean(K_e=K_e, G_e=problem.shear_modulus / 2, elastic_state="B")
    viscosity = stokes(problem.viscosity)
    ball = nv.Ball(problem.centre, problem.radius)
    return nv.Model(
        bodies=(
            nv.Body(name="fluid", material=fluid(K_e), viscosity=viscosity, density=1.0),
            nv.Body(name="disc", where=ball, material=solid, viscosity=viscosity, density=1.0),
        )
    )


def cavity(cells: tuple[int, int], K_e: float, table: nv.Bodies) -> nv.Simulation:
    """demos/soft_disc."""
    walls: Conditions = {"top": nv.PrescribedTangential((1.0, 0.0)), ("left", "right", "bottom"): nv.NoSlip()}
    return nv.Simulation(
        structured_box((1, 1), cells, grading={"y": 0.3}, split_corners=True),
        model_of(CAVITY, K_e),
        time=nv.TimeSteps(dt=0.05, scheme="midpoint", startup=2),
        walls=walls,
        discretisation=nv.Discretisation(k=3),  # P_2 locks where volumes are stiff
        observers=[table],
    )


def quarter(maxh: float, dt: float, K_e: float, table: nv.Bodies) -> nv.Simulation:
    """demos/soft_disc/vortex.toml: a quarter of the box, of which all walls are planes of symmetry."""
    k, a = 2 * pi, TAYLOR_GREEN.vortex * 2 * pi
    velocity = (a * sin(k * x) * cos(k * y), -a * cos(k * x) * sin(k * y))
    return nv.Simulation(
        box((0.5, 0.5), maxh),
        model_of(TAYLOR_GREEN, K_e),
        dt=dt,
        initial=nv.Initial(velocity=velocity),
        discretisation=nv.Discretisation(k=3),  # P_2 locks where volumes are stiff
        scheme="midpoint",
        observers=[table],
    )


def _path(table: nv.Bodies, times: np.ndarray) -> np.ndarray:
    t = table.column("time")
    return np.array([np.interp(times, t, table.column(f"disc_{axis}")) for axis in "xy"]).T


def _away(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.linalg.norm(one - other, axis=1).max())


@CASES("""soft-disc-cavity
    A soft disc is carried round a lid-driven cavity along the path that another method for the incompressible
      problem gives; it keeps its mass and nearly its volume, and how stiff the volume is matters little.
    label: benchmark: Zhao, Freund and Moser (2008), Sugiyama et al. (2011)
    setting: Unit box, lid at 1 m/s from t = 0 on; density 1 kg/m3, viscosity 0.01 Pa s, disc of radius 0.2 m
      at (0.6, 0.5) m with a shear modulus of 0.1 Pa, K_e = 50 Pa; 884 triangles in 20 columns of 22 rows, at
      the lid 0.3 as high as at the floor, velocities of order 3, midpoint rule, dt = 0.05 s, until 8 s.
    - largest distance from the reference's path until 8 s, m <= 0.01: 0.05 of the radius
    - largest change of the disc's volume <= 0.01: pressures of 0.5 Pa over K_e
    - largest change of the disc's mass <= 1e-11: conserved amounts
    - closure
    - path with K_e = 50 Pa from that with 200 Pa until 3 s, m <= 0.01: half the first
    """)
def _carried() -> Outcome:
    table = nv.Bodies()
    run = cavity((20, 22), 50.0, table)
    run.run(8.0)
    path = _path(table, PATH[:, 0])
    stiffness, early = {}, PATH[:6, 0]
    for K_e in (12.5, 50.0, 200.0):
        other = nv.Bodies()
        coarse = cavity((8, 9), K_e, other)
        coarse.run(float(early[-1]))
        volumes, least = other.column("disc_volume"), coarse.ledger.column("J_min").min()
        stiffness[K_e] = _path(other, early), float(np.abs(volumes / volumes[0] - 1).max()), float(least)
    study = [
        [K_e, (K_e / 1.0) ** 0.5, _away(found, stiffness[200.0][0]), volume, least]
        for K_e, (found, volume, least) in stiffness.items()
    ]
    volumes, masses = table.column("disc_volume"), table.column("disc_mass")
    rows = [
        [t, *ours, *theirs, float(np.linalg.norm(ours - theirs))]
        for t, ours, theirs in zip(PATH[:, 0], path, PATH[:, 1:], strict=True)
    ]
    return measured(
        {
            "largest distance from the reference's path until 8 s, m": _away(path, PATH[:, 1:]),
            "largest change of the disc's volume": float(np.abs(volumes / volumes[0] - 1).max()),
            "largest change of the disc's mass": float(np.abs(masses / masses[0] - 1).max()),
            "largest |closure|": closure(run),
            "path with K_e = 50 Pa from that with 200 Pa until 3 s, m": study[1][2],
        },
        Table("the centroid, m", "t, s | x | y | reference: x | y | distance", rows),
        Table(
            "how nearly incompressible, 8 columns of 9 rows, until 3 s",
            "K_e, Pa | sound, m/s | path from that with 200 Pa, m | change of volume | least J",
            study,
        ),
        Plot(
            "Path of the disc's centroid",
            "x, m",
            "y, m",
            [
                Curve("immersed triangles", PATH[:, 1], PATH[:, 2], "o"),
                Curve("ngvisco", table.column("disc_x"), table.column("disc_y"), "-"),
            ],
        ),
        "The paper prints its path as a picture only. The numbers that are compared are those of "
        "another method for the same incompressible problem (tests/verification/immersed.py), that "
        "of Zhao, Freund and Moser (2008), with whose path Sugiyama et al. compare theirs.",
        "The bound of the path was written before this mesh was tried; unstructured ones of up to 795 "
        "triangles missed it.  The reference itself is 0.0098 m from its own coarser grid.",
    )


@CASES("""soft-disc-vortex
    A disc in a Taylor-Green vortex is stretched and swings back: its elastic energy over time is that of
      another method for the incompressible problem, and the ledger closes.
    label: benchmark: Zhao, Freund and Moser (2008), Jain, Kamrin and Mani (2019)
    setting: A quarter of the unit box with planes of symmetry, psi = 0.05 sin 2 pi x sin 2 pi y m2/s, density
      1 kg/m3, viscosity 0.001 Pa s, disc of radius 0.2 m about the middle, shear modulus 1 Pa, K_e = 50 Pa;
      cells of 0.1 and 0.05 m, velocities of order 3, midpoint rule, dt = 0.2 s/m of the cells' size, until 1
      s.
    - closure
    - energy that the scheme takes or gives, over the start's <= 0.01: second order
    - elastic energy: error over its peak, cells of 0.05 m <= 0.25: five cells a radius
    - elastic energy: error, fine over coarse <= 0.7: it converges
    - elastic energy: time of its peak, error, s <= 0.03: a step and a half of the table
    - kinetic energy: error over its start, cells of 0.05 m <= 0.15: as above
    """)
def _oscillating() -> Outcome:
    times = np.linspace(0.0, 1.0, 51)
    reference = dict(zip(COLUMNS, computed(TAYLOR_GREEN, 96, times).T, strict=True))
    largest = float(reference["stored"].max())
    top = float(times[int(np.argmax(reference["stored"]))])
    curves = [Curve("immersed triangles, 96 x 96", times, reference["stored"], "k--")]
    rows: list[list[str | float]] = []
    numbers, closures = [], []
    for maxh in (0.1, 0.05):
        table = nv.Bodies()
        run = quarter(maxh, 0.2 * maxh, 50.0, table)
        ledger = run.run(1.0)
        t, stored = table.column("time"), table.column("disc_stored")
        stored, kinetic = 4 * (stored - stored[0]), 4 * ledger.column("kinetic")
        of_stored = np.abs(np.interp(times, t, stored) - reference["stored"]).max() / largest
        of_kinetic = np.abs(np.interp(times, t, kinetic) - reference["kinetic"]).max() / kinetic[0]
        peak = int(np.argmax(stored))
        taken = sum(ledger.column(name).sum() for name in NUMERICAL) * 4 / kinetic[0]
        numbers.append([t[peak], stored[peak], of_stored, of_kinetic, taken])
        rows.append([maxh, *numbers[-1]])
        closures.append(closure(run))
        curves.append(Curve(f"cells of {maxh:g} m", t, stored, "-"))
    coarse, fine = numbers
    rows.append(["reference", top, largest, 0.0, 0.0, 0.0])
    columns = ("cells, m", "peak at, s", "peak, J", "largest error", "kinetic energy's", "by the scheme")
    return measured(
        {
            "largest |closure|": max(closures),
            "energy that the scheme takes or gives, over the start's": abs(fine[4]),
            "elastic energy: error over its peak, cells of 0.05 m": fine[2],
            "elastic energy: error, fine over coarse": fine[2] / coarse[2],
            "elastic energy: time of its peak, error, s": abs(fine[0] - top),
            "kinetic energy: error over its start, cells of 0.05 m": fine[3],
        },
        Table("elastic energy of the disc", columns, rows),
        Plot("Elastic energy of the disc", "time, s", "J", curves),
        "The published curves are pictures; the reference is immersed.py, as for the cavity.",
        "On 192 x 192 cells its peak is 0.00702 J.  Against that the largest errors of the elastic "
        "energy on cells of 0.1, 0.05 and 0.025 m are 0.60, 0.30 and 0.15 of it (orders 0.98 and 1.06), "
        "of the kinetic energy 0.18, 0.076 and 0.028 (1.27 and 1.46).",
    )
