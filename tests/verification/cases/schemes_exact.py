"""Time schemes: order against exact solutions of shear and flow, and against manufactured ones."""

import math
from functools import partial
from itertools import pairwise

import numpy as np
from ngsolve import sin

import ngvisco as nv
from ngvisco.forms.context import time
from ngvisco.geometries import channel
from tests.verification.case import Cases, Outcome, measured
from tests.verification.cases.rheology import startup
from tests.verification.cases.schemes import LABEL, SECOND_ORDER
from tests.verification.convergence import free_solution, separation
from tests.verification.models import KINDS as MODELS
from tests.verification.rates import RateTable
from tests.verification.setups import KINDS, closure

CASES = Cases()


def channel_velocity(y: np.ndarray, t: float, nu: float, speed: float) -> np.ndarray:
    """Couette start-up of a Newtonian fluid whose upper wall moves at speed sin²(t): Fourier's series."""
    n = np.arange(1, 200)[:, None]
    decay, modes = nu * (math.pi * n) ** 2, np.sin(math.pi * n * y)
    # of the wall's acceleration sin(2 t): int_0^t exp(-decay (t - s)) sin(2 s) ds
    memory = (decay * math.sin(2 * t) - 2 * math.cos(2 * t) + 2 * np.exp(-decay * t)) / (decay**2 + 4)
    return speed * (math.sin(t) ** 2 * y + (2 * (-1.0) ** n / (math.pi * n) * modes * memory).sum(axis=0))


def _couette(scheme: str) -> Outcome:
    """A lid that is accelerated smoothly over a Newtonian channel, against Fourier's series."""
    nu, speed, until = 0.2, 0.1, 1.5
    table, runs = RateTable("largest error of v_1 on a line, relative to the wall's speed"), []
    y = np.linspace(0.05, 0.95, 19)
    for steps in (6, 12, 24):
        run = nv.Simulation(
            channel(0.5, 1, maxh=0.2),
            nv.Model(
                material=nv.BarotropicFluid(B=1.0, gamma=1.4),
                viscosity=nv.StokesViscosity(K_v=nu, G_v=nu / 2),
            ),
            dt=until / steps,
            walls={"top": nv.PrescribedTangential((speed * sin(time) ** 2, 0)), "bottom": nv.NoSlip()},
            initial=nv.Initial(density=0.5),
            discretisation=nv.Discretisation(k=3, m=2),
            scheme=scheme,
        )
        run.run(until)
        v = np.array([run.fields["velocity"](run.mesh(0.21, s))[0] for s in y])
        exact = channel_velocity(y, until, nu, speed)
        table.add(until / steps, v=float(np.abs(v - exact).max() / speed))
        runs.append(run)
    return measured(
        {
            "rate of v in tau": table.last("v"),
            "error at 24 steps": table.errors["v"][-1],
            "largest |closure|": closure(*runs),
        },
        table.table("tau, s"),
        table.plot("tau, s", "error"),
    )


# --- manufactured solutions, the swirl ---------------------------------------------------------------------


def _manufactured(scheme: str, kind: str) -> Outcome:
    """One mesh, sources that drive all terms, steps tau to tau/4 against tau/8 extrapolated by the order."""
    duration, coarsest = 0.1, 4
    runs = [
        free_solution(kind, n * coarsest, duration, p=2.0, driven=True, scheme=scheme, velocity_scale=3e3)
        for n in (1, 2, 4, 8)
    ]
    table = RateTable(f"differences of successive steps, {kind}")
    for n, (coarse, fine) in zip((1, 2, 4), pairwise(runs), strict=True):
        table.add(duration / (n * coarsest), **separation(fine, coarse))
    return measured(
        {f"rate of {name}": table.last(name) for name in table.errors},
        table.table("tau, s"),
        table.plot("tau, s", "difference in L2"),
        "The upwinding is smooth here (0.3 m/s): a sharp one makes v piecewise smooth in time.",
    )


for scheme in SECOND_ORDER:
    midpoint = scheme == "midpoint"
    for kind in KINDS:
        CASES(f"""jeffreys-startup-{kind}-{scheme}
            By {scheme} start-up of shear of a Jeffreys material in {KINDS[kind]} follows its ODE to second
              order.
            label: {"ED-Euler-large2, ED-Euler-large3" if kind == "finite" else "Euler-small-flow-rule"}
            setting: The channel of jeffreys-startup; 20, 40, 80 steps until 4 s.
            - rate of T_12 >= 1.9: second order
            - rate of T_11 − T_22 >= 1.9: second order
            - error at the finest step <= 1e-3: a fiftieth of backward Euler's bound
            - closure
            """)(partial(startup, kind, scheme))
    CASES(f"""couette-startup-{scheme}{" (reduced)" * midpoint}
        By {scheme} a Newtonian fluid under a lid that is accelerated follows Fourier's
          {"series, to second order." if midpoint else "series, to order 1.5 at least."}
        label: Euler-small-viscoelastodyn+1
        setting: Channel of 1 m, P3 velocity, rho = 0.5 kg/m3, D = 0.1 Pa s of shear, lid 0.1 sin²(t) m/s
          until 1.5 s; 6, 12, 24 steps.
        - rate of v in tau >= {
        "1.9: second order"
        if midpoint
        else "1.5: order reduction: its stages are of order one where a wall's velocity changes"
    }
        - error at 24 steps <= 2e-3: tau = 0.0625 s
        - closure
        """)(partial(_couette, scheme))


ORDERS = {"backward-euler": (1, 0.85), "midpoint": (2, 1.9), "sdirk2": (2, 1.9)}
"""Order in time, and the rate asked for."""

for scheme, (order, least) in ORDERS.items():
    for kind in MODELS:
        CASES(f"""order-in-time-{"finite" if kind == "neo-hookean" else "linearised"}-{scheme}
            With manufactured sources that drive every term, {scheme} is of order {order} in v, rho and z.
            label: {LABEL}
            setting: Creep, gravity, viscosity, hyperviscosity, delta- and epsilon-terms; one mesh,
              differences of successive runs of 4, 8, 16, 32 steps in 0.1 s.
            - rate of [v; rho; z] >= {least}: order {order}
            """)(partial(_manufactured, scheme, kind))
