"""Flow rules against ordinary differential equations, closed forms and flow curves of viscoplastic fluids.

The rates are written here once more, in NumPy and by the literature's formulas, and SciPy integrates them.
"""

import math
from collections.abc import Callable

import numpy as np
from ngsolve import CF
from scipy.integrate import solve_ivp

import ngvisco as nv
from ngvisco.geometries import box, channel
from tests.verification.case import Cases, Curve, Outcome, Plot, Table, measured
from tests.verification.cases.rheology import NAMES, G, deviator, material, shear_stress, start
from tests.verification.cases.shear import sheared
from tests.verification.rates import RateTable

CASES = Cases("Exact solutions: flow rules")

Rate = Callable[[float, float, float], float]
"""|Pi|, 1/s, of |M|, Pa, the plastic strain k and the pressure p, Pa."""


def over(m: float, tension: float) -> float:
    """What |M| exceeds the size of a uniaxial stress by."""
    return max(m - math.sqrt(2 / 3) * tension, 0.0)


def frictional(p: float) -> float:
    """sqrt(2) (c cos phi + p sin phi) with c = 0.3 Pa, phi = 30 degrees."""
    return math.sqrt(2) * max(0.3 * math.cos(math.pi / 6) + p / 2, 0.0)


RULES: dict[str, tuple[nv.FlowRule, Rate]] = {
    "linear": (nv.Creep(G_m=2.0), lambda m, k, p: m / 2),
    "Norton, n = 3": (nv.Norton(A=0.3, n=3), lambda m, k, p: 0.3 * m**3),
    "Norton, n = 10": (nv.Norton(A=0.2, n=10), lambda m, k, p: 0.2 * m**10),
    "Bingham": (nv.Perzyna(sigma_Y=0.5, G_m=0.5), lambda m, k, p: over(m, 0.5) / 0.5),
    "Perzyna, n = 2.5": (
        nv.Perzyna(sigma_Y=0.5, G_m=0.5, n=2.5),
        lambda m, k, p: (s := math.sqrt(2 / 3) * 0.5) / 0.5 * (over(m, 0.5) / s) ** 2.5,
    ),
    "linear hardening": (
        nv.Perzyna(sigma_Y=0.5, G_m=0.5, H=0.5),
        lambda m, k, p: over(m, 0.5 + 0.5 * k) / 0.5,
    ),
    "Voce": (
        nv.Perzyna(sigma_Y=0.5, G_m=0.5, Q=0.5, b=4.0),
        lambda m, k, p: over(m, 0.5 + 0.5 * (1 - math.exp(-4 * k))) / 0.5,
    ),
    "Drucker-Prager": (
        nv.DruckerPrager(cohesion=0.3, friction_angle=30.0, G_m=0.5),
        lambda m, k, p: max(m - frictional(p), 0.0) / 0.5,
    ),
    "Eyring": (nv.Eyring(A=0.5, sigma_0=0.5), lambda m, k, p: 0.5 * math.sinh(m / 0.5)),
    "composite": (
        nv.Composite(rules=(nv.Creep(G_m=5.0), nv.Norton(A=0.2, n=4))),
        lambda m, k, p: m / 5 + 0.2 * m**4,
    ),
}
SHEAR_RATE, UNTIL, STEPS = 1.0, 1.0, (20, 40)


def final_stress(kind: str, rate: Rate, factor: float) -> float:
    """T_12 after start-up of shear by the equations of the tensor and of k, with a factor of the rate."""
    L = np.zeros((3, 3))
    L[0, 1] = SHEAR_RATE
    D, W = (L + L.T) / 2, (L - L.T) / 2

    def derivative(_: float, values: np.ndarray) -> np.ndarray:
        A, k = values[:9].reshape(3, 3), values[9]
        M = 2 * G * deviator(A) if kind == "linearised" else deviator(G * A.T @ A)
        # that of the linearised model has the energy per actual volume in it, the other none at J = 1
        p = -G * float((deviator(A) ** 2).sum()) if kind == "linearised" else 0.0
        m = float(np.linalg.norm(M))
        size = factor * rate(m, k, p)
        Pi = size / m * M if m > 0 else 0 * M
        dA = D + W @ A - A @ W - Pi if kind == "linearised" else L @ A - A @ Pi
        return np.append(dA, math.sqrt(2 / 3) * size)

    begin = np.append(start(kind), 0.0)
    solution = solve_ivp(derivative, (0, UNTIL), begin, method="LSODA", rtol=1e-9, atol=1e-11)
    return float(shear_stress(kind, solution.y[:9, -1])[0, 1])


def _sheared(kind: str, rule: nv.FlowRule, steps: int, scheme: str = "backward-euler") -> float:
    """T_12 at the end of the start-up of shear."""
    mesh, tau = channel(1, 1, maxh=1.0), UNTIL / steps
    _, values = sheared(material(kind), tau, UNTIL, rate=SHEAR_RATE, creep=rule, mesh=mesh, scheme=scheme)
    return float(values[-1, 1])


@CASES(f"""flow-rules-startup
    Start-up of shear by every flow rule, in the linearised model and at finite strain by F and by B, follows
      the ordinary differential equations of the tensor and of the plastic strain.
    label: Euler-small-flow-rule, ED-Euler-large2, ED-Euler-large3
    setting: G = {G:g} Pa, channel of 1 m x 1 m, shear rate 1/s until 1 s; 20 and 40 steps of backward Euler,
      extrapolated to none.
    - largest error, extrapolated <= 5e-3: second order in tau but where yield begins
    - least distance to rates smaller by a fifth >= 1e-2: a wrong rate is told from the right
    - closure
    """)
def _point() -> Outcome:
    rows: list[list[str | float]] = []
    largest, mistaken = 0.0, math.inf
    for name, (rule, rate) in RULES.items():
        for kind in NAMES:
            found = [_sheared(kind, rule, steps) for steps in STEPS]
            exact, wrong = (final_stress(kind, rate, factor) for factor in (1.0, 0.8))
            extrapolated = 2 * found[1] - found[0]
            errors = [abs(value / exact - 1) for value in (*found, extrapolated)]
            largest, mistaken = max(largest, errors[-1]), min(mistaken, abs(extrapolated / wrong - 1))
            rows.append([name, kind, exact, *errors])
    return measured(
        {
            "largest error, extrapolated": largest,
            "least distance to rates smaller by a fifth": mistaken,
        },
        Table(
            "T_12 after a shear of one",
            ["rule", "model", "exact, Pa", *(f"error, {n} steps" for n in STEPS), "extrapolated"],
            rows,
        ),
    )


MIDPOINT = {"linear": True, "Norton, n = 3": True, "Bingham": False, "linear hardening": False}
"""Rules, and whether their rate has a derivative; those with yield begin to flow within a step."""


@CASES("""flow-rules-midpoint
    The midpoint rule is of second order with creep, and with yield too, although that begins within a step.
    label: Euler-small-flow-rule, ED-Euler-large3
    setting: As flow-rules-startup; 10 to 80 steps of the midpoint rule, order over all of them.
    - least order of a rate with a derivative >= 1.85: second order
    - least order with yield >= 1.6: in one step the rate has a kink: an error of second order that wavers
      with the place of it
    - closure
    """)
def _midpoint() -> Outcome:
    """Errors of T_12 after the start-up of shear, over the steps of the midpoint rule."""
    tables, curves = [], []
    least = {True: math.inf, False: math.inf}
    for kind in NAMES:
        table = RateTable(f"error of T_12, {NAMES[kind]}")
        sizes = [UNTIL / n for n in (10, 20, 40, 80)]
        errors: dict[str, list[float]] = {}
        for name in MIDPOINT:
            rule, rate = RULES[name]
            exact, errors[name] = final_stress(kind, rate, 1.0), []
            for tau in sizes:
                errors[name].append(abs(_sheared(kind, rule, round(UNTIL / tau), "midpoint") - exact))
        for i, tau in enumerate(sizes):
            table.add(tau, **{name: found[i] for name, found in errors.items()})
        for name, is_smooth in MIDPOINT.items():
            order = math.log(errors[name][0] / errors[name][-1]) / math.log(sizes[0] / sizes[-1])
            least[is_smooth] = min(least[is_smooth], order)
            curves.append(Curve(f"{name}, {kind}", sizes, errors[name]))
        tables.append(table.table("tau, s"))
    return measured(
        {
            "least order of a rate with a derivative": least[True],
            "least order with yield": least[False],
        },
        *tables,
        Plot("Start-up of shear by the midpoint rule", "tau, s", "error of T_12, Pa", curves, log="xy"),
    )


@CASES("""norton-relaxation
    A stress relaxes by power-law creep as the closed form says.
    label: Euler-small-flow-rule
    setting: n = 3, A = 0.3/(s Pa^3), G = 1 Pa; a box that cannot move, stretched by 0.5, until 1 s.
    - rate of |E| >= 0.85: implicit Euler
    - error at the finest step <= 0.02: first order, tau = 0.0125 s
    - closure
    """)
def _relaxation() -> Outcome:
    """|E|^(1-n) grows linearly: d|E|/dt = -A (2 G |E|)^n in a body that cannot move."""
    A, n, until, begin = 0.3, 3, 1.0, 0.5
    table = RateTable("error of |E|, relative to its start")
    direction = np.diag([2.0, -1.0, -1.0]) / math.sqrt(6)
    F = CF(tuple((np.eye(3) + begin * direction).ravel()), dims=(3, 3))
    exact = (begin ** (1 - n) + (n - 1) * A * (2 * G) ** n * until) ** (1 / (1 - n))
    for steps in (20, 40, 80):
        model = nv.Model(material=nv.LinearElastic(K_e=50.0, G_e=G), creep=nv.Norton(A=A, n=n))
        run = nv.Simulation(box((1, 1), maxh=1.0), model, dt=until / steps, initial=nv.Initial(F=F))
        run.run(until)
        E = np.array(run.fields["E"](run.mesh(0.3, 0.4)))
        table.add(until / steps, E=abs(float(np.linalg.norm(E)) - exact) / begin)
    return measured(
        {
            "rate of |E|": table.last("E"),
            "error at the finest step": table.errors["E"][-1],
        },
        table.table("tau, s"),
    )


@CASES("""viscoplastic-flow-curve
    The shear stress of a steady flow is that of Bingham's and Perzyna's fluids at its rate.
    label: Bingham 1916, Perzyna 1966
    setting: sigma_Y = 1.5 Pa, G_m = 0.2 Pa s, G = 200 Pa; a channel of 1 m sheared by 0.1 in 20 steps.
    - largest relative error of T_12 <= 1e-3: what is elastic turns by (T_12/G)^2 and less
    - closure
    """)
def _flow_curve() -> Outcome:
    """T_12 = sigma_Y/sqrt(3) + G_m rate/2 of Bingham's fluid, and the like with an exponent."""
    stiff, sigma_Y, rows, largest = 200.0, 1.5, [], 0.0
    for n in (1.0, 2.5):
        for rate in (0.1, 1.0, 10.0):
            s, G_m = math.sqrt(2 / 3) * sigma_Y, 0.2
            rule = nv.Perzyna(sigma_Y=sigma_Y, G_m=G_m, n=n)
            # sheared by a tenth: a hundred times the shear at which it yields
            _, values = sheared(
                nv.LinearElastic(K_e=stiff, G_e=stiff),
                0.005 / rate,
                0.1 / rate,
                rate=rate,
                creep=rule,
                mesh=channel(1, 1, maxh=1.0),
            )
            exact = (s + s * (G_m * rate / math.sqrt(2) / s) ** (1 / n)) / math.sqrt(2)
            error = abs(float(values[-1, 1]) / exact - 1)
            largest = max(largest, error)
            rows.append([n, rate, float(values[-1, 1]), exact, error])
    return measured(
        {"largest relative error of T_12": largest},
        Table("steady shear", "n | rate, 1/s | T_12, Pa | exact, Pa | error", rows),
    )
