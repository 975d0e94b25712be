"""Heat of flows against theory: shear that heats and weakens, a stream that is heated on its way."""

from typing import Any

import numpy as np
from ngsolve import Integrate, exp, x, y
from scipy.integrate import solve_ivp

import ngvisco as nv
from ngvisco.geometries import structured_box
from tests.verification.case import Cases, Outcome, Table, measured
from tests.verification.setups import closure

CASES = Cases("Heat")

C, THETA_R, RATE, ENERGY = 2.0, 300.0, 2.0, 2e4
"""Heat capacity, J/(m^3 K), start, K, shear rate, 1/s, activation energy, J/mol."""


SPEED, INLET, KAPPA, SOURCE = 1.0, 310.0, 0.5, 10.0


"""Of a stream: m/s, K, W/(m K), W/m^3."""


def _stream(cells: int, solver: str) -> nv.Simulation:
    cold = nv.LinearElastic(K_e=50.0, G_e=10.0)
    material = nv.Thermal(material=cold, c=C, theta_R=THETA_R)
    walls: Any = {
        "left": nv.Inflow(velocity=(SPEED, 0.0), density=1.0, temperature=INLET),
        "right": nv.Open(density=1.0),
    }
    run = nv.Simulation(
        structured_box((1, 0.25), (cells, max(1, cells // 4))),
        nv.Model(material=material, heat=nv.Heat(conductivity=KAPPA, source=SOURCE)),
        dt=0.25,
        walls=walls,
        initial=nv.Initial(density=1.0, velocity=(SPEED, 0.0), temperature=INLET),
        solver=solver,
    )
    run.run(12.0)
    return run


@CASES(f"""heat-carried-through
    A stream brings heat through an inlet, is heated on its way, and takes it out: its temperature, and the
      balances of energy and entropy.
    label: heat-entropy; c V theta' = q + kappa theta'' with the conditions of Danckwerts (1953)
    setting: 1 m x 0.25 m, {SPEED:g} m/s, inlet {INLET:g} K, c = {C:g} J/(m3 K), kappa = {KAPPA:g} W/(m K),
      source {SOURCE:g} W/m3; 4, 8 and 16 cells along, backward Euler until 12 s, where it is steady.
    - error of the temperature over its rise <= 2e-3: cells, and mixing at the inlet, 5e-4
    - the same of an inlet that holds the temperature >= 0.05: another condition is told apart
    - what mixing at the inlet takes over theory, less one <= 0.05: c V dtheta^2/(2 theta): entropy is
      carried, and none made where streams mix
    - what is left of the entropy's balance <= 1e-10: to rounding, as the energy's
    - difference of the solvers over the rise <= 1e-8: the same equations
    - closure
    """)
def _heated_stream() -> Outcome:
    """c V theta' = q + kappa theta'' from 0 to 1 with c V (theta - theta_in) = kappa theta' at 0 and
    theta' = 0 at 1, as nothing is conducted beyond the walls (Danckwerts 1953)."""
    rise, length = SOURCE / (C * SPEED), KAPPA / (C * SPEED)
    along = x - length * exp((x - 1) / length)
    rows, values = [], {}
    for cells in (4, 8, 16):
        run = _stream(cells, "split")
        theta, volume = run.fields["temperature"], 0.25
        error, held = (
            float(np.sqrt(Integrate((theta - INLET - rise * (along + start)) ** 2, run.mesh) / volume)) / rise
            for start in (length, length * np.exp(-1 / length))
        )
        rows.append([cells, error, held, closure(run)])
    other = _stream(16, "coupled")
    ledger = run.ledger
    rates = sum(ledger.column(name) for name in ledger.columns if name.startswith("entropy_"))
    left = np.diff(ledger.column("entropy")) - (ledger.column("dt") * rates)[1:]
    jump = rise * length * (1 - np.exp(-1 / length))
    mixing = C * SPEED * jump**2 / (2 * (INLET + jump / 2)) * volume
    values["error of the temperature over its rise"] = rows[-1][1]
    values["the same of an inlet that holds the temperature"] = rows[-1][2]
    found = -float(ledger.column("power_wall_left")[-1]) / mixing
    values["what mixing at the inlet takes over theory, less one"] = abs(found - 1)
    values["what is left of the entropy's balance"] = float(abs(left).max() / ledger.column("entropy")[-1])
    difference = Integrate((theta - other.fields["temperature"]) ** 2, run.mesh) / volume
    values["difference of the solvers over the rise"] = float(np.sqrt(difference)) / rise
    names = ["cells along", "error over the rise", "the same of an inlet that holds theta", "closure"]
    return measured(
        values,
        Table("a stream that is heated on its way", names, rows),
        "Numbers of trials, until 8 s, were seen before the bounds were written.",
    )


K, N = 40.0, 0.6
"""A fluid's consistency, Pa s^n, and exponent."""
G, A, M = 20.0, 1e-4, 3.0
"""A body's G_e, Pa, and Norton's law's rate at 1 Pa, 1/s, and exponent."""


def _faster(theta: float) -> float:
    """Arrhenius's factor."""
    return float(np.exp(ENERGY / 8.31446261815324 * (1 / THETA_R - 1 / theta)))


def _fluid(_t: float, u: np.ndarray) -> np.ndarray:
    """c theta' = K rate^(n+1)/a."""
    return np.array([K * RATE ** (N + 1) / _faster(u[0]) / C])


def _body(_t: float, u: np.ndarray) -> np.ndarray:
    """F' = L F - F Pi, Pi = a A |M|^(n-1) M, c theta' = M : Pi, of the elastic distortion in simple shear.

    M = F^T T F^-T, T = 2 G dev F F^T, since J = 1.
    """
    F, theta = u[:9].reshape(3, 3), u[9]
    L = np.zeros((3, 3))
    L[0, 1] = RATE
    B = F @ F.T
    mandel = F.T @ (2 * G * (B - np.trace(B) / 3 * np.eye(3))) @ np.linalg.inv(F.T)
    Pi = _faster(theta) * A * np.sum(mandel * mandel) ** ((M - 1) / 2) * mandel
    return np.append((L @ F - F @ Pi).ravel(), np.sum(mandel * Pi) / C)


def _run(dt: float, solver: str, material: nv.Material, **laws: Any) -> nv.Simulation:
    warm = nv.Thermal(material=material, c=C, theta_R=THETA_R)
    walls: Any = {"top": nv.PrescribedTangential((RATE, 0.0)), "bottom": nv.NoSlip()}
    run = nv.Simulation(
        structured_box((1, 1), (1, 1), periodic=("x",)),
        nv.Model(material=warm, **laws),
        dt=dt,
        walls=walls,
        initial=nv.Initial(density=1e-6, velocity=(RATE * y, 0.0)),
        scheme="midpoint",
        solver=solver,
        newton=nv.NewtonOptions(tolerance=1e-12),  # the energy is zero at the start
    )
    run.run(1.0)
    return run


@CASES("""heat-shear
    Adiabatic shear of a power-law fluid and of a body that creeps: heat weakens both.
    label: heat-entropy; c theta' = tau rate with Arrhenius's factor, by SciPy's LSODA
    setting: Homogeneous shear at 2/s for 1 s from 300 K, E = 20 kJ/mol; two cells, midpoint rule.
    - largest relative error of the warming, 0.05 s <= 2e-3: (rate dt)^2/12 = 8e-4
    - least order in time >= 1.8: 2
    - difference of the solvers, of the warming <= 1e-8: the same equations
    - closure
    """)
def _shear_heating() -> Outcome:
    gel = nv.IsochoricNeoHookean(K_e=200.0, G_e=G, elastic_state="B")
    thinning = nv.PowerLaw(K_v=1.0, consistency=K, n=N, floor=1e-6)
    kinds: dict[str, tuple[Any, np.ndarray, Any, dict[str, Any]]] = {
        "power-law fluid": (
            _fluid,
            np.array([THETA_R]),
            nv.ReferentialNeoHookean(K_e=200.0, G_e=1e-9),
            {"viscosity": nv.ActivatedViscosity(viscosity=thinning, E=ENERGY, theta_R=THETA_R)},
        ),
        "Norton's body": (
            _body,
            np.append(np.eye(3).ravel(), THETA_R),
            gel,
            {
                "creep": nv.Activated(rule=nv.Norton(A=A, n=M), E=ENERGY, theta_R=THETA_R),
                "viscosity": nv.StokesViscosity(K_v=1e-9, G_v=1e-9),
            },
        ),
    }
    rows, rates, differences = [], [], []
    for name, (slope, start, material, laws) in kinds.items():
        exact = solve_ivp(slope, (0, 1), start, method="LSODA", rtol=1e-11, atol=1e-11).y[-1, -1]
        errors = []
        for dt, solver in ((0.1, "coupled"), (0.05, "coupled"), (0.05, "split")):
            run = _run(dt, solver, material, **laws)
            theta = run.fields["temperature"](run.mesh(0.4, 0.4))
            errors.append(abs(theta - exact) / (exact - THETA_R))
            rows.append([name, solver, dt, theta, exact, errors[-1]])
        rates.append(float(np.log2(errors[0] / errors[1])))
        differences.append(abs(errors[2] - errors[1]))
    return measured(
        {
            "largest relative error of the warming, 0.05 s": max(row[-1] for row in rows if row[2] < 0.1),
            "least order in time": min(rates),
            "difference of the solvers, of the warming": max(differences),
        },
        Table(
            f"temperature after a shear of {RATE:g} in 1 s, adiabatic",
            "body | solver | dt, s | theta, K | reference, K | error of the warming",
            rows,
        ),
    )
