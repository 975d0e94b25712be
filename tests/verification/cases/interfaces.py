"""How far interfaces between bodies smear: rigid rotation, Zalesak's disc, a vortex and back."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from ngsolve import CoefficientFunction, IfPos, Mesh, cos, pi, sin, x, y

from ngvisco.geometries import box, disc
from ngvisco.shapes.shape import Where
from tests.verification.case import Cases, Measured, Table
from tests.verification.interfaces import Carrier, Level, carried

CASES = Cases("Bodies and their interfaces")

MAXH = 0.0625
_RADIUS = 0.15


def _ball(X: CoefficientFunction, Y: CoefficientFunction) -> CoefficientFunction:
    return _RADIUS**2 - X * X - (Y - 0.2) * (Y - 0.2)


def _slotted(X: CoefficientFunction, Y: CoefficientFunction) -> CoefficientFunction:
    """Zalesak's: the same with a slot of 0.05 m from below to y = 0.3 m."""
    slot = _least(_least(X + 0.025, 0.025 - X), 0.3 - Y)
    return _least(_ball(X, Y), -slot)


def _least(a: CoefficientFunction, b: CoefficientFunction) -> CoefficientFunction:
    return IfPos(a - b, b, a)


@dataclass(frozen=True)
class _Test:
    """A body, a flow that brings it back, and where."""

    level: Level
    perimeter: float
    flow: tuple[CoefficientFunction, CoefficientFunction]
    factor: Callable[[float], float]
    end: float
    mesh: Callable[[], Mesh]


_ROTATION = (-2 * pi * y, 2 * pi * x)
_VORTEX = (
    -2 * sin(pi * x) ** 2 * sin(pi * y) * cos(pi * y),
    2 * sin(pi * y) ** 2 * sin(pi * x) * cos(pi * x),
)
TESTS = {
    "rotation": _Test(_ball, 2 * math.pi * _RADIUS, _ROTATION, lambda t: 1.0, 1.0, lambda: disc(0.5, MAXH)),
    "zalesak": _Test(
        _slotted, 2 * math.pi * _RADIUS + 0.5, _ROTATION, lambda t: 1.0, 1.0, lambda: disc(0.5, MAXH)
    ),
    "vortex": _Test(
        lambda X, Y: _ball(X - 0.5, Y - 0.5),
        2 * math.pi * _RADIUS,
        _VORTEX,
        lambda t: math.cos(math.pi * t / 2),
        2.0,
        lambda: box((1, 1), MAXH),
    ),
}
CARRIED: tuple[tuple[Carrier, int], ...] = (
    ("amounts", 0),
    ("amounts", 1),
    ("amounts", 2),
    ("rate zero", 1),
    ("reference map", 1),
    ("reference map", 2),
)


def _smear(name: str) -> Measured:
    test, rows, found = TESTS[name], [], {}
    mesh = test.mesh()
    for carrier, m in CARRIED:
        result = carried(
            Where(test.level(x, y)),
            test.level,
            test.perimeter,
            test.flow,
            test.factor,
            test.end,
            mesh=mesh,
            maxh=MAXH,
            m=m,
            carrier=carrier,
        )
        found[carrier, m] = result
        numbers = result.error, result.width, result.least, result.largest, result.drift
        rows.append((carrier, m, *numbers))
    amounts = found["amounts", 1]
    columns = ("carried as", "m", "L1 error/area", "width, cells", "least", "largest", "change of area")
    yield "L1 error of amounts, m = 1", amounts.error
    yield "width of amounts, m = 1, cells", amounts.width
    yield "largest excess over [0, 1]", max(-amounts.least, amounts.largest - 1)
    yield "change of the area, m = 1", abs(amounts.drift)
    yield "L1 error of the reference map, m = 1", found["reference map", 1].error
    yield Table(f"{name}: what is left of the body", columns, rows)


_LIMITS = {"rotation": (0.5, 3.0, 0.25), "zalesak": (0.9, 3.0, 0.6), "vortex": (0.5, 3.5, 0.3)}
_FLOWS = {
    "rotation": "a disc of radius 0.15 m after one turn about a centre 0.2 m away",
    "zalesak": "Zalesak's slotted disc after one turn",
    "vortex": "a disc after a vortex of 1 s there and 1 s back",
}

for (name, what), limits in zip(_FLOWS.items(), _LIMITS.values(), strict=True):
    CASES(f"""interface-{name}{" (reduced)" * (name == "rotation")}
        Of {what} the fraction stays near [0, 1], the area is kept, the interface smears over a few cells.
        label: benchmarks: rigid rotation, Zalesak (1979), LeVeque (1996)
        setting: Cells of {MAXH} m, 100 steps a second by the midpoint rule, limited; amounts of two bodies
          for m = 0, 1, 2, a parameter with rate zero, and a function of the carried coordinates.
        - L1 error of amounts, m = 1 <= {limits[0]}: five cells across the body
        - width of amounts, m = 1, cells <= {limits[1]}: a few cells
        - largest excess over [0, 1] <= 0.3: what a P_1 beside a jump does; stated after
        - change of the area, m = 1 <= 1e-4: conserved but for div v of the given velocity
        - L1 error of the reference map, m = 1 <= {limits[2]}: sharp for ever
        """)(partial(_smear, name))
