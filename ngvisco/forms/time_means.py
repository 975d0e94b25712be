"""Means over time of loads, tractions and walls' velocities (paper: g^k_{delta tau}, Euler-small-ass-g).

``rule`` finds times and weights that integrate a function over an interval to ``TOLERANCE`` of its largest
value: breaks are found by bisection of what the function's choices decide by, and between them Gauss panels
are halved until halves and whole agree.  It looks at the function at some points of space; what has no
break that is known (``ngvisco.physics.signals``) is seen where it lasts for a thirtieth of the interval.
All ranks find the same rule.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from heapq import heapify, heappop, heappush
from itertools import pairwise

import numpy as np
from ngsolve import (
    ET,
    L2,
    VOL,
    BilinearForm,
    BitArray,
    CoefficientFunction,
    FacetFESpace,
    FESpace,
    GridFunction,
    IntegrationRule,
    LinearForm,
    Mesh,
    Region,
    VectorValued,
    ds,
)

from ngvisco.parallel.communicator import Communicator
from ngvisco.physics.signals import breaking, time

TOLERANCE = 1e-10
"""Of a mean, relative to the largest value in the interval."""

_NODES, _WEIGHTS = (0.5 * values for values in np.polynomial.legendre.leggauss(5))
_PANELS, _SCANS = 8, 32
"""Panels of the first look at a piece, and times at which the sign of a condition is asked."""
_BISECTIONS, _BREAKS, _HALVINGS = 46, 64, 48
"""Halvings to a break, to rounding; breaks that are followed, and panels halved, at most."""
_ROUNDING = 4e-16
_SHARE = 1.0 / 64
"""Of the interval: what a panel may be off by is not made less for one that is shorter."""
_CELLS = {1: (ET.SEGM,), 2: (ET.TRIG, ET.QUAD), 3: (ET.TET, ET.PRISM, ET.PYRAMID, ET.HEX)}
_POINTS = 128
"""Of space at which a function is looked at, on each rank."""

Values = Callable[[float], np.ndarray]
"""Values of a function at this rank's points, at a time, s."""


@dataclass(frozen=True)
class Rule:
    """Times, s, and weights, which sum up to 1; ``error`` is the mean's, relative to the largest value."""

    times: np.ndarray
    weights: np.ndarray
    error: float = 0.0

    def mean(self, values: Values) -> np.ndarray:
        """The weighted sum of the values."""
        return sum(w * values(float(t)) for t, w in zip(self.times, self.weights, strict=True))


def rule(
    values: Values,
    begin: float,
    length: float,
    conditions: Sequence[Values] = (),
    knots: Sequence[np.ndarray] = (),
    ranks: Communicator | None = None,
) -> Rule:
    """The rule for the mean over [begin, begin + length], s; of length 0 the value at ``begin``.

    Parameters
    ----------
    conditions : sequence of callables
        The function may break where one of them changes its sign.
    knots : sequence of arrays
        And at these times, s.
    ranks : Communicator, optional
        Whose points' values these are.
    """
    if length == 0:
        return Rule(np.array([begin]), np.ones(1))
    return _Search(values, begin, length, ranks or Communicator()).found(conditions, knots)


@dataclass(frozen=True, order=True)
class _Panel:
    """[a, b] with the integrals over its halves, ordered by how far their sum is from that over the whole."""

    off: float
    """Its size over that of the largest value, negative, so that the worst comes first."""
    a: float
    b: float
    is_constant: bool = field(compare=False)
    halves: tuple[np.ndarray, ...] = field(default=(), compare=False)
    error: np.ndarray = field(default_factory=lambda: np.zeros(0), compare=False)

    def nodes(self) -> np.ndarray:
        """Nodes and weights, (2, n): of its halves where these are known."""
        middle = 0.5 * (self.a + self.b)
        if self.is_constant:
            return np.array([[middle], [self.b - self.a]])
        parts = [(self.a, middle), (middle, self.b)] if self.halves else [(self.a, self.b)]
        found = [[0.5 * (a + b) + (b - a) * _NODES, (b - a) * _WEIGHTS] for a, b in parts]
        return np.concatenate(found, axis=1)


class _Search:
    """Of a rule, in s = (t - begin)/length."""

    def __init__(self, values: Values, begin: float, length: float, ranks: Communicator) -> None:
        self.values, self.begin, self.length, self.ranks = values, begin, length, ranks
        self.largest, self.left = 0.0, _HALVINGS

    def found(self, conditions: Sequence[Values], knots: Sequence[np.ndarray]) -> Rule:
        breaks = {float((t - self.begin) / self.length) for of_table in knots for t in of_table}
        for condition in conditions:
            breaks |= self._changes(condition)
        ends = [0.0]
        for s in sorted(breaks):
            if s - ends[-1] > _ROUNDING and 1 - s > _ROUNDING:
                ends.append(s)
        ends.append(1.0)
        pieces = list(pairwise(ends))
        # the scale first: what is small in one piece need not be resolved where another is large
        looks = [self._panels(a, b, _PANELS) for a, b in pieces]
        found = [self._resolved(a, b, look) for (a, b), look in zip(pieces, looks, strict=True)]
        panels = sorted((panel for part, _ in found for panel in part), key=lambda panel: panel.a)
        times, weights = np.concatenate([panel.nodes() for panel in panels], axis=1)
        error = self._size(sum(off for _, off in found[1:]) + found[0][1])
        return Rule(self.begin + self.length * times, weights, error)

    def _at(self, values: Values, s: float) -> np.ndarray:
        return np.asarray(values(self.begin + self.length * s), dtype=float)

    def _panel(self, a: float, b: float) -> np.ndarray:
        """The integral over [a, b] by Gauss points."""
        found = [self._at(self.values, 0.5 * (a + b) + (b - a) * node) for node in _NODES]
        self.largest = max(self.largest, self.ranks.most(np.abs(found).max(initial=0.0)))
        return (b - a) * sum(w * value for w, value in zip(_WEIGHTS, found, strict=True))

    def _panels(self, a: float, b: float, count: int) -> list[np.ndarray]:
        ends = np.linspace(a, b, count + 1)
        return [self._panel(*both) for both in pairwise(ends)]

    def _resolved(self, a: float, b: float, look: list[np.ndarray]) -> tuple[list[_Panel], np.ndarray]:
        """A piece as one panel where that agrees with its look, else its panels; what they may be off by."""
        whole = self._panel(a, b)
        off = np.abs(whole - sum(look[1:], look[0]))
        if self._size(off) <= TOLERANCE * (b - a):
            return [_Panel(0.0, a, b, self._is_constant(a, b))], off
        ends = np.linspace(a, b, len(look) + 1)
        panels = [self._halved(*both, known) for both, known in zip(pairwise(ends), look, strict=True)]
        heapify(panels)
        done: list[_Panel] = []
        while panels:
            worst = heappop(panels)
            # what is off by so little in total may be off by all of it in one panel
            small = TOLERANCE * max(worst.b - worst.a, _SHARE)
            middle = 0.5 * (worst.a + worst.b)
            if -worst.off <= small or self.left <= 0 or not worst.a < middle < worst.b:
                done.append(worst)
                continue
            self.left -= 1
            for both, known in zip(((worst.a, middle), (middle, worst.b)), worst.halves, strict=True):
                heappush(panels, self._halved(*both, known))
        return done, sum((panel.error for panel in done), np.zeros_like(whole))

    def _halved(self, a: float, b: float, whole: np.ndarray) -> _Panel:
        middle = 0.5 * (a + b)
        halves = self._panel(a, middle), self._panel(middle, b)
        error = np.abs(whole - halves[0] - halves[1])
        return _Panel(-self._size(error), a, b, False, halves, error)

    def _is_constant(self, a: float, b: float) -> bool:
        found = [self._at(self.values, a + c * (b - a)) for c in (0.211, 0.5, 0.83)]
        return all(self._size(found[0] - other) <= _ROUNDING for other in found[1:])

    def _size(self, values: np.ndarray) -> float:
        size = self.ranks.most(float(np.abs(values).max(initial=0.0)))
        return size / self.largest if self.largest else 0.0

    def _changes(self, condition: Values) -> set[float]:
        """Where a condition changes its sign at all points at once, to rounding.

        A front that moves breaks elsewhere in time at each point: panels are halved for it.
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


class TimeMean:
    """The mean of a function of place and time, as a function of place.

    Parameters
    ----------
    value : CoefficientFunction
        Of place and ``ngvisco.time``.
    make : callable
        Gives what belongs to one time, set by ``ngvisco.time``, as an array; its mean goes to ``put``.
    walls : ngsolve.Region, optional
        Where the function is looked at: cells by default.
    """

    def __init__(
        self,
        value: CoefficientFunction,
        mesh: Mesh,
        make: Callable[[], np.ndarray],
        put: Callable[[np.ndarray], None],
        walls: Region | None = None,
    ) -> None:
        self._value, self._make, self._put = value, make, put
        self._ranks = Communicator.of(mesh)
        self._points = _some_points(mesh, walls)
        self._conditions, self._knots = breaking(value)

    def update(self, begin: float, length: float) -> float:
        """Let the mean be that over ``length`` (s) from ``begin`` (s) on; its error, as that of a rule."""
        present = time.Get()

        def at(t: float) -> np.ndarray:
            time.Set(t)
            return self._make()

        try:
            conditions = [self._at_points(c) for c in self._conditions]
            found = rule(self._at_points(self._value), begin, length, conditions, self._knots, self._ranks)
            self._put(found.mean(at))
        finally:
            time.Set(present)
        return found.error

    def _at_points(self, function: CoefficientFunction) -> Values:
        def values(t: float) -> np.ndarray:
            time.Set(t)
            return np.asarray(function(self._points)) if len(self._points) else np.zeros(0)

        return values


def mean_in_cells(value: CoefficientFunction, mesh: Mesh, degree: int) -> tuple[GridFunction, TimeMean]:
    """A mean as its projection to polynomials of cells, of half the ``degree`` of the forms' rule.

    Integrals by that rule against such polynomials are those of the mean itself: on straight cells rho g.w is
    one, for densities and velocities of the orders that the rule is made for.
    """
    scalar = L2(mesh, order=degree // 2)
    function = GridFunction(VectorValued(scalar, value.dim) if value.dim > 1 else scalar)

    def make() -> np.ndarray:
        function.Set(value if value.dim == 1 else value.Reshape((value.dim,)))
        return function.vec.FV().NumPy().copy()

    def put(values: np.ndarray) -> None:
        function.vec.FV().NumPy()[:] = values

    return function, TimeMean(value, mesh, make, put)


def mean_on_walls(
    value: CoefficientFunction, mesh: Mesh, degree: int, walls: Region
) -> tuple[GridFunction, TimeMean]:
    """The same on facets of walls, zero elsewhere."""
    scalar = FacetFESpace(mesh, order=degree // 2)
    space = FESpace([scalar] * value.dim)
    function = GridFunction(space)
    trial, test = space.TnT()
    measure = ds(definedon=walls, intrules={et: IntegrationRule(et, degree) for et in _CELLS[mesh.dim - 1]})
    mass, load = BilinearForm(space, check_unused=False), LinearForm(space)
    for i, (u, w) in enumerate(zip(trial, test, strict=True)):
        mass += u * w * measure
        load += (value[i] if value.dims else value) * w * measure
    on_walls = scalar.GetDofs(walls)
    active = BitArray([bool(flag) for _ in range(value.dim) for flag in on_walls])
    matrix = mass.Assemble().mat
    # a facet of a wall is on one rank, with all that couples to it
    inverse = getattr(matrix, "local_mat", matrix).Inverse(active, inverse="umfpack")

    def make() -> np.ndarray:
        load.Assemble()
        local = getattr(load.vec, "local_vec", load.vec)
        return np.array((inverse * local).Evaluate().FV().NumPy())

    def put(values: np.ndarray) -> None:
        function.vec.FV().NumPy()[:] = values

    return function, TimeMean(value, mesh, make, put, walls)


def _some_points(mesh: Mesh, walls: Region | None) -> np.ndarray:
    """Mesh points of cells or walls, ``_POINTS`` of them spread over all."""
    kinds = _CELLS[mesh.dim] if walls is None else _CELLS[mesh.dim - 1]
    rules = {et: IntegrationRule(et, 4) for et in kinds}  # none of whose points is a midpoint of edges
    points = mesh.MapToAllElements(rules, VOL if walls is None else walls)
    return points[:: -(-len(points) // _POINTS) or 1]
