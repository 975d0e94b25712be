"""The split solver: a Rothe step by Newton's method on what the fields and the flow leave of each other.

(FORMULATION.md, Section 7.)  The coupled residual R(u) = 0 is evaluated with everything that is an
explicit function of (v, a, rho, z) - upwind traces, conjugates, local creep, the hyperviscosity's local
unknowns - put in exactly, at the points of cells and sides (``ReducedResidual``).  An increment takes sweeps
of the transport and one linear system of the flow, into which the change of the fields is carried
(``FlowSchurComplement``), solved by GMRES (``Preconditioner``): Newton's method but for a coarser rule, a
fixed number of sweeps, and an operator that is made anew only after long increments or where increments
shrink too little; in between it follows hyperviscosity, which changes suddenly.

``iterate`` takes x - f(x), f = P^{-1} R, until f is small.  Its length is held by its power where a steep
flow rule bends it (``Split.evaluated``).  Elsewhere an iterate at which it is no number, or much longer than
the smallest one, is given up for one nearer to the best.  In Newton-Krylov GMRES takes P^{-1} dR d with
complex increments of R (``ReducedResidual.derivative``), to which P is the preconditioner.  What needs it are
creep rate fields (nu > 0), whose coupling to v P leaves out.
Measurements are in ``ngvisco/solver/NOTES.md``.
"""

from __future__ import annotations

import time as clock
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from ngsolve import BaseVector

from ngvisco.algebra.krylov import gmres
from ngvisco.errors import StepError
from ngvisco.forms.system import Step
from ngvisco.parallel.exchange import Exchange
from ngvisco.reduced.residual import Evaluation, ReducedResidual
from ngvisco.solver.norm import BlockNorm
from ngvisco.solver.options import NewtonOptions
from ngvisco.solver.problem import NewtonIteration, Problem, Solution, Status
from ngvisco.solver.split.preconditioner import Preconditioner
from ngvisco.threads import on_arrays

_FORCING = {2: 0.03, 3: 0.003}
"""Tolerances of the flow's linear systems: in 3D a residual costs more directions than are saved by less."""
_SHARP, _STEEP = 0.3, 0.01
"""``sharpness`` from which on, and increment above which, the operator of a flow rule is that of the next
iterate, stale or not: with 0.05 one of three steps of yield with G_m = 1e-6 Pa s is rejected."""
_REVERSED, _LENGTHS = 0.5, 10
"""Share of an increment's power that may be left with the other sign, and lengths tried for less."""
TOLERANCE, _DIRECTIONS = 0.01, 40
"""Of Newton-Krylov's linear systems, and derivatives taken for one at most; with 0.1 one of six long steps
failed."""
INNER = 3e-4, 1e-6
"""Tolerances of the flow's and the fields' systems in P, which has to be a linear map: where a flow rule is
steep, P times the derivative has single eigenvalues of 1e2 to 1e4, which multiply what is not linear."""
_ROUNDED = 0.01
"""Tolerances to which an increment has fallen where nothing shortens it any more but rounding, at a steep
flow rule; elsewhere one."""
_FAR = 0.01
"""Increment up to which ``growth`` is over the smallest one."""
_WINDOW, _MIN_DAMPING = 4, 0.05
"""Iterations that shorten an increment to a fifth, or it gives up; smallest step length tried."""


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

    def _relax(self) -> None:
        if self.preconditioner.relax():
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
        self._relax()
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
            self._relax()  # now, so that a run that is resumed here begins its next step alike
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
        # in a step's first increment, too: a resumed run knows the state of the last preconditioner only
        steep = self.is_steep and not fresh
        follows = steep and (last == np.inf or self._stale or (last > _STEEP and self.sharpness < _SHARP))
        everything = fresh or follows
        if fresh:
            self.renew(problem, at)
        else:
            with self._clock("assembly"):
                self.preconditioner.linearise(at, everything)
        f, size = self._solved(at)
        for better in (lambda: not fresh, self.preconditioner.strengthen):
            if self.preconditioner.iterations >= options.flow_iterations and better():  # unsolved
                self.renew(problem, at)
                f, size = self._solved(at)
        if self.is_steep and everything:
            if self.holds and size > options.rounding:
                power = self.preconditioner.power(at, f)
                self._last = (x, f.copy(), power) if power else None  # without power there is none to reverse
            self._follow_creep(f)
        # where points begin to yield a steep rule changes suddenly, however small the increment
        self._stale = size > options.stale_above * (0.5 if self.is_steep else 1.0) * last
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
        slow = self.preconditioner.iterations > options.renewed_after[dim - 2]
        slow |= self._stale and not self.is_steep  # whose operator follows without its preconditioner
        worn = slow and size > 1e3 * options.margin * self.options.tolerance
        before, self._turned = self._turned, self.sizes(f)[1] if self.norm.shared else 0.0
        bends = self._turned > max(options.bends_above, 0.3 * before)  # and the chord does not contract
        far = options.renewed_above * (10 if self.is_steep else 1)
        if worn or bends or size > far:
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


def newton_krylov(split: Split, problem: Problem, x: np.ndarray, history: list[NewtonIteration]) -> Status:
    """Iterate from ``x``, where the tangent is made anew; the state becomes the solution, or some iterate."""
    options, tolerance = split.options.split, split.options.tolerance
    scale, inner = split.unknowns.scales(x, split.residual.exchange), INNER[split.is_steep]

    def solved(at: Evaluation) -> np.ndarray:
        return split.preconditioner(at, inner, inner)

    def renewed(at: Evaluation) -> tuple[np.ndarray, float]:
        split.renew(problem, at)
        f = solved(at)
        return f, split.size(f)

    at = split.residual(x)
    f, size = renewed(at)
    sizes = [size]
    while len(history) < split.options.max_iterations:
        sharp = split.sharpness
        rounded = max(sharp, _ROUNDED) * tolerance
        derivative = split.residual.derivative(at)

        def along(d: np.ndarray, derivative: Any = derivative, at: Evaluation = at) -> np.ndarray:
            return solved(replace(at, residual=derivative(scale * d))) / scale

        products = split.residual.exchange.products
        d, _ = gmres(along, f / scale, rtol=TOLERANCE, directions=_DIRECTIONS, products=products)
        damping = 1.0
        while True:
            new_x = x - damping * scale * d
            new = split.residual(new_x)
            new_f = solved(new)
            new_size = split.size(new_f)
            if new_size <= (1 - 0.25 * damping) * size:
                break
            damping /= 2
            if damping < _MIN_DAMPING or size <= rounded:
                return _ends_at(split, x, size <= rounded)
        history.append(NewtonIteration(new_size, new_size / size, damping, True))
        at, x, f, size = new, new_x, new_f, new_size
        if problem.changes(size):
            split.residual.start()
            at = split.residual(x)
        elif size <= options.margin * sharp * tolerance:
            return _ends_at(split, x - f, True)
        sizes.append(size)
        window = _WINDOW * (3 if split.norm.shared else 1)  # increments of Pi rise in between
        before = sizes[max(len(sizes) - 1 - window, 0)]
        if len(sizes) > window and size > max(0.2 * before, options.rounding):
            return _ends_at(split, x, size <= rounded)
        f, size = renewed(at)
    return Status.TOO_MANY_ITERATIONS


def _ends_at(split: Split, x: np.ndarray, converged: bool) -> Status:
    """Make x, with the unknowns that it determines, the state."""
    split.residual.put(x)
    return Status.CONVERGED if converged else Status.STALLED


def iterate(split: Split, problem: Problem, history: list[NewtonIteration]) -> Status:
    """Iterate from the present state, which becomes the solution, or some iterate; ``history`` grows."""
    options = split.options.split
    x = split.unknowns.pack()
    last, halvings = np.inf, 0
    best = np.inf, x, x  # the smallest increment's size, its iterate, and it
    while len(history) < split.options.max_iterations:
        if len(history) > options.slow and last <= options.krylov_below:
            return newton_krylov(split, problem, x, history)
        x, at, held = split.evaluated(x)
        fresh = not split.is_factorised
        f, size = split.increment(problem, x, at, last)
        history.append(NewtonIteration(size, size / last if last < np.inf else 1.0, 1.0, fresh))
        if held or size <= options.growth * max(best[0], _FAR):
            new = x - f
            split.unknowns.unpack(new)
            if problem.changes(size):
                split.residual.start()
            elif split.has_converged(f, size, min(last, best[0])):
                split.residual.put(new)
                return Status.CONVERGED
            elif split.is_steep and 0.5 * best[0] < size <= options.rounding:
                return newton_krylov(split, problem, new, history)  # single precision ends here
            split.wear(f, size)
            best = min(best, (size, x, f), key=lambda one: one[0])
            x, last = new, size
        elif best[0] == np.inf:
            return Status.NOT_FINITE
        elif halvings == options.halvings:
            near = best[0] <= options.krylov_below
            return newton_krylov(split, problem, best[1], history) if near else Status.STALLED
        else:
            halvings += 1
            x, last = best[1] - 0.5**halvings * best[2], np.inf
            split.give_up()
    return Status.TOO_MANY_ITERATIONS
