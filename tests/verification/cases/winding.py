"""Creeping flow over a hundred Maxwell times, by F, which winds up, and by B, which does not."""

import warnings
from typing import Literal

import numpy as np
from ngsolve import CF, CoefficientFunction, Det, IfPos, Integrate, x, y

import ngvisco as nv
from ngvisco.forms.boundary.walls import Conditions
from ngvisco.forms.context import time
from ngvisco.geometries import box
from ngvisco.physics.tensors import dev, square, sym, tr
from ngvisco.physics.variables import Distortion, Jacobian, LeftCauchyGreen
from tests.verification.case import Cases, Measured, RateTable, Table

CASES = Cases("Creeping flow at finite strain")

K_E, G_E, G_M, VISCOSITY = 20.0, 0.05, 0.005, 0.01
"""Moduli, Pa, Pa, Pa s, and viscosity, Pa s; the Maxwell time G_M/(4 G_E) is 0.025 s in shear, and 0.05 s for
the square of the stress."""


def material(state: Literal["F", "B", "none"], G_e: float = G_E) -> nv.Material:
    """The material phi = K/2 (J - 1)^2 + G_e (tr(J^(-2/3) F F^T) - 3) by F or by B, or with the first term
    alone."""

    def volume(J: CoefficientFunction) -> CoefficientFunction:
        return K_E / 2 * (J - 1) * (J - 1)

    if state == "F":
        return nv.CustomMaterial(
            transported=(Distortion(), Jacobian()),
            stored_energy=lambda F, J: volume(J) + G_e * (J ** (-2 / 3) * square(F) - 3),
        )
    if state == "none":
        return nv.CustomMaterial(transported=(Jacobian(),), stored_energy=volume)
    return nv.CustomMaterial(
        transported=(LeftCauchyGreen(exponent=-2 / 3), Jacobian()),
        stored_energy=lambda B, J: volume(J) + G_e * (tr(B) - 3),
    )


def lid(
    of: nv.Material, maxh: float, dt: float, creep: nv.Creep | None, viscosity: float = VISCOSITY
) -> nv.Simulation:
    """A unit box under a lid with the speed 16 x^2 (1 - x)^2 m/s, which is ramped up until 0.2 s."""
    model = nv.Model(material=of, viscosity=nv.StokesViscosity(K_v=VISCOSITY, G_v=viscosity), creep=creep)
    speed = IfPos(time - 0.2, 1, time / 0.2) * 16 * x * x * (1 - x) * (1 - x)
    others = ("left", "right", "bottom")
    walls: Conditions = {"top": nv.PrescribedTangential((speed, 0.0)), others: nv.NoSlip()}
    time.Set(0.0)
    return nv.Simulation(box((1, 1), maxh), model, time=nv.TimeSteps(dt=dt, velocity_scale=1.0), walls=walls)


TABLE: tuple[tuple[Literal["F", "B"], float, float, tuple[float, ...]], ...] = (
    ("F", 0.1, 0.02, (0.5, 1.0, 2.0)),
    ("F", 0.1, 0.005, (1.0,)),
    ("F", 0.05, 0.02, (1.0,)),
    ("B", 0.1, 0.02, (0.5, 1.0, 4.0)),
    ("B", 0.05, 0.02, (1.0,)),
)
"""Elastic state, size of cells, m, step, s, and times, s."""


@CASES(f"""winding-lid
    In a creeping body under a lid det(J^(−2/3) F Fᵀ) stays one over 80 Maxwell times by B; by F it drifts
      from one within twenty, for every step and mesh, with a ledger that closes, and the run's error says so.
    label: ED-Euler-large2, ED-Euler-large3
    setting: Unit box, K_e = {K_E:g} Pa, G_e = {G_E:g} Pa, G_m = {G_M:g} Pa s (Maxwell time 0.05 s), viscosity
      {VISCOSITY:g} Pa s, lid 16 x²(1 − x)² m/s ramped until 0.2 s.
    - largest error |det B − 1| <= 0.03: first order in tau, 0.02 s, at the lid's corners
    - runs by F that ended by name in [3, 3]: all three runs: det F deviates from J by 10 % in a cell
    - time at which the last run by F ended, s in [0.1, 1]: from two to twenty Maxwell times
    - time at which the first run by F ended, s in [0.1, 1]: two Maxwell times, which the lid needs to turn
      matter
    - runs by F that warned before they ended in [3, 3]: each of them
    - closure
    """)
def _side_by_side() -> Measured:
    rows = []
    gaps, warned, ends = list[float](), {"F": 0, "B": 0}, list[float]()
    for state, maxh, dt, times in TABLE:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", nv.DefectWarning)
            run = lid(material(state), maxh, dt, nv.Creep(G_m=G_M))
            for until in times:
                has_ended = False
                try:
                    run.run(until)
                except nv.StepError as error:
                    yield f"By {state} with cells of {maxh:g} m the run ends at {run.t:.2f} s: {error}"
                    has_ended = True
                    if state == "F" and " differ by " in str(error):
                        ends.append(run.t)
                fields, last = run.fields, run.ledger.rows[-1]
                A = fields["B"] if state == "B" else fields["J"] ** (-2 / 3) * fields["F"] * fields["F"].trans
                low, high = run.sampler.extrema(Det(A))
                if state == "B":
                    gaps.append(max(1 - low, high - 1))
                trace, defect = run.sampler.extrema(tr(A))[1], last["defect_rms"]
                rows.append([state, maxh, dt, run.t, low, high, trace, last["stored"], defect])
                if has_ended:
                    break
        warned[state] += sum(issubclass(w.category, nv.DefectWarning) for w in caught)
    yield "largest error |det B − 1|", max(gaps)
    yield "runs by F that ended by name", len(ends)
    yield "time at which the last run by F ended, s", max(ends)
    yield "time at which the first run by F ended, s", min(ends)
    yield "runs by F that warned before they ended", warned["F"]
    head = "form | h, m | tau, s | t, s | det A from | to | largest tr A | stored, J | defect"
    title = "a creeping neo-Hookean body under a lid; A = J^(−2/3) F Fᵀ, or B"
    yield from Table(title, head, rows).drawn(3, 4, 5, by=0)
    yield "The ledger closes in every row: closure is not correctness."


@CASES("""creeping-cavity
    Cavity flow by B keeps det B over a hundred Maxwell times, and for small Maxwell times its stress tends to
      that of the Navier–Stokes flow of equal viscosity.
    label: ED-Euler-large3
    setting: The same box and lid, cells of 0.125 m, 100 steps of 0.05 s, G_m = 0.02 Pa s, Maxwell times 0.05,
      0.025 and 0.0125 s.
    - largest error |det B − 1| <= 0.1: first order in tau, 0.05 s, at the lid's corners
    - rate of the stress in the Maxwell time >= 0.7: of first order in Wi
    - error of the stress at the smallest Maxwell time <= 0.05: of the order of Wi
    - Maxwell times of the first run in [100, 100]: what is claimed
    - closure
    """)
def _cavity() -> Measured:
    """Compare stresses for small Maxwell times at one viscosity with the Navier-Stokes flow of G_v +
    G_m/2."""
    G_m, maxh, dt, until = 0.02, 0.125, 0.05, 5.0
    viscous = lid(material("none"), maxh, dt, None, VISCOSITY + G_m / 2)
    viscous.run(until)
    # leave out the lid's corners, where the strain rate of the exact flow is unbounded
    inside = IfPos(y - 0.8, 0.0, 1.0) * CF((1.0,) * 9, dims=(3, 3))
    weight, expected = (_cell_means(A, viscous) for A in (inside, G_m * dev(sym(viscous.rothe_step.now.L))))
    table, rows = (
        RateTable("against the viscous flow, relative in L2, y < 0.8 m", "Maxwell time, s"),
        [],
    )
    for maxwell_time in (0.05, 0.025, 0.0125):
        run = lid(material("B", G_m / (4 * maxwell_time)), maxh, dt, nv.Creep(G_m=G_m))
        run.run(until)
        low, high = run.sampler.extrema(Det(run.fields["B"]))
        # functions on another mesh object with the same cells in the same order
        off = weight * (_cell_means(dev(run.fields["cauchy_stress"]), run) - expected)
        table.add(maxwell_time, stress=float(np.linalg.norm(off) / np.linalg.norm(weight * expected)))
        rows.append([maxwell_time, until / maxwell_time, low, high, max(1 - low, high - 1)])
    yield "largest error |det B − 1|", max(row[-1] for row in rows)
    yield "rate of the stress in the Maxwell time", table.last("stress")
    yield "error of the stress at the smallest Maxwell time", table.errors["stress"][-1]
    yield "Maxwell times of the first run", rows[0][1]
    yield Table("det B", "Maxwell time, s | Maxwell times | from | to | off one", rows)
    yield table


def _cell_means(A: CoefficientFunction, run: nv.Simulation) -> np.ndarray:
    """Means over cells times the root of the volume, (9, cells), so that their products are L2 products."""
    volume = Integrate(CF(1), run.mesh, element_wise=True).NumPy()
    parts = [Integrate(A[i, j], run.mesh, element_wise=True).NumPy() for i in range(3) for j in range(3)]
    return np.array(parts) / np.sqrt(volume)
