"""Input and output of a nonlinear solver: the problem, the norm of the increments, and the solution.

A solver is made for equations R(u) = 0 whose parameters a ``Problem`` sets. A failed attempt also returns a
``Solution``, with the reason; only a fault of the program raises an exception.

The norm of an increment is

    |d| = max over the unknowns u that evolve of |d_u|_2 / scale_u

of vectors of coefficients, with scale_v = |v|_2 + f sqrt(n) h/tau and scale_u = |u|_2 + f sqrt(n) s_u. Here n
is the number of coefficients of u, and h is the smallest cell size. A velocity thus counts by the strain that
it makes in the step. The unknown's scale s_u is 0 for rho, and 1 for the strains in z, which count together.
A variable in z that may have another unit, such as a concentration, an entropy or a modulus, counts by
itself, with s_u by ``Step.sizes_apart``, because its large numbers would hide the strains. The other unknowns
are functions of the evolving ones, and do not count. An exception is the trace of a density that diffuses by
an r-Laplacian: this trace is a nonlinear function, and counts like rho.

A creep rate field Pi changes z by tau Pi only, so that a short step does not determine Pi. With nu > 0, Pi
counts by s |dPi|_2/(|Pi|_2 + |dPi|_2 + f sqrt(n)/tau). Here f is ``FLOOR`` and s is ``SHARE``. A stalled
iteration is judged with the larger floor f = ``COARSE_FLOOR``, except for Pi.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

import numpy as np
from ngsolve import BaseVector

from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.exchange import Exchange

NOISE_SAMPLES, NOISE_MARGIN = 2, 10.0
"""Number of perturbations of the state by which the noise is measured; and the factor by which the measured
noise is multiplied, because increment and noise are random."""
FLOOR = 1e-9
"""The floor f of the norm, so small that the iteration also resolves small strains and velocities, as the
ledger requires."""
COARSE_FLOOR = 1e-3
"""The floor f with which a stalled iteration is judged, because near a state of rest ``FLOOR`` is below
rounding."""
SHARE = 1e-4
"""Weight of the relative increment of a creep rate field; with the weight 1 steps stall."""


class BlockNorm:
    """The norm |d| of an increment, see the module's docstring.

    ``ranges`` has the blocks of the coefficient vector; ``units`` has the unit s_u of each block that counts
    (for "v" the unit is h/tau).  A ``shared`` block counts by ``SHARE`` times its relative increment.
    ``exchange`` belongs to the space of the vectors, and is needed if several ranks share this space.
    """

    def __init__(
        self,
        ranges: Mapping[str, slice | np.ndarray],
        units: dict[str, float],
        exchange: Exchange | None = None,
        shared: Collection[str] = (),
    ) -> None:
        self.ranges, self.units, self.shared = ranges, units, tuple(shared)
        self._ranks = Communicator() if exchange is None else exchange.communicator
        self._own = {name: ranges[name] for name in units}
        if exchange is not None and self._ranks.is_distributed:  # a shared coefficient counts once
            self._own = {name: np.r_[at][exchange.owned[at]] for name, at in self._own.items()}
        self._counts = {name: self._ranks.total(len(np.r_[own])) for name, own in self._own.items()}

    def __call__(self, increment: BaseVector, *states: BaseVector, coarse: bool = False) -> float:
        """Return |increment|; the scale of a block is that of the largest of ``states``."""
        return self.sizes(increment, *states, coarse=coarse)[0]

    def sizes(self, increment: BaseVector, *states: BaseVector, coarse: bool = False) -> tuple[float, float]:
        """Return |increment|, and the relative increment of the shared block, in [0, 1]. Without a shared
        block the second number is 0."""
        sizes, turned, floor = [], 0.0, COARSE_FLOOR if coarse else FLOOR
        vectors = [u.FV().NumPy() for u in (increment, *states)]
        parts = [[vector[places] for vector in vectors] for places in self._own.values()]
        with np.errstate(over="ignore", invalid="ignore"):  # a diverging iterate is inf or NaN here
            squares = np.array([[part @ part for part in of_block] for of_block in parts])
            norms = np.sqrt(self._ranks.totals(squares))  # one reduction for all blocks
            for (name, unit), (norm, *of_states) in zip(self.units.items(), norms, strict=True):
                length = unit * np.sqrt(self._counts[name])
                if name in self.shared:
                    turned = norm / (max(of_states) + FLOOR * length + norm) if norm != 0 else 0.0
                    sizes.append(SHARE * turned)
                else:
                    scale = max(of_states) + floor * length
                    sizes.append(norm / scale if scale != 0 else 0.0)
        # NumPy's maximum of NaN is NaN; Python's may be a number
        return float(np.max(sizes)), float(turned)

    def noise(self, state: BaseVector, exchange: Exchange, change: Callable[[], float]) -> float:
        """Return the noise: ``NOISE_MARGIN`` times the largest ``change`` of an increment if all numbers of
        the state change in their last place.  The state is kept."""
        values, sizes = state.FV().NumPy(), list[float]()
        kept, signs = values.copy(), np.random.default_rng(0)  # a repeated run gets the same bits
        for _ in range(NOISE_SAMPLES):
            values *= 1 + np.finfo(float).eps * exchange.of_owners(signs.choice((-1.0, 1.0), len(values)))
            sizes.append(change())
            values[:] = kept
        return NOISE_MARGIN * max(sizes)


class Status(Enum):
    """The way an attempt ended, in words."""

    CONVERGED = "converged"
    TOO_MANY_ITERATIONS = "too many iterations"
    STALLED = "no step length reduces the increment"
    ROUNDING = "the increment is rounding of the equations"
    NOT_FINITE = "the residual is not finite"
    SINGULAR = "a linear system has no factorisation"
    INADMISSIBLE = "the solution of the equations is not admissible"


@dataclass(frozen=True)
class NewtonIteration:
    """One iteration in a solver's history; increment and contraction are in the norm of this module."""

    increment: float
    contraction: float
    damping: float
    fresh_jacobian: bool


@dataclass(frozen=True)
class Solution:
    """The result of an attempt; the unknowns' values are in the state that the solver was made for.

    ``reason`` is the reason of a failure, with figures and a remedy; it is empty after convergence.
    """

    status: Status
    history: tuple[NewtonIteration, ...] = ()
    reason: str = ""

    @property
    def converged(self) -> bool:
        return self.status is Status.CONVERGED


def unconverged(status: Status, history: Sequence[NewtonIteration], name: str, tolerance: float) -> Solution:
    """The ``Solution`` of a failed attempt of the solver ``name``: increments stayed above ``tolerance``."""
    last = history[-1].increment if history else np.inf
    iterations = f"{len(history)} iteration{'s' * (len(history) != 1)}"
    ended = f"{status.value}; after {iterations} the increment is {last:.1e}, the tolerance {tolerance:.0e}"
    remedy = "a larger solver.tolerance or density" if status is Status.ROUNDING else "a smaller step"
    return Solution(status, tuple(history), f"{name} did not converge ({ended}); take {remedy}")


@dataclass(frozen=True)
class Attempt:
    """One attempt in a step's history: the name of its start values, and its solution or failure."""

    start: str
    solution: Solution


def iterations(attempts: Iterable[Attempt]) -> list[NewtonIteration]:
    """All iterations of some attempts, in their order."""
    return [line for attempt in attempts for line in attempt.solution.history]


class Problem(Protocol):
    """Parameters of the equations that a solver was made for."""

    def pose(self) -> None:
        """Set the parameters of the equations, and the prescribed values of the state."""

    def poll(self) -> None:
        """Hook before each iteration, called by all ranks; raises StopRequested to give up the step."""
        return

    def factorised(self) -> None:
        """Hook after a factorisation of the derivative at the present state; does nothing by default."""
        return


@dataclass(frozen=True)
class Interval:
    """The times of a Rothe step, s: length, begin and end, and the interval over which loads are averaged.

    The average of loads has the weight 1 + 12 ``loads_tilt`` (s - 1/2), where s runs from 0 to 1 over the
    interval of loads.

    For the paper's scheme ``tau`` = end - begin, and loads are averaged from begin to end. A stage of another
    scheme may start from a combination of states, which has no time of its own; for such a stage ``begin`` is
    the time of the state with which the iteration starts.
    """

    tau: float
    begin: float
    end: float
    loads_from: float
    loads_over: float
    loads_tilt: float = 0.0

    def shortened(self, fraction: float) -> Interval:
        """A step of a ``fraction`` of the length; the shorter step's solution is a start value for the whole
        step."""
        end = self.end if fraction == 1.0 else self.begin + fraction * (self.end - self.begin)
        over = fraction * self.loads_over
        return Interval(fraction * self.tau, self.begin, end, self.loads_from, over, self.loads_tilt)
