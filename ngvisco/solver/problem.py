"""The problem of a nonlinear solver, the measure of its increments, and its answer.

A solver is made for equations R(u) = 0 whose parameters a ``Problem`` sets.  It answers with a ``Solution``,
also where it finds none: it raises for a fault of the program only.

The norm of an increment is

    |d| = max over the unknowns u that evolve of |d_u|_2 / scale_u

in coefficients, with scale_v = |v|_2 + f sqrt(n) h/tau and scale_u = |u|_2 + f sqrt(n) s_u, where n is the
number of the block's coefficients and h the smallest cell size: a velocity counts by the strain that it makes
in the step; s_u is the unknown's scale, 0 of rho and 1 of z.  The other unknowns are functions of these; the
trace of a density that diffuses by an r-Laplacian, a nonlinear one, counts like rho.  A creep rate field Pi
changes z by tau Pi only, which leaves it open in a short step: with nu > 0 it counts by
s |dPi|_2/(|Pi|_2 + |dPi|_2 + f sqrt(n)/tau).  A variable with an ``own_scale``, as the entropy, counts once
more by itself.  The floor f and the share s are below; a stalled iteration is asked about with a larger
floor, but for Pi.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

import numpy as np
from ngsolve import BaseVector

from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.exchange import Exchange

FLOOR = 1e-9
"""Small strains and velocities converge relatively to themselves, as the ledger needs."""
COARSE_FLOOR = 1e-3
"""The floor by which a stalled iteration is judged: near a state of rest the other floor is below
rounding."""
SHARE = 1e-4
"""The weight of the relative increment of a creep rate field; steps stall where it is 1."""


class BlockNorm:
    """The norm of the module's docstring.

    Parameters
    ----------
    ranges : mapping of block names to slices of the coefficient vector
    units : mapping of the counted blocks' names to the size that one unit of the floor f has there
    exchange : Exchange, optional
        Of the vectors' space, where it may be distributed.
    shared : collection of str
        Those blocks that count by ``SHARE`` of their relative increment.
    """

    def __init__(
        self,
        ranges: Mapping[str, slice],
        units: dict[str, float],
        exchange: Exchange | None = None,
        shared: Collection[str] = (),
    ) -> None:
        self.ranges, self.units, self.shared = ranges, units, tuple(shared)
        self._ranks = Communicator() if exchange is None else exchange.communicator
        self._own: dict[str, slice | np.ndarray] = {name: ranges[name] for name in units}
        if exchange is not None and self._ranks.is_distributed:  # what ranks share counts once
            for name in units:
                self._own[name] = np.flatnonzero(exchange.owned[ranges[name]]) + ranges[name].start

        def count(block: slice) -> int:
            return block.stop - block.start if exchange is None else exchange.length(block)

        self._counts = {name: count(ranges[name]) for name in units}

    def __call__(self, increment: BaseVector, *states: BaseVector, coarse: bool = False) -> float:
        """|increment| with the scales of the largest of ``states`` in each block."""
        return self.sizes(increment, *states, coarse=coarse)[0]

    def sizes(self, increment: BaseVector, *states: BaseVector, coarse: bool = False) -> tuple[float, float]:
        """|increment|, and the relative increment of the shared blocks, in [0, 1]; 0 where there is none."""
        sizes, turned, floor = [], 0.0, COARSE_FLOOR if coarse else FLOOR
        vectors = [u.FV().NumPy() for u in (increment, *states)]
        parts = [[vector[own] for vector in vectors] for own in self._own.values()]
        with np.errstate(over="ignore", invalid="ignore"):  # a diverging iterate is inf or NaN here
            squares = np.array([[part @ part for part in of_block] for of_block in parts])
            norms = np.sqrt(self._ranks.totals(squares))  # of all blocks in one reduction
            for (name, unit), (own, *of_states) in zip(self.units.items(), norms, strict=True):
                one = unit * np.sqrt(self._counts[name])
                if name in self.shared:
                    turned = own / (max(of_states) + FLOOR * one + own) if own != 0 else 0.0
                    sizes.append(SHARE * turned)
                else:
                    scale = max(of_states) + floor * one
                    sizes.append(own / scale if scale != 0 else 0.0)
        # numpy's maximum passes NaN on, Python's may drop it
        return float(np.max(sizes)), float(turned)


class Status(Enum):
    """How an attempt ended; the value says it in words."""

    CONVERGED = "converged"
    TOO_MANY_ITERATIONS = "too many iterations"
    STALLED = "no step length reduces the increment"
    NOT_FINITE = "the residual is not finite"
    SINGULAR = "a linear system has no factorisation"
    INADMISSIBLE = "the solution of the equations is not admissible"


@dataclass(frozen=True)
class NewtonIteration:
    """One line of a solver's history: increment and contraction in the norm of this module."""

    increment: float
    contraction: float
    damping: float
    fresh_jacobian: bool


@dataclass(frozen=True)
class Solution:
    """The end of an attempt; its values are in the state that the solver was made for.

    Attributes
    ----------
    status : Status
    history : tuple of NewtonIteration
    reason : str
        Why it failed, with figures and what may help; empty where it converged.
    """

    status: Status
    history: tuple[NewtonIteration, ...] = ()
    reason: str = ""

    @property
    def converged(self) -> bool:
        return self.status is Status.CONVERGED


def unconverged(
    status: Status, history: Sequence[NewtonIteration], solver: str, wanted: float, remedy: str
) -> Solution:
    """The end of an attempt that has found no increment as small as wanted."""
    last = history[-1].increment if history else np.inf
    ended = f"{status.value}; {len(history)} iterations, last increment {last:.1e}, wanted {wanted:.0e}"
    return Solution(status, tuple(history), f"{solver} did not converge ({ended}): take {remedy}")


@dataclass(frozen=True)
class Attempt:
    """One entry of a step's history: from which start values a solution was sought, and what came of it."""

    start: str
    solution: Solution


def iterations(attempts: Iterable[Attempt]) -> list[NewtonIteration]:
    """All iterations of some attempts, in their order."""
    return [line for attempt in attempts for line in attempt.solution.history]


class Problem(Protocol):
    """A choice of the parameters of the equations that a solver was made for."""

    def pose(self) -> None:
        """Give the equations these parameters, and the state the values that they prescribe."""

    def poll(self) -> None:
        """Called before each iteration, by all ranks; raises StopRequested to give the step up."""
        return

    def factorised(self) -> None:
        """Called when the derivative has been factorised at the present state; nothing by default."""
        return


@dataclass(frozen=True)
class Interval:
    """A Rothe step in time, s: its length, where it begins and ends, and over what its loads are averaged.

    In the average times count by the weight 1 + 12 ``loads_tilt`` (s - 1/2), s from 0 to 1 over that
    interval.

    For the paper's scheme ``tau`` = end - begin, and loads are averaged over the same.  A stage of another
    scheme may start from a combination of states, which belongs to no time: ``begin`` is then that of the
    state which is its start value.
    """

    tau: float
    begin: float
    end: float
    loads_from: float
    loads_over: float
    loads_tilt: float = 0.0

    def shortened(self, fraction: float) -> Interval:
        """The step with a part of the length, as a start value of the whole one."""
        end = self.end if fraction == 1.0 else self.begin + fraction * (self.end - self.begin)
        over = fraction * self.loads_over
        return Interval(fraction * self.tau, self.begin, end, self.loads_from, over, self.loads_tilt)
