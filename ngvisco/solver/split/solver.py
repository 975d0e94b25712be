"""The split solver: a Rothe step by Newton's method on what the fields and the flow leave of each other.

(FORMULATION.md, Section 7.)  The coupled residual R(u) = 0 is evaluated with everything that is an
explicit function of (v, a, rho, z) - traces, conjugates, local creep, the hyperviscosity's local
unknowns - put in exactly, at the points of cells and sides (``ReducedResidual``).  An increment takes sweeps
of the transport and one linear system of the flow, into which the change of the fields is carried
(``FlowSchurComplement``), solved by GMRES (``Preconditioner``): Newton's method but for a coarser rule, a
fixed number of sweeps, and an operator that is made anew only after long increments or where increments
shrink too little; in between it follows hyperviscosity, which changes suddenly.

``iterate`` takes x - f(x), f = P^{-1} R, until f is small.  An iterate at which it is no number, or much
longer than the smallest one, is given up for one nearer to the best.  ``damped`` has a tangent of its own for
each increment, which is shortened until the next one is shorter.  In Newton-Krylov GMRES takes P^{-1} dR d
with complex increments of R (``ReducedResidual.derivative``), to which P is the preconditioner.  What needs
it are creep rate fields (nu > 0), whose coupling to v P leaves out.
Measurements are in ``ngvisco/solver/NOTES.md``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from ngsolve import BaseVector

from ngvisco.algebra.krylov import gmres
from ngvisco.errors import StepError
from ngvisco.forms.system import Step
from ngvisco.parallel.exchange import Exchange
from ngvisco.reduced.residual import Evaluation, ReducedResidual
from ngvisco.solver.options import NewtonOptions
from ngvisco.solver.problem import BlockNorm, NewtonIteration, Problem, Solution, Status, unconverged
from ngvisco.solver.split.preconditioner import Preconditioner
from ngvisco.threads import Workers, on_arrays

_FORCING = {2: 0.03, 3: 0.003}
"""Tolerances of the flow's linear systems: in 3D a residual costs more directions than are saved by less."""
_STEEP = 0.01
"""Increment above which the operator of a flow rule is that of the next iterate, stale or not."""
TOLERANCE, _DIRECTIONS = 0.01, 40
"""The tolerance of Newton-Krylov's linear systems, and the most derivatives taken for one."""
INNER = 3e-4, 1e-6
"""Tolerances of the flow's and the fields' systems in P, which has to be a linear map: where a flow rule is
steep, P times the derivative has single eigenvalues of 1e2 to 1e4, which multiply what is not linear."""
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
        workers = Workers(options.threads, exchange.communicator.size)
        self.residual = ReducedResidual(step, exchange, workers)
        self.unknowns = self.residual.unknowns
        self.preconditioner = Preconditioner(self.residual, options)
        self._full = step.state.vec.CreateVector()
        self._turned = 0.0
        """Relative increment of a creep rate field, the last one."""
        self._stale = False
        """Whether the last increment was too long beside that before."""
        self.is_fresh = True
        """Whether the last increment began with a tangent made for it."""
        self.damps = False
        """Whether a step is solved by ``damped``."""

    def reset(self) -> None:
        """Drop the tangent, so that the next solve makes a new one."""
        self.is_factorised = False

    def give_up(self) -> None:
        """The last increment is not taken."""
        self.step.stresses.start()
        self.reset()

    def _relax(self) -> None:
        if self.preconditioner.relax():
            self.reset()

    def factorise(self, problem: Problem) -> None:
        """Make the tangent at the present state; raises StepError if it is singular."""
        problem.pose()
        self.step.local_unknowns.update_stored()
        with on_arrays():
            self.residual.start()
            self.renew(problem, self.residual(self.unknowns.pack()))

    def solve(self, problem: Problem, guess: BaseVector) -> Solution:
        """Iterate from ``guess``; the step's state is then the solution, or some iterate."""
        history: list[NewtonIteration] = []
        self._turned, self._stale = 0.0, False
        self.step.stresses.start()
        self._relax()
        self.preconditioner.fields.renew()  # what is known of earlier iterates a resumed run does not know
        self.step.state.vec.data = guess
        problem.pose()
        if not np.isfinite(guess.Norm()):
            return Solution(Status.NOT_FINITE, (), "the split solver's start value is not finite")
        try:
            with on_arrays(), np.errstate(all="ignore"):  # a diverging iterate is inf or NaN
                self.residual.start()
                status = (damped if self.damps else iterate)(self, problem, history)
        except StepError as error:  # of a factorisation
            return Solution(Status.SINGULAR, tuple(history), str(error))
        except (FloatingPointError, np.linalg.LinAlgError) as error:
            reason = f"the split solver met a singular block: {error}"
            return Solution(Status.SINGULAR, tuple(history), reason)
        if status is Status.CONVERGED:
            # an energy that is kept at the quadrature points is asked for by the ledger and the output
            self.step.local_unknowns.update_stored()
            self._relax()  # now, so that a run that is resumed here begins its next step alike
            return Solution(status, tuple(history))
        wanted = self.options.split.margin * self.options.tolerance
        remedy = "a smaller step or the coupled solver"
        return unconverged(status, history, "the split solver", wanted, remedy)

    def increment(
        self, problem: Problem, x: np.ndarray, at: Evaluation, last: float
    ) -> tuple[np.ndarray, float]:
        """The increment at the unknowns x, with R there, and its size, infinite where R is no number.

        ``last`` is the size of the one before.
        """
        problem.poll()
        options, fresh = self.options.split, not self.is_factorised
        self.is_fresh = fresh
        if not self.is_finite(at):
            return np.zeros_like(x), np.inf
        if fresh:
            self.renew(problem, at)
        else:
            self.preconditioner.linearise(at, self._follows(last))
        f = self.solved(at)
        for better in (lambda: not fresh, self.preconditioner.strengthen):
            if self.preconditioner.iterations >= options.flow_iterations and better():  # unsolved
                self.renew(problem, at)
                f = self.solved(at)
        size = self.size(f)
        self._stale = size > options.stale_above * last
        return f, size

    def is_finite(self, at: Evaluation) -> bool:
        """Whether all of R is numbers."""
        ranks, energy = self.residual.ranks, self.step.energy
        if ranks.all(np.isfinite(at.residual).all()):
            return True
        slopes = at.coefficients["zeta"]  # no numbers where the energy is none
        if energy.projected is None and ranks.any(np.isfinite(at.x).all() and not np.isfinite(slopes).all()):
            energy.lacked(self.step.now)
        return False

    def evaluated(self, x: np.ndarray, last: float) -> Evaluation:
        """R at the unknowns x, with flow rules' slopes there if the operator is to have them.

        ``last`` is the size of the increment that led there.
        """
        return self.residual(x, self.is_steep and (not self.is_factorised or self._follows(last)))

    def _follows(self, last: float) -> bool:
        """Whether the operator of flow rules is to be that of the iterate; in a step's first one, too: a
        resumed run knows the state of the last factorisation only."""
        return self.is_steep and (self._stale or last > _STEEP)

    @property
    def is_steep(self) -> bool:
        """Whether flow rules are linearised at stresses of their own."""
        return bool(self.step.stresses)

    def follow(self, f: np.ndarray, length: float = 1.0) -> None:
        """Let these follow to where ``length`` times the increment f, from the state, leads."""
        nodes = self.preconditioner.operator.points.nodes
        if self.is_steep and nodes is not None:
            nodes.follow(-f[self.unknowns.slices["z"]].reshape(self.unknowns.components["z"], -1), length)

    def has_converged(self, f: np.ndarray, size: float, last: float) -> bool:
        """Whether x - f solves the equations: by the size of f, and of the smallest increment before."""
        options, tolerance = self.options.split, self.options.tolerance
        # of all increments after f, if the contraction stays what it is; of a first one it is not known
        contraction = 0.5 if last == np.inf else min(size / last, 1.0)
        if size <= tolerance and size * contraction <= (1 - contraction) * options.margin * tolerance:
            return True
        if not 0.5 * last < size:
            return False
        # slow by rounding; or slow, and then this and all that would follow are to be small
        gained = max(1 - size / last, 0.0) or 1.0
        return self.size(f, coarse=True) <= gained * tolerance

    def reset_if_worn(self, f: np.ndarray, size: float) -> None:
        """Let the tangent be made anew for the next increment where this one, f, says that it wears out."""
        options = self.options.split
        slow = self.preconditioner.iterations > options.renewed_after
        slow |= self._stale and not self.is_steep  # whose operator follows without its preconditioner
        worn = slow and size > 1e3 * options.margin * self.options.tolerance
        before, self._turned = self._turned, self.sizes(f)[1] if self.norm.shared else 0.0
        bends = self._turned > max(options.bends_above, 0.3 * before)  # and the chord does not contract
        far = options.renewed_above * (10 if self.is_steep else 1)
        if worn or bends or size > far:
            self.reset()

    def solved(self, at: Evaluation) -> np.ndarray:
        """The increment by the tangent at hand."""
        return self.preconditioner(at, _FORCING[self.step.mesh.dim])

    def renew(self, problem: Problem, at: Evaluation) -> None:
        """Make the tangent anew at an evaluation, which is that of the step's state."""
        self.is_factorised = False
        self.preconditioner.update(at)  # where it fails there is no tangent
        self.is_factorised = True
        problem.factorised()

    def size(self, f: np.ndarray, *states: BaseVector, coarse: bool = False) -> float:
        """The size of an increment by the norm with the scales of the present state, and of others."""
        return self.sizes(f, *states, coarse=coarse)[0]

    def sizes(self, f: np.ndarray, *states: BaseVector, coarse: bool = False) -> tuple[float, float]:
        """The size of an increment, and the relative increment of a creep rate field."""
        full = self._full.FV().NumPy()
        full[:] = 0.0
        for name in self.unknowns.names:
            full[self.unknowns.ranges[name]] = f[self.unknowns.slices[name]]
        return self.norm.sizes(self._full, self.step.state.vec, *states, coarse=coarse)


def damped(split: Split, problem: Problem, history: list[NewtonIteration]) -> Status:
    """Iterate as ``iterate`` does, with a tangent of its own for each increment, which is shortened until the
    next one is shorter, by the same tangent or by the next: a material that begins to yield gives way to a
    velocity that the elastic tangent did not know of.
    """
    state = split.step.state.vec
    base = state.CreateVector()

    def increment(x: np.ndarray) -> tuple[np.ndarray, float]:
        split.reset()
        return split.increment(problem, x, split.evaluated(x, np.inf), np.inf)

    x, damping = split.unknowns.pack(), 1.0
    f, size = increment(x)
    while len(history) < split.options.max_iterations:
        base.data = state
        split.follow(f, damping)
        new = x - damping * f
        at = split.residual(new)
        by_old = split.size(split.solved(at), base) if split.is_finite(at) else np.inf
        new_f, new_size = increment(new)
        by_new = split.size(new_f, base) if new_size < np.inf else np.inf
        left = min(by_old, by_new) / split.size(f, base) if size > 0 else 0.0
        history.append(NewtonIteration(size, left, damping, True))
        if left <= 1 - damping / 4:
            if split.has_converged(new_f, new_size, size):
                split.follow(new_f)
                split.residual.put(new - new_f)
                return Status.CONVERGED
            x, f, size, damping = new, new_f, new_size, min(1.0, 2 * damping)
        elif damping < _MIN_DAMPING:
            return Status.STALLED
        else:
            damping /= 2
            split.step.stresses.undo()
            f, size = increment(x)  # the tangent is that of the other end
    return Status.TOO_MANY_ITERATIONS


def newton_krylov(split: Split, problem: Problem, x: np.ndarray, history: list[NewtonIteration]) -> Status:
    """Iterate from ``x``, where the tangent is made anew; the state becomes the solution, or some iterate."""
    options, tolerance = split.options.split, split.options.tolerance
    scale, inner = split.unknowns.scales(x, split.residual.exchange), INNER[split.is_steep]

    def solved(at: Evaluation) -> np.ndarray:
        return split.preconditioner(at, inner, inner)

    def renewed(at: Evaluation) -> tuple[np.ndarray, float]:
        split.renew(problem, at)
        f = solved(split.residual(at.x) if split.is_steep else at)
        return f, split.size(f)

    def along(at: Evaluation) -> Callable[[np.ndarray], np.ndarray]:
        derivative = split.residual.derivative(at)

        def image(d: np.ndarray) -> np.ndarray:
            problem.poll()
            return solved(replace(at, residual=derivative(scale * d))) / scale

        return image

    def ends_at(x: np.ndarray, converged: bool) -> Status:
        """Make x, with the unknowns that it determines, the state."""
        split.residual.put(x)
        return Status.CONVERGED if converged else Status.STALLED

    at = split.residual(x)
    f, size = renewed(at)
    sizes, products = [size], split.residual.exchange.products
    while len(history) < split.options.max_iterations:
        d, _ = gmres(along(at), f / scale, rtol=TOLERANCE, directions=_DIRECTIONS, products=products)
        damping = 1.0
        while True:
            new_x = x - damping * scale * d
            split.follow(scale * d, damping)
            new = split.residual(new_x)
            new_f = solved(new)
            new_size = split.size(new_f)
            if new_size <= (1 - 0.25 * damping) * size:
                break
            damping /= 2
            split.step.stresses.undo()
            if damping < _MIN_DAMPING or size <= tolerance:
                return ends_at(x, size <= tolerance)
        history.append(NewtonIteration(new_size, new_size / size, damping, True))
        at, x, f, size = new, new_x, new_f, new_size
        if size <= options.margin * tolerance:
            split.follow(f)
            return ends_at(x - f, True)
        sizes.append(size)
        window = _WINDOW * (3 if split.norm.shared else 1)  # increments of Pi rise in between
        before = sizes[max(len(sizes) - 1 - window, 0)]
        if len(sizes) > window and size > max(0.2 * before, options.rounding):
            return ends_at(x, size <= tolerance)
        f, size = renewed(at)
    return Status.TOO_MANY_ITERATIONS


def iterate(split: Split, problem: Problem, history: list[NewtonIteration]) -> Status:
    """Iterate from the present state, which becomes the solution, or some iterate; ``history`` grows."""
    options = split.options.split
    x = split.unknowns.pack()
    last, halvings = np.inf, 0
    best = np.inf, x, x  # the smallest increment's size, its iterate, and it
    while len(history) < split.options.max_iterations:
        if len(history) > options.slow and last <= options.krylov_below:
            return newton_krylov(split, problem, x, history)
        f, size = split.increment(problem, x, split.evaluated(x, last), last)
        history.append(NewtonIteration(size, size / last if last < np.inf else 1.0, 1.0, split.is_fresh))
        if size <= options.growth * max(best[0], _FAR):
            new = x - f
            split.follow(f)
            split.unknowns.unpack(new)
            if split.has_converged(f, size, min(last, best[0])):
                split.residual.put(new)
                return Status.CONVERGED
            split.reset_if_worn(f, size)
            best = min(best, (size, x, f), key=lambda one: one[0])
            x, last = new, size
        elif best[0] == np.inf:
            return Status.NOT_FINITE
        elif halvings == options.halvings:
            if best[0] > options.krylov_below:
                return Status.STALLED
            return newton_krylov(split, problem, best[1], history)
        else:
            halvings += 1
            x, last = best[1] - 0.5**halvings * best[2], np.inf
            split.give_up()
    return Status.TOO_MANY_ITERATIONS
