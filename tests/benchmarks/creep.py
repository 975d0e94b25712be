"""What a step with a nonlinear flow rule costs over one with linear creep; prints rows as JSON.

A box with linear elasticity (E) or a neo-Hookean solid (B), whose lid starts at once: processor time of steps
2 to 4, the least of runs that take turns, so that what else the machine does tells on all of them.
"""

import json
import sys
import time

from ngsolve import CF, SetNumThreads, x

import ngvisco as nv
from ngvisco.geometries import box

RULES = {
    "linear": nv.Creep(G_m=2.0),
    "Norton, n = 3": nv.Norton(A=0.3, n=3),
    "Bingham": nv.Perzyna(sigma_Y=0.5, G_m=0.5),
}
MATERIALS = {
    "E": nv.LinearElastic(K_e=50.0, G_e=5.0),
    "B": nv.ReferentialNeoHookean(K_e=50.0, G_e=5.0, elastic_state="B"),
}
SIZES = {"split": 0.1, "coupled": 0.3}
"""Of the cells, m, by the solver."""


def seconds(
    rule: str, state: str, solver: str, steps: int = 3, maxh: float | None = None
) -> tuple[float, int]:
    """Processor time and iterations of ``steps`` steps after the first."""
    viscosity = nv.StokesViscosity(K_v=0.1, G_v=0.1)
    model = nv.Model(material=MATERIALS[state], viscosity=viscosity, creep=RULES[rule])
    lid = {"top": nv.PrescribedTangential(CF((16 * x**2 * (1 - x) ** 2, 0)))}
    start = {"initial": nv.Initial(density=1.0), "walls": lid, "solver": solver}
    run = nv.Simulation(box((1, 1), maxh=maxh or SIZES[solver]), model, dt=0.02, **start)
    run.advance()
    began = time.process_time()
    iterations = sum(int(run.advance()["newton_iterations"]) for _ in range(steps))
    return time.process_time() - began, iterations


def measured(turns: int = 3, steps: int = 3, maxh: float | None = None) -> list[dict]:
    """A row for every solver, elastic state and rule, with its cost over that of linear creep."""
    rows = []
    for solver in SIZES:
        for state in MATERIALS:
            found = [
                (rule, seconds(rule, state, solver, steps, maxh)) for _ in range(turns) for rule in RULES
            ]
            least = {rule: min(each for name, each in found if name == rule) for rule in RULES}
            for rule, (time_taken, iterations) in least.items():
                row = {"solver": solver, "state": state, "rule": rule, "seconds": time_taken}
                rows.append(row | {"iterations": iterations, "over linear": time_taken / least["linear"][0]})
    return rows


def main(turns: int = 3) -> None:
    SetNumThreads(1)
    for row in measured(turns):
        print(json.dumps(row))


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
