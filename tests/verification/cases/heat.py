"""Heat against theory: expansion, waves, conduction, transport by a flow, and heating by a flow."""

import math
from typing import Any

import numpy as np
from ngsolve import CF, CoefficientFunction, IfPos, Integrate, cos, exp, pi, sin, x, y
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import ngvisco as nv
from ngvisco.geometries import box, channel, structured_box
from tests.verification.case import Cases, Measured, RateTable, Table
from tests.verification.setups import closure, distance, fluid, stokes

CASES = Cases("Heat")

# --- bodies at rest and waves --------------------------------------------------------------------------

# an elastic body with strong thermal coupling: COUPLING^2 THETA_R/C is a quarter of its stiffness
STIFFNESS, C, THETA_R, COUPLING = 4.0, 2.0, 5.0, 0.6
SMALL = 1e-4
IDEAL = nv.Thermal(c=2.5, gruneisen=0.4, theta_R=1.0)
"""A gas of 1 Pa at 1 K."""


def _elastic(conductivity: float = 0.0, warm: bool = True) -> nv.Model:
    """A body, with heat or without, whose waves have the stiffness ``STIFFNESS``."""
    K = STIFFNESS - 4 / 3 * 2.0
    cold = nv.LinearElastic(K_e=K, G_e=2.0)
    if not warm:
        return nv.Model(material=cold)
    material = nv.Thermal(material=cold, c=C, theta_R=THETA_R, expansion=COUPLING / K)
    return nv.Model(material=material, heat=nv.Heat(conductivity=conductivity))


@CASES("""heat-clamped (reduced)
    A heated clamped body does not move, and has the pressure K beta dtheta.
    label: Duhamel and Neumann's law; heat-energy of FORMULATION
    setting: Box of 1 m with walls all around, 3 W/m^3 for 1 s, c = 2 J/(m^3 K); midpoint rule.
    - error of the pressure K beta dtheta, relative <= 1e-8: the step's error only; set after a first run
    - error of the temperature with half the step over that with the whole step <= 0.3: a scheme of second
      order has a quarter
    - closure
    """)
def _clamped() -> Measured:
    K, c, beta, power, rows = 50.0, 2.0, 0.01, 3.0, []
    solid = nv.ReferentialNeoHookean(K_e=K, G_e=10.0)
    material = nv.Thermal(material=solid, c=c, theta_R=300.0, expansion=beta)
    for dt in (0.1, 0.05, 0.025):
        model = nv.Model(material=material, heat=nv.Heat(source=power))
        run = nv.Simulation(box((1, 1), maxh=0.5), model, dt=dt, scheme="midpoint")
        run.run(1.0)
        theta, p = (run.fields[name](run.mesh(0.3, 0.4)) for name in ("temperature", "pressure"))
        rows.append([dt, abs(theta - 300 - power / c), abs(p - K * beta * power / c)])
    yield "error of the pressure K beta dtheta, relative", rows[-1][2] / (K * beta * power / c)
    half = rows[-1][1] / rows[-2][1]
    yield "error of the temperature with half the step over that with the whole step", half
    head = "dt, s | error of the temperature, K | error of the pressure, Pa"
    yield from Table("a clamped body that is heated by 1.5 K", head, rows).drawn(0, 1, 2, log="xy")


def _period(
    model: nv.Model,
    dt: float = 0.01,
    density: CoefficientFunction | None = None,
    mode: CoefficientFunction | None = None,
) -> float:
    """The period: four times the first zero of int rho v . mode of a standing wave, 2 m long by default."""
    mode = sin(pi * x) if mode is None else mode
    start = nv.Initial(density=1.0 if density is None else None, velocity=(SMALL * mode, 0.0))
    mesh = structured_box((1, 0.2), (10, 2))
    run = nv.Simulation(mesh, model, dt=dt, initial=start, scheme="midpoint")
    weight = mode if density is None else density * mode
    found = [1.0]
    while found[-1] > 0:
        run.advance()
        found.append(Integrate(run.fields["velocity"][0] * weight, run.mesh, order=8))
    return 4 * dt * (len(found) - 2 + found[-2] / (found[-2] - found[-1]))


def _beside(other: nv.Thermal, bulk: float, rho: float) -> tuple[float, float]:
    """Measured and exact periods of an ideal gas beside a body of density ``rho`` and bulk modulus ``bulk``.

    Each body fills half of the box. The exact frequency solves Z_1 cot(omega/(2 c_1)) + Z_2 cot(omega/(2
    c_2)) = 0."""
    speeds, impedances = np.sqrt([1.4, bulk / rho]), np.sqrt([1.4, bulk * rho])

    def excess(omega: float) -> float:
        return float(impedances @ (np.cos(omega / 2 / speeds) * np.sin(omega / 2 / speeds[::-1])))

    omega = brentq(excess, 1e-3, 0.999 * 2 * math.pi * speeds.min())
    left, right = (float(omega / c) for c in speeds)
    mode = IfPos(0.5 - x, sin(left * x) / math.sin(left / 2), sin(right * (1 - x)) / math.sin(right / 2))
    bodies = (
        nv.Body(name="gas", material=IDEAL, where=0.5 - x, density=1.0),
        nv.Body(name="other", material=other, density=rho),
    )
    found = _period(nv.Model(bodies=bodies), density=IfPos(0.5 - x, 1.0, rho), mode=mode)
    return found, 2 * math.pi / omega


def _stiffened() -> tuple[nv.Model, float]:
    """Deviation of a wave from the isentrope in a stiffened gas, p + p_inf = Gamma c theta/J, at p = 0."""
    Gamma, c, pressure = 3.4, 2.5, 3.4 * 2.5
    model = nv.Model(material=nv.Thermal(c=c, gruneisen=Gamma, theta_R=1.0, p_infinity=pressure))
    start = nv.Initial(density=1.0, velocity=(0.1 * sin(pi * x), 0.0))
    run = nv.Simulation(box((1, 0.2), maxh=0.1), model, dt=0.005, initial=start, scheme="midpoint")
    run.run(0.08)  # a quarter of the period of 0.327 s, when the densities differ most
    found = [(run.fields[n](run.mesh(x0, 0.1)) for n in ("pressure", "density")) for x0 in (0.05, 0.95)]
    return model, max(abs((p + pressure) / pressure / rho ** (1 + Gamma) - 1) for p, rho in found)


@CASES("""heat-sound
    Without conduction waves are isentropic, and faster than isothermal ones, also in a gas beside another gas
      or a liquid.
    label: c^2 = (M + (Gamma c)^2 theta_R/c)/rho, gamma p/rho of an ideal gas
    setting: Standing waves in a box of 1 m, 1e-4 m/s, cells of 0.1 m, steps of 0.01 s, midpoint rule;
      gases as bodies have 1 Pa, 1 K and half of the box each.
    - largest relative error of a period <= 1e-3: the step's error is (omega dt)^2/12 = 3e-4
    - isothermal over isentropic period in [1.1, 1.115]: theory: 1.1068; (omega dt)^2/12 in both
    - a wave of the stiffened gas off its isentrope, relative <= 1e-3: (pi h)^2/8 of 2 %, P1
    """)
def _sound() -> Measured:
    isentropic = 2 / math.sqrt(STIFFNESS + COUPLING**2 * THETA_R / C)
    denser = nv.Thermal(c=1.5, gruneisen=2 / 3, theta_R=1.0)
    liquid = nv.Thermal(c=5.0, gruneisen=2.0, theta_R=1.0, p_infinity=9.0)
    stiffened, off = _stiffened()
    rows: list[list[Any]] = [
        ["body without heat: isothermal", _period(_elastic(warm=False)), 2 / math.sqrt(STIFFNESS)],
        ["the same with heat: isentropic", _period(_elastic()), isentropic],
        ["ideal gas, gamma = 1.4: isentropic", _period(nv.Model(material=IDEAL)), 2 / math.sqrt(1.4)],
        ["stiffened gas, gamma = 4.4: isentropic", _period(stiffened, 0.003), 2 / math.sqrt(4.4 * 3.4 * 2.5)],
        ["gas beside one of 4 kg/m3", *_beside(denser, 5 / 3, 4.0)],
        ["gas beside a liquid 21 times as stiff", *_beside(liquid, 30.0, 4.0)],
    ]
    yield "largest relative error of a period", max(abs(found / exact - 1) for _, found, exact in rows)
    yield "isothermal over isentropic period", rows[0][1] / rows[1][1]
    yield "a wave of the stiffened gas off its isentrope, relative", off
    head = "body | measured, s | theory, s"
    yield from Table("standing waves in a box of 1 m", head, rows).drawn(None, 1, 2)


def _slab_error(h: float, solver: str) -> float:
    """The error for a slab, insulated at x = 0, that cools in its slowest mode, cos(b x) with b tan b =
    Bi."""
    kappa, c, coefficient, around = 0.4, 2.0, 0.6, 300.0
    b = brentq(lambda b: b * math.tan(b) - coefficient / kappa, 1e-3, 1.5)
    material = nv.Thermal(material=nv.LinearElastic(K_e=1e3, G_e=1e3), c=c, theta_R=around)
    walls: Any = {"right": nv.Slip(heat=nv.WallHeat(temperature=around, coefficient=coefficient))}
    run = nv.Simulation(
        box((1, 0.25), maxh=h),
        nv.Model(material=material, heat=nv.Heat(conductivity=kappa)),
        dt=0.2 * h,
        walls=walls,
        initial=nv.Initial(density=1e3, temperature=around + 50 * cos(b * x)),
        scheme="midpoint",
        solver=solver,
    )
    run.run(10 * 0.04)
    exact = around + 50 * math.exp(-kappa / c * b * b * 0.4) * cos(b * x)
    return distance(run.fields["temperature"], exact, run.mesh)


@CASES("""heat-slab
    A slab cools through a wall in its slowest mode; the error is of second order with both solvers.
    label: Carslaw and Jaeger, b tan b = Bi; heat-wall
    setting: Slab of 1 m, Bi = 1.5, 50 K above its surroundings, until 0.4 s; dt = h/5, midpoint rule.
    - rate of the error >= 1.8: 2 by P1
    - difference of the solvers over the error <= 1e-8: the same equations
    - closure
    """)
def _slab() -> Measured:
    table = RateTable("temperature of the slab, L2 error, K")
    for h in (0.2, 0.1, 0.05):
        table.add(h, theta=_slab_error(h, "coupled"))
    split = _slab_error(0.2, "split")
    yield "rate of the error", table.last("theta")
    yield "difference of the solvers over the error", abs(split / table.errors["theta"][0] - 1)
    yield table


@CASES("""heat-brinkman
    Viscous heating of plane Couette flow between cooling plates follows the closed form.
    label: Brinkman 1951; heat-entropy
    setting: Periodic channel of 1 m, eta V^2/kappa = 8 K, plates with 100 W/(m^2 K), until 0.5 s.
    - rate of the error >= 1.7: 2 by P1; set after a first run
    - error of the heat that leaves through the top, relative <= 1e-3: set after a first run
    """)
def _brinkman() -> Measured:
    eta, kappa, V, coefficient, table = 0.5, 0.25, 2.0, 100.0, RateTable("steady temperature, L2 error, K")
    exact = 300 + eta * V * V / 2 * (y * (1 - y) / kappa + 1 / coefficient)
    held = nv.WallHeat(temperature=300.0, coefficient=coefficient)
    walls: Any = {"top": nv.PrescribedTangential((V, 0.0), heat=held), "bottom": nv.NoSlip(heat=held)}
    for h in (0.5, 0.25, 0.125):
        model = nv.Model(
            material=nv.Thermal(material=fluid(100.0), c=0.05, theta_R=300.0),
            viscosity=stokes(eta),
            heat=nv.Heat(conductivity=kappa),
        )
        start = nv.Initial(density=1.0, velocity=(V * y, 0.0))
        run = nv.Simulation(channel(1, 1, maxh=h), model, dt=0.05, walls=walls, initial=start)
        heat = -run.run(0.5).column("power_heat_top")[-1]
        table.add(h, theta=distance(run.fields["temperature"], exact, run.mesh))
    yield "rate of the error", table.last("theta")
    yield "error of the heat that leaves through the top, relative", abs(heat / (eta * V * V / 2) - 1)
    yield table


def _thermoelastic(kappa: float) -> complex:
    """Decay and frequency of a standing wave, by the cubic equation of the linear theory."""
    k = math.pi
    stiffness = C * STIFFNESS * k**2 + COUPLING**2 * THETA_R * k**2
    roots = np.roots([C, kappa * k**2, stiffness, STIFFNESS * kappa * k**4])
    return complex(max(roots, key=lambda s: s.imag))


@CASES("""heat-thermoelastic
    Waves have the thermoelastic damping and dispersion of the linear theory, from adiabatic to isothermal.
    label: Zener 1937; Chadwick 1960: (rho s^2 + M k^2)(c s + kappa k^2) + (Gamma c)^2 theta_R s k^2 = 0
    setting: Standing waves of 2 m started in their modes, until 0.5 s; five conductivities.
    - largest error of velocity and temperature over their amplitudes <= 5e-3: (omega dt)^2/12 omega T =
      1.4e-3; set after a first run
    """)
def _damping() -> Measured:
    rows, errors, T, k = [], [], 0.5, math.pi
    for kappa in (0.02, 0.2, 0.6, 2.0, 20.0):
        s = _thermoelastic(kappa)
        warm = -COUPLING * THETA_R * s * k / (C * s + kappa * k * k)
        stretch = CF((1 + SMALL * k * cos(k * x), 0, 0, 0, 1, 0, 0, 0, 1), dims=(3, 3))
        start = nv.Initial(
            density=1.0,
            F=stretch,
            velocity=(SMALL * s.real * sin(k * x), 0.0),
            temperature=THETA_R + SMALL * warm.real * cos(k * x),
        )
        options: Any = {"initial": start, "scheme": "midpoint", "solver": "coupled"}
        run = nv.Simulation(box((1, 0.2), maxh=0.1), _elastic(kappa), dt=0.01, **options)
        run.run(T)
        v = 10 / SMALL * Integrate(run.fields["velocity"][0] * sin(k * x), run.mesh)
        theta = 10 / SMALL * Integrate(run.fields["temperature"] * cos(k * x), run.mesh)
        motion, heat = s * np.exp(s * T), warm * np.exp(s * T)
        errors.append(max(abs(v - motion.real) / abs(motion), abs(theta - heat.real) / abs(heat)))
        rows.append([kappa, s.real, s.imag, v, motion.real, theta, heat.real])
    yield "largest error of velocity and temperature over their amplitudes", max(errors)
    head = "kappa, W/(m K) | decay, 1/s | frequency, 1/s | v | theory | theta - theta_R | theory"
    yield from Table(f"standing waves after {T} s", head, rows).drawn(0, 3, 4, 5, 6, log="x")


# --- flows ---------------------------------------------------------------------------------------------

START, RATE, ENERGY = 300.0, 2.0, 2e4
"""Start, K, shear rate, 1/s, activation energy, J/mol."""
SPEED, INLET, KAPPA, SOURCE = 1.0, 310.0, 0.5, 10.0
"""Numbers of a stream: velocity, m/s, temperature, K, conductivity, W/(m K), and source, W/m^3."""


def _stream(cells: int, solver: str) -> nv.Simulation:
    material = nv.Thermal(material=nv.LinearElastic(K_e=50.0, G_e=10.0), c=C, theta_R=START)
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
    A stream brings heat through an inlet, is heated on its way, and takes heat out: its temperature agrees
      with the closed form, and energy and entropy balance.
    label: heat-entropy; c V theta' = q + kappa theta'' with the conditions of Danckwerts (1953)
    setting: 1 m x 0.25 m, {SPEED:g} m/s, inlet {INLET:g} K, c = {C:g} J/(m3 K), kappa = {KAPPA:g} W/(m K),
      source {SOURCE:g} W/m3; 4, 8 and 16 cells along, backward Euler until 12 s, where it is steady.
    - error of the temperature over its rise <= 2e-3: cells, and mixing at the inlet, 5e-4
    - error with an inlet that holds the temperature >= 0.05: another condition must be detected
    - dissipation by mixing at the inlet over theory, less one <= 0.05: c V dtheta^2/(2 theta): entropy is
      carried, and none made where streams mix
    - defect of the entropy's balance <= 1e-10: it closes to rounding, like the energy's
    - difference of the solvers over the rise <= 1e-8: the same equations
    - closure
    """)
def _heated_stream() -> Measured:
    """The solution of c V theta' = q + kappa theta'' from 0 to 1.

    The conditions are c V (theta - theta_in) = kappa theta' at 0 and theta' = 0 at 1, as no heat is conducted
    beyond the walls (Danckwerts 1953)."""
    rise, length, volume, rows = SOURCE / (C * SPEED), KAPPA / (C * SPEED), 0.25, []
    along = x - length * exp((x - 1) / length)

    def off(f: CoefficientFunction) -> float:
        return float(np.sqrt(Integrate(f * f, run.mesh) / volume)) / rise

    for cells in (4, 8, 16):
        run = _stream(cells, "split")
        theta = run.fields["temperature"]
        starts = length, length * np.exp(-1 / length)
        rows.append([cells, *(off(theta - INLET - rise * (along + start)) for start in starts), closure(run)])
    other, column = _stream(16, "coupled"), run.ledger.column
    rates = sum(column(name) for name in run.ledger.columns if name.startswith("entropy_"))
    left = np.diff(column("entropy")) - (column("dt") * rates)[1:]
    jump = rise * length * (1 - np.exp(-1 / length))
    mixing = C * SPEED * jump**2 / (2 * (INLET + jump / 2)) * volume
    yield "error of the temperature over its rise", rows[-1][1]
    yield "error with an inlet that holds the temperature", rows[-1][2]
    over = column("dissipation_inflow_left")[-1] / mixing
    yield "dissipation by mixing at the inlet over theory, less one", abs(over - 1)
    yield "defect of the entropy's balance", abs(left).max() / column("entropy")[-1]
    yield "difference of the solvers over the rise", off(theta - other.fields["temperature"])
    head = "cells along | error over the rise | the same of an inlet that holds theta | closure"
    yield from Table("a stream that is heated on its way", head, rows).drawn(0, 1, 2, log="xy")
    yield "Numbers of trials, until 8 s, were seen before the bounds were written."


K, N = 40.0, 0.6
"""A fluid's consistency, Pa s^n, and exponent."""
G, A, M = 20.0, 1e-4, 3.0
"""G_e of a body, Pa; the rate of Norton's law at 1 Pa, 1/s; the exponent of Norton's law."""


def _faster(theta: float) -> float:
    """The factor by which Arrhenius's law accelerates creep at a temperature."""
    return float(np.exp(ENERGY / 8.31446261815324 * (1 / START - 1 / theta)))


def _fluid(_t: float, u: np.ndarray) -> np.ndarray:
    """The warming of a fluid by c theta' = K rate^(n+1)/a."""
    return np.array([K * RATE ** (N + 1) / _faster(u[0]) / C])


def _body(_t: float, u: np.ndarray) -> np.ndarray:
    """The warming of a creeping body in simple shear by F' = L F - F Pi and c theta' = M : Pi.

    Pi = a A |M|^(n-1) M, M = F^T T F^-T, T = 2 G dev F F^T, since J = 1.
    """
    F, theta = u[:9].reshape(3, 3), u[9]
    L = np.zeros((3, 3))
    L[0, 1] = RATE
    B = F @ F.T
    mandel = F.T @ (2 * G * (B - np.trace(B) / 3 * np.eye(3))) @ np.linalg.inv(F.T)
    Pi = _faster(theta) * A * np.sum(mandel * mandel) ** ((M - 1) / 2) * mandel
    return np.append((L @ F - F @ Pi).ravel(), np.sum(mandel * Pi) / C)


def _warmed(dt: float, solver: str, material: nv.Material, **laws: Any) -> float:
    """The temperature after a second, K."""
    warm = nv.Thermal(material=material, c=C, theta_R=START)
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
    return float(run.fields["temperature"](run.mesh(0.4, 0.4)))


@CASES("""heat-shear
    In adiabatic shear a power-law fluid and a creeping body, both weakened by heat, warm as the equations
    say.
    label: heat-entropy; c theta' = tau rate with Arrhenius's factor, by SciPy's LSODA
    setting: Homogeneous shear at 2/s for 1 s from 300 K, E = 20 kJ/mol; two cells, midpoint rule.
    - largest relative error of the warming, 0.05 s <= 2e-3: (rate dt)^2/12 = 8e-4
    - least order in time >= 1.8: 2
    - difference of the solvers over the warming <= 1e-8: the same equations
    - closure
    """)
def _shear_heating() -> Measured:
    thinning = nv.PowerLaw(K_v=1.0, consistency=K, n=N, floor=1e-6)
    of_fluid = {"viscosity": nv.ActivatedViscosity(viscosity=thinning, E=ENERGY, theta_R=START)}
    of_body = {
        "creep": nv.Activated(rule=nv.Norton(A=A, n=M), E=ENERGY, theta_R=START),
        "viscosity": nv.StokesViscosity(K_v=1e-9, G_v=1e-9),
    }
    gel = nv.IsochoricNeoHookean(K_e=200.0, G_e=G, elastic_state="B")
    kinds: dict[str, tuple[Any, np.ndarray, nv.Material, dict[str, Any]]] = {
        "fluid": (_fluid, np.array([START]), nv.ReferentialNeoHookean(K_e=200.0, G_e=1e-9), of_fluid),
        "Norton's body": (_body, np.append(np.eye(3).ravel(), START), gel, of_body),
    }
    rows = []
    for name, (slope, start, material, laws) in kinds.items():
        exact = solve_ivp(slope, (0, 1), start, method="LSODA", rtol=1e-11, atol=1e-11).y[-1, -1]
        steps = ((0.1, "coupled"), (0.05, "coupled"), (0.05, "split"))
        coarse, fine, split = (
            abs(_warmed(dt, solver, material, **laws) - exact) / (exact - START) for dt, solver in steps
        )
        rows.append([name, exact, coarse, fine, split])
    yield "largest relative error of the warming, 0.05 s", max(max(row[3:]) for row in rows)
    yield "least order in time", min(np.log2(row[2] / row[3]) for row in rows)
    yield "difference of the solvers over the warming", max(abs(row[4] - row[3]) for row in rows)
    head = "body | reference, K | error of the warming, 0.1 s | 0.05 s | 0.05 s, split solver"
    yield from Table(f"temperature after a shear of {RATE:g} in 1 s, adiabatic", head, rows).drawn(
        None, 2, 3, 4, log="y"
    )
