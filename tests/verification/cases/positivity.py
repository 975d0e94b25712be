"""Runs that leave their bounds at points: limited, and ended where they are not."""

import numpy as np

import ngvisco as nv
from ngvisco.geometries import box
from tests.verification.case import Cases, Curve, Outcome, Plot, Table, measured
from tests.verification.setups import closure, drift, lid_driven

CASES = Cases("Robustness of the scheme")

DT, END = 0.02, 0.4
SCHEMES = ("backward-euler", "midpoint", "sdirk2")


def cavity(scheme: str, limiter: bool) -> nv.Simulation:
    """The body of demos/cavity; without a limiter steps are not tried in other ways."""
    steps = None if limiter else nv.AdaptiveSteps(dt_min=DT, dt_max=DT)
    time = nv.TimeSteps(dt=DT, scheme=scheme, limiter=limiter, adaptive=steps)  # type: ignore[arg-type]
    of = nv.NeoHookean(K_e=20.0, G_e=0.05, epsilon=0.1, elastic_state="F")
    return lid_driven(box((1, 1), 0.1), of, time=time)


@CASES(f"""limited-cavity
    A body under a lid that starts at full speed, up to its corners, is torn there: cells whose means are
      positive are limited, mass and the energy's balance kept, and the run goes on.
    label: Zhang and Shu, J. Comput. Phys. 229 (2010); paper: Euler-large-ass-phi
    setting: demos/cavity: a unit box of 230 triangles, the lid at 1 m/s from t = 0 on, other walls without
      slip; neo-Hookean, K_e = 20, G_e = 0.05, epsilon = 0.1 Pa, viscosities 0.01 Pa s, mu = 1e-5, p = 4; 20
      steps of 0.02 s.
    - time reached with a limiter, s >= {END * (1 - 1e-09)}: the run's end
    - latest time reached without, s <= 0.3: the finding: it ends
    - closure
    - largest |mass drift| <= 1e-11: rounding, and the transport's tolerance
    - most iterations of a solve <= 30.0: an impulsive start and none harder after it
    """)
def _measured() -> Outcome:
    rows: list[list[str | float]] = []
    curves, worst = [], dict.fromkeys(("closure", "mass", "iterations"), 0.0)
    reached, ended = END, 0.0
    for scheme in SCHEMES:
        for limiter in (True, False):
            run = cavity(scheme, limiter)
            try:
                run.run(END)
            except nv.StepError:
                ended = max(ended, run.t)
            ledger = run.ledger
            column = {name: ledger.column(name)[1:] for name in ("newton_iterations", "limited_cells")}
            off, mass = closure(run), drift(run)
            its = column["newton_iterations"]
            solved = run.t, its[0], np.median(its), its.max()
            limited = column["limited_cells"].sum(), ledger.column("limiter").sum()
            rows.append([scheme, "on" if limiter else "off", *solved, *limited, off, mass])
            if limiter:
                reached = min(reached, run.t)
                stages = run.scheme.stages
                worst["closure"], worst["mass"] = max(worst["closure"], off), max(worst["mass"], mass)
                worst["iterations"] = max(worst["iterations"], float(its.max()) / stages)
                curves.append(Curve(scheme, ledger.column("time")[1:], column["limited_cells"], ".-"))
    return measured(
        {
            "time reached with a limiter, s": reached,
            "latest time reached without, s": ended,
            "largest |closure|": worst["closure"],
            "largest |mass drift|": worst["mass"],
            "most iterations of a solve": worst["iterations"],
        },
        Table(
            "runs with and without",
            "scheme | limiter | t reached, s | iterations: first step | median | most | limited cells | "
            "limiter, J | |closure| | |mass drift|",
            rows,
        ),
        Plot("Cells that were limited", "time, s", "cells", curves),
        "Limited cells are counted once for each step. Without a limiter a run ends with the first "
        "solution that is not positive at a point.",
    )
