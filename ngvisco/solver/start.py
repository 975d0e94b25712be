"""What a step starts from: values extrapolated in time, and the velocity v* that says which side is upstream.

v* is the velocity extrapolated through the last two solutions, else the last one.  Where it misses the side,
the flow through the facet is slow, and its error is of the scheme's order: but in a start from rest, and in a
step that turns the flow round.  A side is wrong where the step's own velocity carries matter through more
than ``COURANT`` of a cell from a side that v* says, or leaves open, to be downstream.  Then v* follows the
iterates as long as increments are above ``SETTLED``.  Once they are below ``CERTAIN`` it becomes the step's
velocity, and the iteration goes on with equations that are smooth, and the same for both solvers and any
number of ranks.
"""

from __future__ import annotations

from math import comb

import numpy as np
from ngsolve import CF, BaseVector, BitArray, IfPos, InnerProduct, Integrate

from ngvisco.forms.mesh.mesh_arrays import is_simplicial, mask_of
from ngvisco.forms.system import Step
from ngvisco.forms.upwinding import FacetFlux
from ngvisco.parallel.communicator import Communicator

FARTHEST = 3.0
"""Distance of the step's end from the last solution, in units of that between the two."""

LARGEST_CHANGE = 0.5
"""Of density and elastic variables, in units of their size: to stay in the energy's domain."""

COURANT = 0.1
"""|v . n| tau/h from which a wrong side matters."""

SETTLED, CERTAIN = 1e-2, 1e-8
"""Increments from which v* stays, and from which the iterate's velocity is that of the step."""

CORRECTIONS = 2
"""Of v* in a step, at most: the second one makes good for what the first one's velocity took from sides that
followed iterates."""

_LOST = 0.25
"""Share of the downstream side in the trace from which its side is wrong."""

_AT_REST = 1e-3
"""Courant number up to which a start from rest needs no side."""


class Extrapolation:
    """Keeps the last two solutions; part of what a restart has to know."""

    def __init__(self, step: Step) -> None:
        self.step, self._ranks = step, Communicator.of(step.mesh)
        self._kept: list[tuple[float, np.ndarray]] = []
        """Times, s, and coefficients."""

    @property
    def is_empty(self) -> bool:
        """Whether no solution is known."""
        return not self._kept

    def keep(self, time: float) -> None:
        """``step.state`` is the solution at ``time``, s."""
        self._kept = [*self._kept[-1:], (time, self.step.state.vec.FV().NumPy().copy())]

    def drop(self) -> None:
        """Forget: the states at hand do not follow from each other."""
        self._kept.clear()

    def _change(self, time: float, where: slice) -> np.ndarray | None:
        """What some coefficients change by from the last solution to ``time``; None where that is too far, or
        nothing is known to extrapolate from."""
        if len(self._kept) < 2:
            return None
        (earlier, before), (last, now) = self._kept
        # stages of a tableau need not go forward in time
        if last <= earlier or not 0 < (reach := (time - last) / (last - earlier)) <= FARTHEST:
            return None
        return reach * (now[where] - before[where])

    def velocity(self, time: float) -> np.ndarray | None:
        """Coefficients of v extrapolated to ``time``, s; None if there is nothing to do so from."""
        v = self.step.layout.ranges["v"]
        change = self._change(time, v)
        return None if change is None else self._kept[1][1][v] + change

    def guess(self, time: float) -> BaseVector | None:
        """The state extrapolated to ``time``, s; None if there is nothing to do so from, or it would change
        what evolves, but for v, by more than ``LARGEST_CHANGE`` of their size."""
        change = self._change(time, slice(None))
        if change is None:
            return None
        last = self._kept[1][1]
        for name in self.step.layout.evolving:
            where = self.step.layout.ranges[name]
            size, change_of = (self._ranks.most(abs(u[where]).max(initial=0.0)) for u in (last, change))
            if not change_of < LARGEST_CHANGE * size and name != "v":
                return None
        guess = self.step.state.vec.CreateVector()
        guess.FV().NumPy()[:] = last + change
        return guess

    def state_dict(self) -> tuple[dict[str, float], dict[str, np.ndarray]]:
        """Numbers and arrays for a restart."""
        kept = list(zip(("earlier", "last"), self._kept, strict=False))
        return {f"{name}_time": t for name, (t, _) in kept}, {name: u.copy() for name, (_, u) in kept}

    def load_state_dict(self, numbers: dict[str, float], arrays: dict[str, np.ndarray]) -> None:
        """Take up what ``state_dict`` gave."""
        names = [name for name in ("earlier", "last") if name in arrays]
        self._kept = [(numbers[f"{name}_time"], np.array(arrays[name])) for name in names]


class Sides:
    """Chooses ``Step.wind``."""

    def __init__(self, step: Step, h_min: float) -> None:
        """``h_min`` is the smallest cell size, m."""
        self.step, self._h_min, self._ranks = step, h_min, Communicator.of(step.mesh)
        self.corrections = 0
        """In the present iteration."""
        self._provisional = self._is_from_rest = False
        self._prescribed = ~mask_of(step.layout.blocks["v"].FreeDofs())
        c, (v, h) = step.context, (step.now.v, step.context.h)
        self._through: FacetFlux | None = None
        if step.through is not None:
            self._through = FacetFlux(step.mesh, v, step.discretisation.k)
            v = self._through.function
        through = c.crossed * (v * c.normal)
        fast = IfPos(through * through - (COURANT * h / c.tau) ** 2, 1.0, 0.0)
        downstream = IfPos(through, c.upwinding.inflow, c.upwinding.share)
        self._wrong = (fast * IfPos(downstream - _LOST, 1.0, 0.0)).Compile()
        change = step.now.v - step.wind
        self._travel = InnerProduct(change, change) * (c.tau / h) ** 2
        """Square of the Courant number of v - v*."""
        self._volumes = Integrate(CF(1.0), step.mesh, element_wise=True).NumPy()
        k, dim = step.discretisation.k, step.mesh.dim
        values = comb(k + dim, dim) if is_simplicial(step.mesh) else (k + 1) ** dim
        self._mean_square = (COURANT / values) ** 2
        """Of a polynomial with so many coefficients in a cell that is ``COURANT`` at a vertex, at least."""

    def choose(self, velocity: np.ndarray) -> None:
        """Take the coefficients ``velocity`` for v*, (unknowns of v,), m/s; a new iteration begins."""
        self.corrections, self._provisional = 0, False
        self._is_from_rest = not self._ranks.any(velocity.any())
        self._take(velocity)

    def take_walls(self) -> None:
        """Give v* the values that walls prescribe."""
        self._take(self._velocity, self._prescribed)

    def change(self, increment: float) -> bool:
        """Whether v* becomes the velocity of the state, an iterate that was reached by such an increment."""
        if increment > SETTLED:
            changes = self._is_wrong()
            self._provisional = self._provisional or changes
        elif increment <= CERTAIN and self.corrections < CORRECTIONS:
            moves = self._is_from_rest and self._moved(_AT_REST)
            changes = self._provisional or moves or self._is_wrong()
            self.corrections += changes
            self._is_from_rest = False
        else:
            return False
        if changes:
            self._take(self._velocity)
        return changes

    def _take(self, velocity: np.ndarray, where: np.ndarray | slice = slice(None)) -> None:
        self.step.wind.vec.FV().NumPy()[where] = velocity[where]
        self.step.follow_wind()

    def _is_wrong(self) -> bool:
        # a side is wrong where v differs from v* by as much as makes it matter: most cells are not asked
        order = 2 * self.step.discretisation.k
        squares = Integrate(self._travel, self.step.mesh, order=order, element_wise=True).NumPy()
        cells = squares >= self._mean_square * self._volumes
        if not self._ranks.any(cells.any()):
            return False
        if self._through is not None:
            self._through()
        return self.step.quadrature.integrate_facets(self._wrong, BitArray(cells.tolist())) > 0

    def _moved(self, courant: float) -> bool:
        """Whether v differs from v* by more than this Courant number of the smallest cell."""
        change = abs(self._velocity - self.step.wind.vec.FV().NumPy()).max(initial=0.0)
        return self._ranks.most(change) * self.step.context.tau.Get() > courant * self._h_min

    @property
    def _velocity(self) -> np.ndarray:
        return self.step.state.vec.FV().NumPy()[self.step.layout.ranges["v"]]
