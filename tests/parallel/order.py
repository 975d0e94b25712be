"""Computes results that must not depend on which rank is late; the first rank prints the results as JSON.

``test_order_of_sums`` runs this script. In each run another rank is late, in all sums over ranks of NGSolve
and of the package.
"""

import hashlib
import json
import sys
import time
from typing import Any

import runs
from ngsolve import CF, BilinearForm, GridFunction, VectorH1, cos, exp, sin, x, y, z

from ngvisco.geometries import box
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.exchange import Exchange, Interpolation
from ngvisco.parallel.mesh import distributed

LATE = [0]
"""Number of the rank that is late."""


def made_late(cls: type, name: str, seconds: float) -> None:
    on_time = getattr(cls, name)

    def late(*arguments: Any, **words: Any) -> Any:
        if Communicator.world().rank == LATE[0]:
            time.sleep(seconds)
        return on_time(*arguments, **words)

    setattr(cls, name, late)


made_late(GridFunction, "Set", 0.03)
made_late(BilinearForm, "Apply", 0.03)
made_late(Exchange, "sum", 1e-3)


def digest(function: GridFunction) -> str:
    return hashlib.sha1(function.vec.FV().NumPy().tobytes()).hexdigest()


def interpolated() -> list[Any]:
    ranks = Communicator.world()
    mesh = distributed(box((1, 1, 1), maxh=0.4) if ranks.is_first else None, ranks)
    function = GridFunction(VectorH1(mesh, order=2))
    interpolate, value = Interpolation(function.space), CF((sin(3 * x) * cos(y), exp(x * y), z + x * x))
    found = []
    for where in (None, mesh.Boundaries("top|left|front")):
        interpolate(function, value, where)
        found.append(digest(function))
    return found


def solved(solver: str) -> list[Any]:
    run = runs.block(solver, 0.35)
    start = digest(run.rothe_step.state)
    row = run.advance()
    return [start, {key: float(value) for key, value in row.items()}, digest(run.rothe_step.state)]


if __name__ == "__main__":
    ranks, found = Communicator.world(), {}
    for name in sys.argv[1:]:
        found[name] = []
        for LATE[0] in (1, 2):
            of_rank = interpolated() if name == "interpolated" else solved(name)
            found[name].append(ranks.gathered(of_rank))
    if ranks.is_first:
        print(json.dumps(found))
