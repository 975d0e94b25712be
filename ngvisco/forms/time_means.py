"""Means over time of loads, tractions and walls' velocities (paper: g^k_{delta tau}, Euler-small-ass-g).

``rule`` finds times and weights that integrate a function over an interval to ``TOLERANCE`` of its largest
value.  A function may contain conditions; bisection finds its breaks, the times at which conditions change.
Gauss panels between breaks are halved until the halves and the whole agree.  The search evaluates the
function at some points of space. A change without a known break (``ngvisco.physics.signals``) is found if it
lasts for a thirtieth of the interval. All ranks find the same rule.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from heapq import heapify, heappop, heappush
from itertools import pairwise
from typing import TypeAlias

import numpy as np
from ngsolve import (
    L2,
    VOL,
    BilinearForm,
    BitArray,
    CoefficientFunction,
    FacetFESpace,
    FESpace,
    GridFunction,
    LinearForm,
    Mesh,
    Region,
    VectorValued,
    ds,
)

from ngvisco.forms.mesh.mesh_arrays import rules
from ngvisco.parallel.communicator import Communicator
from ngvisco.physics.signals import breaking, time

TOLERANCE = 1e-10
"""Tolerance of a mean relative to the largest value in the interval."""

_NODES, _WEIGHTS = (0.5 * values for values in np.polynomial.legendre.leggauss(5))
_PANELS, _SCANS = 8, 32
"""Number of panels into which a piece is first divided; and number of times at which the sign of a condition
is evaluated."""
_BISECTIONS, _BREAKS, _HALVINGS = 46, 64, 48
"""Bisections of a break, to rounding; largest number of breaks; and largest number of halved panels."""
_ROUNDING = 4e-16
_SHARE = 1.0 / 64  # a shorter panel has the tolerance of a panel with this share of the interval
_POINTS = 128  # points of space at which a function is evaluated, on each rank

TimeFunction = Callable[[float], np.ndarray]
"""Values of a function at this rank's points, at a time, s."""


@dataclass(frozen=True)
class Rule:
    """Times, s, and weights with the sum 1; ``error`` of the mean is relative to the largest value."""

    times: np.ndarray
    weights: np.ndarray
    error: float = 0.0

    def tilted(self, tilt: float, begin: float, length: float) -> Rule:
        """The rule of the mean with the weight 1 + 12 tilt (s - 1/2), s from 0 to 1 over the interval.

        The mean of a function that is linear in time is its value at s = 1/2 + tilt.
        """
        if tilt == 0 or length == 0:
            return self
        factors = 1 + 12 * tilt * ((self.times - begin) / length - 0.5)
        return Rule(self.times, self.weights * factors, self.error * (1 + 6 * abs(tilt)))

    def mean(self, values: TimeFunction) -> np.ndarray:
        """The weighted sum of the values."""
        return sum(w * values(float(t)) for t, w in zip(self.times, self.weights, strict=True))


def rule(
    values: TimeFunction,
    begin: float,
    length: float,
    conditions: Sequence[TimeFunction] = (),
    knots: Sequence[np.ndarray] = (),
    ranks: Communicator | None = None,
) -> Rule:
    """The rule of the mean over [begin, begin + length], s; for length 0 the mean is the value at ``begin``.

    The function may have kinks or jumps at the ``knots``, s, and where one of the ``conditions`` changes its
    sign. Each of ``ranks`` has the values at its points.
    """
    if length == 0:
        return Rule(np.array([begin]), np.ones(1))
    return _RuleSearch(values, begin, length, ranks or Communicator()).found(conditions, knots)


def _gauss(*intervals: tuple[float, float]) -> np.ndarray:
    """Gauss nodes and weights of the intervals, (2, n)."""
    parts = [[0.5 * (a + b) + (b - a) * _NODES, (b - a) * _WEIGHTS] for a, b in intervals]
    return np.concatenate(parts, axis=1)


_Panel: TypeAlias = tuple[float, float, float, tuple[np.ndarray, np.ndarray], np.ndarray]
"""A panel: minus the size of its error, its ends a and b, the integrals over its halves, and the error.  The
error is the sum of the halves minus the integral of the whole.  A heap has the worst panel first."""


class _RuleSearch:
    """A search for a rule, in s = (t - begin)/length."""

    def __init__(self, values: TimeFunction, begin: float, length: float, ranks: Communicator) -> None:
        self.values, self.begin, self.length, self.ranks = values, begin, length, ranks
        self.largest, self.left = 0.0, _HALVINGS

    def found(self, conditions: Sequence[TimeFunction], knots: Sequence[np.ndarray]) -> Rule:
        breaks = {float((t - self.begin) / self.length) for of_table in knots for t in of_table}
        for condition in conditions:
            breaks |= self._changes(condition)
        ends = [0.0]
        for s in sorted(breaks):
            if s - ends[-1] > _ROUNDING and 1 - s > _ROUNDING:
                ends.append(s)
        ends.append(1.0)
        pieces = list(pairwise(ends))
        # these integrals give the largest value first: a panel of small values need not be resolved if
        # another panel has large values
        looks = [[self._integral(*ends) for ends in _equal(a, b)] for a, b in pieces]
        panels = [self._resolved(a, b, look) for (a, b), look in zip(pieces, looks, strict=True)]
        times, weights = np.concatenate([nodes for nodes, _ in panels], axis=1)
        error = self._size(sum(off for _, off in panels[1:]) + panels[0][1])
        return Rule(self.begin + self.length * times, weights, error)

    def _at(self, values: TimeFunction, s: float) -> np.ndarray:
        return np.asarray(values(self.begin + self.length * s), dtype=float)

    def _integral(self, a: float, b: float) -> np.ndarray:
        """Integral over [a, b] by Gauss points."""
        values = [self._at(self.values, 0.5 * (a + b) + (b - a) * node) for node in _NODES]
        self.largest = max(self.largest, self.ranks.most(np.abs(values).max(initial=0.0)))
        return (b - a) * sum(w * value for w, value in zip(_WEIGHTS, values, strict=True))

    def _resolved(self, a: float, b: float, look: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Nodes and weights of a piece, and their error. One panel suffices if its integral agrees with that
        of the first panels."""
        whole = self._integral(a, b)
        off = np.abs(whole - sum(look[1:], look[0]))
        if self._size(off) <= TOLERANCE * (b - a):
            return np.array([[0.5 * (a + b)], [b - a]]) if self._is_constant(a, b) else _gauss((a, b)), off
        panels = [self._halved(*ends, half) for ends, half in zip(_equal(a, b), look, strict=True)]
        heapify(panels)
        done, error = [], np.zeros_like(whole)
        while panels:
            size, a, b, halves, off = heappop(panels)
            middle = 0.5 * (a + b)
            # a short panel is not divided if its error is large only beside its own length
            is_small = -size <= TOLERANCE * max(b - a, _SHARE)
            if is_small or self.left <= 0 or not a < middle < b:
                done.append(_gauss((a, middle), (middle, b)))
                error = error + off
                continue
            self.left -= 1
            for ends, half in zip(((a, middle), (middle, b)), halves, strict=True):
                heappush(panels, self._halved(*ends, half))
        return np.concatenate(sorted(done, key=lambda nodes: nodes[0, 0]), axis=1), error

    def _halved(self, a: float, b: float, whole: np.ndarray) -> _Panel:
        middle = 0.5 * (a + b)
        halves = self._integral(a, middle), self._integral(middle, b)
        error = np.abs(whole - halves[0] - halves[1])
        return -self._size(error), a, b, halves, error

    def _is_constant(self, a: float, b: float) -> bool:
        values = [self._at(self.values, a + c * (b - a)) for c in (0.211, 0.5, 0.83)]
        return all(self._size(values[0] - other) <= _ROUNDING for other in values[1:])

    def _size(self, values: np.ndarray) -> float:
        return self.ranks.most(float(np.abs(values).max(initial=0.0))) / self.largest if self.largest else 0.0

    def _changes(self, condition: TimeFunction) -> set[float]:
        """Places s at which a condition changes its sign at all points at once, to rounding.  At a moving
        front each point has a different break, and halving of panels resolves the front.
        """
        ends = np.linspace(0.0, 1.0, _SCANS + 1)
        signs = [self._at(condition, s) > 0 for s in ends]
        active = [
            (a, b, below, above)
            for a, b, below, above in zip(ends[:-1], ends[1:], signs[:-1], signs[1:], strict=True)
            if self._any(below != above)
        ]
        for _ in range(_BISECTIONS):
            halves = []
            for a, b, below, above in active:
                middle = 0.5 * (a + b)
                within = self._at(condition, middle) > 0
                halves += [(a, middle, below, within), (middle, b, within, above)]
            changing = [half for half in halves if self._any(half[2] != half[3])]
            if len(changing) > _BREAKS:
                return set()
            active = changing
        return {b for _, b, below, above in active if self.ranks.all(bool((below != above).all()))}

    def _any(self, flags: np.ndarray) -> bool:
        return not self.ranks.all(not flags.any())


def _equal(a: float, b: float) -> Iterable[tuple[float, float]]:
    """First panels of the piece [a, b]."""
    return pairwise(np.linspace(a, b, _PANELS + 1))


class TimeMean:
    """Mean of a function of place and ``ngvisco.time``, as a function of place.

    ``make`` returns an array for the present time, whose mean is written to ``mean``.  The rule in time is
    found from the function's values on ``walls``, by default from its values in cells.
    """

    def __init__(
        self,
        value: CoefficientFunction,
        mesh: Mesh,
        make: Callable[[], np.ndarray],
        mean: np.ndarray,
        walls: Region | None = None,
    ) -> None:
        self._value, self._make, self._mean = value, make, mean
        self._ranks = Communicator.of(mesh)
        # these rules have no points at midpoints of edges
        of_kinds = rules(mesh.dim if walls is None else mesh.dim - 1, 4)
        points = mesh.MapToAllElements(of_kinds, VOL if walls is None else walls)
        self._points = points[:: -(-len(points) // _POINTS) or 1]
        self._conditions, self._knots = breaking(value)

    def update(self, begin: float, length: float, tilt: float = 0.0) -> float:
        """Compute the mean over ``length`` (s) from ``begin`` (s) on; return the error of its rule.

        ``tilt`` is the tilt of the weight (``Rule.tilted``), 0 for equal weights.
        """
        present = time.Get()

        def at(t: float) -> np.ndarray:
            time.Set(t)
            return self._make()

        try:
            conditions = [self._at_points(c) for c in self._conditions]
            nodes = rule(self._at_points(self._value), begin, length, conditions, self._knots, self._ranks)
            self._mean[:] = nodes.tilted(tilt, begin, length).mean(at)
        finally:
            time.Set(present)
        return nodes.error

    def _at_points(self, function: CoefficientFunction) -> TimeFunction:
        def values(t: float) -> np.ndarray:
            time.Set(t)
            return np.asarray(function(self._points)) if len(self._points) else np.zeros(0)

        return values


def mean_in_cells(value: CoefficientFunction, mesh: Mesh, degree: int) -> tuple[GridFunction, TimeMean]:
    """Mean of a function, projected onto polynomials in cells, of half the ``degree`` of the forms' rule.

    By this rule, integrals of the projection times such polynomials equal integrals of the mean. On straight
    cells rho g.w is such an integral, if the rule belongs to the orders of rho and w.
    """
    scalar = L2(mesh, order=degree // 2)
    function = GridFunction(VectorValued(scalar, value.dim) if value.dim > 1 else scalar)
    coefficients = function.vec.FV().NumPy()

    def make() -> np.ndarray:
        function.Set(value if value.dim == 1 else value.Reshape((value.dim,)))
        return coefficients

    return function, TimeMean(value, mesh, make, coefficients)


def mean_on_walls(
    value: CoefficientFunction, mesh: Mesh, degree: int, walls: Region
) -> tuple[GridFunction, TimeMean]:
    """Mean of a function on facets of walls, zero elsewhere."""
    scalar = FacetFESpace(mesh, order=degree // 2)
    space = FESpace([scalar] * value.dim)
    function = GridFunction(space)
    trial, test = space.TnT()
    measure = ds(definedon=walls, intrules=rules(mesh.dim - 1, degree))
    mass, load = BilinearForm(space, check_unused=False), LinearForm(space)
    for i, (u, w) in enumerate(zip(trial, test, strict=True)):
        mass += u * w * measure
        load += (value[i] if value.dims else value) * w * measure
    active = BitArray([bool(flag) for _ in range(value.dim) for flag in scalar.GetDofs(walls)])
    matrix = mass.Assemble().mat
    # a facet of a wall is on one rank, with all unknowns that couple to it
    inverse = getattr(matrix, "local_mat", matrix).Inverse(active, inverse="umfpack")

    def make() -> np.ndarray:
        load.Assemble()
        return np.array((inverse * getattr(load.vec, "local_vec", load.vec)).Evaluate().FV().NumPy())

    return function, TimeMean(value, mesh, make, function.vec.FV().NumPy(), walls)
