"""The split solver: a Rothe step by Newton's method on what the fields and the flow leave of each other.

(FORMULATION.md, Section 7.)  The coupled residual R(u) = 0 is evaluated with everything that is an
explicit function of (v, a, rho, z) - upwind traces, conjugates, local creep, the hyperviscosity's local
unknowns - put in exactly, at the points of cells and sides (``ReducedResidual``).  An increment takes sweeps
of the transport and one linear system of the flow, into which the change of the fields is carried
(``FlowSchurComplement``), solved by GMRES to 3 per cent (``Preconditioner``): Newton's method but for a
coarser rule and a fixed number of sweeps.  The operator follows the state, its preconditioner is made anew
where it wears out.
Measurements are in ``ngvisco/solver/NOTES.md``.
"""

from __future__ import annotations

import time as clock
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from ngsolve import BaseVector

from ngvisco.errors import StepError
from ngvisco.forms.system import Step
from ngvisco.parallel.exchange import Exchange
from ngvisco.reduced.residual import Evaluation, ReducedResidual
from ngvisco.solver.norm import BlockNorm
from ngvisco.solver.options import NewtonOptions
from ngvisco.solver.problem import NewtonIteration, Problem, Solution, Status
from ngvisco.solver.split.iteration import iterate
from ngvisco.solver.split.preconditioner import Preconditioner
from ngvisco.threads import on_arrays

_FORCING = {2: 0.03, 3: 0.003}
"""Tolerances of the flow's linear systems: in 3D a residual costs more directions than are saved by less."""
_STEEP = 0.01
"""Increment above which the operator of a steep flow rule is that of the next iterate: with 0.05 one of three
steps of yield with G_m = 1e-6 Pa s is rejected."""
_REVERSED, _LENGTHS = 0.5, 10
"""Share of an increment's power that may be left with the other sign, and lengths tried for less."""


class Split:
    """Solves R(u; .) = 0 for the state of a step; keeps its tangent between solves."""

    def __init__(self, step: Step, norm: BlockNorm, options: NewtonOptions, exchange: Exchange) -> None:
        """``exchange`` is that of the step's space."""
        self.step, self.norm, self.options = step, norm, options
        self.is_factorised = False
        self.seconds: dict[str, float] = defaultdict(float)
        """Wall time by parts of the work, s, since the solver was made."""
        self.residual = ReducedResidual(step, exchange, self._clock)
        self.unknowns = self.residual.unknowns
        self.preconditioner = Preconditioner(self.residual, options)
        self._full = step.state.vec.CreateVector()
        self._turned = 0.0
        """Relative increment of a creep rate field, the last one."""
        self._stale = False
        """Whether the last increment was too long beside that before."""
        self.holds = False
        """Whether increments of a steep flow rule are shortened by their power (``evaluated``)."""
        self._last: tuple[np.ndarray, np.ndarray, float] | None = None
        """A long increment of a steep flow rule: where from, without what follows creep, and its power."""

    def reset(self) -> None:
        """Drop the tangent, so that the next solve makes a new one."""
        self.is_factorised = False

    def give_up(self) -> None:
        """The last increment is not taken."""
        self._last = None
        self.reset()

    def factorise(self, problem: Problem) -> None:
        """Make the tangent at the present state; raises StepError if it is singular."""
        problem.pose()
        self.step.eliminate.refresh()
        with on_arrays():
            self.residual.start()
            self.renew(problem, self.residual(self.unknowns.pack()))

    @contextmanager
    def _clock(self, name: str) -> Iterator[None]:
        began = clock.perf_counter()
        yield
        self.seconds[name] += clock.perf_counter() - began

    def solve(self, problem: Problem, guess: BaseVector) -> Solution:
        """Iterate from ``guess``; the step's state is then the solution, or some iterate."""
        history: list[NewtonIteration] = []
        self._turned, self._stale, self._last = 0.0, False, None
        self.preconditioner.fields.renew()  # what is known of earlier iterates a resumed run does not know
        self.step.state.vec.data = guess
        problem.pose()
        if not np.isfinite(guess.Norm()):
            return Solution(Status.NOT_FINITE, (), "the split solver's start value is not finite")
        try:
            with on_arrays(), np.errstate(all="ignore"):  # a diverging iterate is inf or NaN
                self.residual.start()
                status = iterate(self, problem, history)
        except StepError as error:  # of a factorisation
            return Solution(Status.SINGULAR, tuple(history), str(error))
        except (FloatingPointError, np.linalg.LinAlgError) as error:
            reason = f"the split solver met a singular block: {error}"
            return Solution(Status.SINGULAR, tuple(history), reason)
        if status is Status.CONVERGED:
            # an energy that is kept at the quadrature points is asked for by the ledger and the output
            self.step.eliminate.refresh()
            return Solution(status, tuple(history))
        last = history[-1].increment if history else np.inf
        reason = (
            f"the split solver did not converge ({status.value}; {len(history)} iterations, last increment "
            f"{last:.1e}, wanted {self.options.split.margin * self.options.tolerance:.0e}): take a smaller "
            "step or the coupled solver"
        )
        return Solution(status, tuple(history), reason)

    def evaluated(self, x: np.ndarray) -> tuple[np.ndarray, Evaluation, bool]:
        """x or an iterate nearer to the one before, R there, and whether the last increment was held by it.

        What begins to yield gives way to a velocity that its elastic tangent did not know of.  An increment
        is shortened, with creep as it follows, until the flow's power along it is not reversed: of a
        monotone rule there is such a length.
        """
        at = self.residual(x)
        if self._last is None:
            return x, at, False
        start, f, before = self._last
        length = 1.0
        for _ in range(_LENGTHS):
            share = self.preconditioner.power(at, f) / before
            if share >= -_REVERSED:
                return x, at, True
            length *= min(max(1 / (1 - share), 0.1), 0.5) if share > -np.inf else 0.1  # also of NaN
            part = length * f
            self._follow_creep(part)
            x = start - part
            self.unknowns.unpack(x)
            at = self.residual(x)
        return x, at, False

    def increment(
        self, problem: Problem, x: np.ndarray, at: Evaluation, last: float
    ) -> tuple[np.ndarray, float]:
        """The increment at the unknowns x, with R there, and its size, infinite where R is no number.

        ``last`` is the size of the one before.
        """
        self._last = None
        if not self.residual.ranks.all(at.residual.is_finite):
            return np.zeros_like(x), np.inf
        options, fresh = self.options.split, not self.is_factorised
        everything = fresh or (self.is_steep and (last > _STEEP or self._stale))
        if fresh:
            self.renew(problem, at)
        else:
            with self._clock("assembly"):
                self.preconditioner.linearise(at, everything)
        f, size = self._solved(at)
        if not fresh and self.preconditioner.iterations >= options.flow_iterations:  # unsolved
            self.renew(problem, at)
            f, size = self._solved(at)
        if self.is_steep and everything:
            if self.holds and size > options.rounding:
                self._last = x, f.copy(), self.preconditioner.power(at, f)
            self._follow_creep(f)
        # where points begin to yield a steep rule changes suddenly, however small the increment
        self._stale = size > options.stale_above * last
        return f, size

    @property
    def is_steep(self) -> bool:
        """Whether a small error of z may be a large one of a local creep rate."""
        return bool(self.preconditioner.local_creep)

    @property
    def sharpness(self) -> float:
        """How much less than of others may be left of increments of z, by which a steep rate is wrong."""
        if not self.is_steep:
            return 1.0
        points = self.preconditioner.operator.points
        steepest = self.residual.ranks.most(abs(points.rate_slope).max(initial=0.0))
        return max(1 / (1 + points.tau * steepest), 1e-4)

    def _follow_creep(self, f: np.ndarray) -> None:
        """Let an increment from where the tangent is keep the stress on the flow rule's graph."""
        z = self.unknowns.slices["z"]
        for creep in self.preconditioner.local_creep:  # each of variables of its own
            f[z] -= creep(-f[z].reshape(self.unknowns.components["z"], -1)).ravel()

    def has_converged(self, f: np.ndarray, size: float, last: float) -> bool:
        """Whether x - f solves the equations: by the size of f, and of the smallest increment before."""
        options, tolerance = self.options.split, self.options.tolerance
        # of all increments after f, if the contraction stays what it is; of a first one it is not known
        contraction = 0.5 if last == np.inf else min(size / last, 1.0)
        sharp = self.sharpness
        if size <= tolerance and size * contraction <= (1 - contraction) * options.margin * sharp * tolerance:
            return True
        if not 0.5 * last < size:
            return False
        # slow by rounding; or slow, and then this and all that would follow are to be small
        gained = max(1 - size / last, 0.0) or 1.0
        return self.size(f, coarse=True) <= gained * sharp * tolerance

    def wear(self, f: np.ndarray, size: float) -> None:
        """Let the tangent be made anew for the next increment where this one, f, says that it wears out."""
        options, dim = self.options.split, self.step.mesh.dim
        slow = self.preconditioner.iterations > options.renewed_after[dim - 2] or self._stale
        worn = slow and size > 1e3 * options.margin * self.options.tolerance
        before, self._turned = self._turned, self.sizes(f)[1] if self.norm.shared else 0.0
        bends = self._turned > max(options.bends_above, 0.3 * before)  # and the chord does not contract
        if worn or bends or size > options.renewed_above:
            self.reset()

    def _solved(self, at: Evaluation) -> tuple[np.ndarray, float]:
        """The increment by the tangent at hand, and its size."""
        with self._clock("solves"):
            f = self.preconditioner(at, _FORCING[self.step.mesh.dim])
        return f, self.size(f)

    def renew(self, problem: Problem, at: Evaluation) -> None:
        """Make the tangent anew at an evaluation, which is that of the step's state."""
        self.is_factorised = False
        self.preconditioner.update(at, self._clock)  # where it fails there is no tangent
        self.is_factorised = True
        problem.factorised()

    def size(self, f: np.ndarray, coarse: bool = False) -> float:
        return self.sizes(f, coarse)[0]

    def sizes(self, f: np.ndarray, coarse: bool = False) -> tuple[float, float]:
        full = self._full.FV().NumPy()
        full[:] = 0.0
        for name in self.unknowns.names:
            full[self.unknowns.ranges[name]] = f[self.unknowns.slices[name]]
        return self.norm.sizes(self._full, self.step.state.vec, coarse=coarse)
