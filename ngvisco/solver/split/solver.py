"""The split solver: a Rothe step by Newton's method on the flow, from which the fields are eliminated.

See FORMULATION.md, Section 7. In the coupled residual R(u) = 0 all explicit functions of (v, a, rho, z) -
traces, conjugates, local creep, the hyperviscosity's local unknowns - are eliminated exactly, at the points
of cells and sides (``ReducedResidual``). An increment is computed by sweeps of the transport and by one
linear system for the flow, which contains the fields' response to the flow (``FlowSchurComplement``) and is
solved by GMRES (``Preconditioner``). Three things distinguish this iteration from Newton's method: a coarser
quadrature rule; a fixed number of sweeps; and an operator that is kept for several increments. The operator
is renewed after a long increment, if increments shrink too little, or if further directions of the linear
systems, or further increments until the end, cost as much as a renewal (``Wear``). If an increment shows that
its operator is outdated, it is computed anew with the new operator, without another residual. Between
renewals only the hyperviscosity is linearised again, because it changes suddenly.

``iterate`` replaces x by x - f(x), f = P^{-1} R, until f is small. If the increment f is not finite, or much
longer than the smallest increment so far, an iterate nearer to the best iterate replaces x. ``damped`` forms
a tangent for each increment, and shortens the increment until the next increment is shorter.
``newton_krylov`` solves P^{-1} dR d = f by GMRES with complex increments of R
(``ReducedResidual.derivative``). Creep rate fields (nu > 0) need ``newton_krylov``: P omits the coupling of
these fields to v. Measurements are in ``ngvisco/solver/NOTES.md``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from ngsolve import BaseVector

from ngvisco.algebra.krylov import gmres
from ngvisco.algebra.memory import return_large_arrays
from ngvisco.errors import StepError
from ngvisco.forms.system import Step
from ngvisco.parallel.exchange import Exchange
from ngvisco.reduced.residual import Evaluation, ReducedResidual
from ngvisco.solver.options import NewtonOptions
from ngvisco.solver.problem import BlockNorm, NewtonIteration, Problem, Solution, Status, unconverged
from ngvisco.solver.split.preconditioner import Preconditioner
from ngvisco.solver.split.wear import Wear
from ngvisco.threads import Workers, on_arrays

_FORCING = 0.03, 0.003
"""Tolerances of the flow's linear systems where residuals are cheap, and where they are expensive: in 3D, and
with several bodies.  With more exact increments fewer residuals are evaluated.  The first increment of a step
has the first tolerance, because the error of its old tangent is larger."""
_LEFT, _LOOSEST = 0.3, 0.03
"""Error of the flow's linear system, as a share of the error with which the iteration may end; and the
largest tolerance of the linear system."""
_STEEP = 0.01
"""Increment above which the operator of steep flow rules is renewed at the next iterate in any case."""
TOLERANCE, _DIRECTIONS = 0.01, 40
"""Tolerance of Newton-Krylov's linear systems, and the largest number of derivatives for one system."""
INNER = 3e-4, 1e-6
"""Tolerance of the linear systems in P within Newton-Krylov: without steep flow rules, and with them.

GMRES needs a linear P. With a steep flow rule the preconditioned derivative P dR has single eigenvalues of
1e2 to 1e4, which amplify the nonlinear part of P.
"""
_FAR = 0.01
"""Increments below ``SplitOptions.growth`` times this value are accepted, however small the smallest
increment is."""
_WINDOW, _MIN_DAMPING = 4, 0.05
"""Number of iterations in which Newton-Krylov has to reduce the increment to a fifth; and the damping below
which an iteration counts as stalled."""


class Split:
    """Solves R(u; .) = 0 for the state of a step; keeps the tangent between solves."""

    def __init__(self, step: Step, norm: BlockNorm, options: NewtonOptions, exchange: Exchange) -> None:
        """``exchange`` belongs to the step's space."""
        self.step, self.norm, self.options, self._exchange = step, norm, options, exchange
        self.is_factorised = False
        return_large_arrays()
        self.residual = ReducedResidual(step, exchange, Workers(options.threads, exchange.communicator.size))
        self.unknowns = self.residual.unknowns
        self.preconditioner = Preconditioner(self.residual, options)
        self._turned = 0.0
        """The last relative increment of a creep rate field."""
        self._stale = False
        """Whether the last increment was too long relative to the increment before."""
        self.is_fresh = True
        """Whether the tangent was renewed for the last increment."""
        self.wear = Wear(options.split.renewed_after)
        self._left = 0.0
        """Tolerance of the last increment's linear system, relative to this increment."""
        self.damps = False
        """Whether ``solve`` uses ``damped``."""

    def reset(self) -> None:
        """Drop the tangent, so that the next solve makes a new one."""
        self.is_factorised = False

    def give_up(self) -> None:
        """Reject the last increment."""
        self.step.stresses.start()
        self.reset()

    def _relax(self) -> None:
        if self.preconditioner.relax():
            self.reset()

    def factorise(self, problem: Problem) -> None:
        """Compute the tangent at the present state; raises StepError if the tangent is singular."""
        problem.pose()
        with on_arrays():
            self.residual.start()
            self.residual.put(x := self.unknowns.pack())  # derived unknowns may belong to another state
            self.step.local_unknowns.update_stored()
            self.renew(problem, self.residual(x))

    def solve(self, problem: Problem, guess: BaseVector) -> Solution:
        """Iterate from ``guess``; the step's state becomes the solution, or an iterate after a failure."""
        history: list[NewtonIteration] = []
        self._turned, self._stale = 0.0, False
        self.step.stresses.start()
        self._relax()
        self.preconditioner.fields.renew()  # a resumed run does not know earlier iterates
        self.step.state.vec.data = guess
        problem.pose()
        if not np.isfinite(guess.Norm()):
            return Solution(Status.NOT_FINITE, (), "the split solver's start value is not finite")
        try:
            with on_arrays(), np.errstate(all="ignore"):  # a diverging iterate is inf or NaN
                self.residual.start(records=True)
                status = (damped if self.damps else iterate)(self, problem, history)
                if status is Status.STALLED and np.isfinite(last := history[-1].increment):
                    status = Status.ROUNDING if last <= self._noise() else status
        except StepError as error:  # a factorisation failed
            return Solution(Status.SINGULAR, tuple(history), str(error))
        except (FloatingPointError, np.linalg.LinAlgError) as error:
            reason = f"a block of the split solver is singular: {error}"
            return Solution(Status.SINGULAR, tuple(history), reason)
        if status is Status.CONVERGED:
            # ledger and output read the energy at the quadrature points
            self.step.local_unknowns.update_stored()
            self._relax()  # a run resumed at this state has no strengthened solver either
            return Solution(status, tuple(history))
        tolerance = self.options.split.margin * self.options.tolerance
        return unconverged(status, history, "the split solver", tolerance)

    def _noise(self) -> float:
        """The noise (``BlockNorm.noise``) of the increment."""
        rows = self.residual(self.unknowns.pack()).residual.copy()

        def size() -> float:
            at = self.residual(self.unknowns.pack())
            return self.size(self.preconditioner(replace(at, residual=at.residual - rows), _LOOSEST))

        return self.norm.noise(self.step.state.vec, self._exchange, size)

    def increment(
        self, problem: Problem, x: np.ndarray, at: Evaluation, last: float, expected: float = np.inf
    ) -> tuple[np.ndarray, float]:
        """The increment at the unknowns x, and the increment's size, which is infinite if R is not finite.

        ``at`` is R evaluated at x, ``last`` the size of the previous increment, ``expected`` the expected
        size of this increment.
        """
        problem.poll()
        options, was_fresh = self.options.split, self.is_fresh
        self.is_fresh = False
        if not self.is_finite(at):
            self.is_fresh = not self.is_factorised
            return np.zeros_like(x), np.inf
        if not self.is_factorised:
            self.renew(problem, at)
        else:
            self.preconditioner.linearise(at, self._follows(last))
        f = self.solved(at, expected)
        for better in (lambda: not self.is_fresh, self.preconditioner.strengthen):
            if self.preconditioner.iterations >= options.flow_iterations and better():  # not solved
                del f  # a renewal takes the most memory of a step
                self.renew(problem, at)
                f = self.solved(at, expected)
        self.wear.count(self.preconditioner.iterations)
        size = self.size(f)
        if not self.is_steep:
            self.wear.rate(size / last, was_fresh)
        self._stale = size > options.stale_above * last
        if not self.is_steep and self._is_worn(size) and size <= options.growth * last:
            del f
            self.renew(problem, at)  # a new increment is cheaper than a further residual
            f = self.solved(at, expected)
            self.wear.count(self.preconditioner.iterations)
            size = self.size(f)
        return f, size

    def is_finite(self, at: Evaluation) -> bool:
        """Whether all rows of R are finite."""
        ranks, energy = self.residual.ranks, self.step.energy
        if ranks.all(np.isfinite(at.residual).all()):
            return True
        slopes = at.coefficients["zeta"]  # not finite if the energy is undefined
        if energy.projected is None and ranks.any(np.isfinite(at.x).all() and not np.isfinite(slopes).all()):
            energy.lacked(self.step.now)
        return False

    def evaluated(self, x: np.ndarray, last: float) -> Evaluation:
        """R at the unknowns x; if the operator is to be renewed at x, flow rules are linearised there.

        ``last`` is the size of the increment that led to x.
        """
        return self.residual(x, self.is_steep and (not self.is_factorised or self._follows(last)))

    def _follows(self, last: float) -> bool:
        """Whether the operator of flow rules is to be renewed at the iterate.

        The first iterate of a step also renews the operator: a resumed run knows the state of the last
        factorisation only."""
        return self.is_steep and (self._stale or last > _STEEP)

    @property
    def is_steep(self) -> bool:
        """Whether flow rules are linearised at stresses that are unknowns of their own."""
        return bool(self.step.stresses)

    def follow(self, f: np.ndarray, length: float = 1.0) -> None:
        """Change the linearisation stresses by ``length`` times the increment f of the state."""
        points = self.preconditioner.operator.points.collocated
        if self.is_steep and points is not None:
            points.follow(-f[self.unknowns.slices["z"]].reshape(self.unknowns.components["z"], -1), length)

    def has_converged(self, f: np.ndarray, size: float, last: float) -> bool:
        """Whether x - f solves the equations, judged by the ``size`` of f and by ``last``, the size of the
        smallest earlier increment."""
        options, tolerance = self.options.split, self.options.tolerance
        # a contraction gives the sum of all increments after f; for a first increment the contraction is a
        # guess
        contraction = 0.5 if last == np.inf else min(max(size / last, self._left), 1.0)
        if size <= tolerance and size * contraction <= (1 - contraction) * options.margin * tolerance:
            return True
        if not 0.5 * last < size:
            return False
        # if rounding or a poor tangent slows the iteration, the sum of all remaining increments has to be
        # small
        gained = max(1 - size / last, 0.0) or 1.0
        return self.size(f, coarse=True) <= gained * tolerance

    def _is_worn(self, size: float) -> bool:
        """Whether the increment of length ``size`` shows that its tangent, which is an old one, is outdated.

        An increment by a new tangent does not show this, because the contraction so far belongs to the
        tangent before."""
        slow = self._stale and not self.is_steep  # steep rules renew the operator alone
        end = self.options.split.margin * self.options.tolerance
        return not self.is_fresh and size > 1e3 * end and (slow or self.wear.is_dear(size / end))

    def reset_if_worn(self, f: np.ndarray, size: float) -> None:
        """Drop the tangent if the increment f shows that it is outdated; the next increment then makes a new
        tangent."""
        options = self.options.split
        worn = self._is_worn(size)
        before, self._turned = self._turned, self.sizes(f)[1] if self.norm.shared else 0.0
        bends = self._turned > max(options.bends_above, 0.3 * before)  # a fixed tangent would not contract
        far = options.renewed_above * (10 if self.is_steep else 1)
        if worn or bends or size > far:
            self.reset()

    def solved(self, at: Evaluation, expected: float = np.inf) -> np.ndarray:
        """The increment by the present tangent, solved only as exactly as the end of the iteration requires.

        ``expected`` is the size that the increment probably has."""
        error, tolerance = _LEFT * self.options.split.margin * self.options.tolerance, _LOOSEST
        if expected > 0:
            tolerance = min(tolerance, error / expected)
        is_dear = self.step.mesh.dim == 3 or len(self.step.model.bodies) > 1
        is_first = expected == np.inf and not self.is_fresh  # an old tangent leaves a tenth of it
        self._left = max(tolerance, _FORCING[is_dear and not is_first])
        return self.preconditioner(at, self._left)

    def renew(self, problem: Problem, at: Evaluation) -> None:
        """Compute the tangent at an evaluation, whose unknowns have to be the step's state."""
        self.is_factorised = False
        self.preconditioner.update(at)  # no tangent remains if this fails
        self.wear.renew()
        self.is_factorised = self.is_fresh = True
        problem.factorised()

    def size(self, f: np.ndarray, *states: BaseVector, coarse: bool = False) -> float:
        """The norm of an increment, with scales of the present state and of ``states``."""
        return self.sizes(f, *states, coarse=coarse)[0]

    def sizes(self, f: np.ndarray, *states: BaseVector, coarse: bool = False) -> tuple[float, float]:
        """The norm of an increment, and the relative increment of a creep rate field."""
        increment = self.step.state.vec.CreateVector()
        full = increment.FV().NumPy()
        full[:] = 0.0
        for name in self.unknowns.names:
            full[self.unknowns.ranges[name]] = f[self.unknowns.slices[name]]
        return self.norm.sizes(increment, self.step.state.vec, *states, coarse=coarse)


def damped(split: Split, problem: Problem, history: list[NewtonIteration]) -> Status:
    """Iterate with a new tangent for each increment, and shorten it until the next increment is shorter.

    The next increment is computed twice, with the present and with the next tangent, and the shorter result
    counts: a material that begins to yield resists a velocity less than the elastic tangent predicts.
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
        is_shorter = left <= 1 - damping / 4
        # after an undamped increment, rounding alone may make the next increment as long as the last one
        if (is_shorter or damping == 1) and split.has_converged(new_f, new_size, size):
            split.follow(new_f)
            split.residual.put(new - new_f)
            return Status.CONVERGED
        if is_shorter:
            x, f, size, damping = new, new_f, new_size, min(1.0, 2 * damping)
        elif damping < _MIN_DAMPING:
            return Status.STALLED
        else:
            damping /= 2
            split.step.stresses.undo()
            f, size = increment(x)  # the present tangent belongs to the rejected iterate
    return Status.TOO_MANY_ITERATIONS


def newton_krylov(split: Split, problem: Problem, x: np.ndarray, history: list[NewtonIteration]) -> Status:
    """Iterate from ``x`` by Newton-Krylov; the state becomes the solution, or an iterate after a failure."""
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
        """Make x, and the unknowns derived from x, the state."""
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
        window = _WINDOW * (3 if split.norm.shared else 1)  # increments of Pi may grow temporarily
        before = sizes[max(len(sizes) - 1 - window, 0)]
        if len(sizes) > window and size > max(0.2 * before, options.rounding):
            return ends_at(x, size <= tolerance)
        f, size = renewed(at)
    return Status.TOO_MANY_ITERATIONS


def iterate(split: Split, problem: Problem, history: list[NewtonIteration]) -> Status:
    """Iterate from the present state, which becomes the solution, or an iterate after a failure.

    Each iteration is appended to ``history``.
    """
    options = split.options.split
    x = split.unknowns.pack()
    last, halvings = np.inf, 0
    best = np.inf, x, x  # size of the smallest increment, its iterate, and the increment
    while len(history) < split.options.max_iterations:
        if len(history) > options.slow and last <= options.krylov_below:
            return newton_krylov(split, problem, x, history)
        # the estimate needs the last contraction, which is unknown after an iterate was given up
        expected = last * history[-1].contraction if last < np.inf else np.inf
        f, size = split.increment(problem, x, split.evaluated(x, last), last, expected)
        history.append(NewtonIteration(size, size / last if last < np.inf else 1.0, 1.0, split.is_fresh))
        if size <= options.growth * max(best[0], _FAR):
            new = x - f
            split.follow(f)
            split.unknowns.unpack(new)
            if split.has_converged(f, size, min(last, best[0])):
                split.residual.put(new)
                return Status.CONVERGED
            split.reset_if_worn(f, size)
            best = min(best, (size, x, f), key=lambda entry: entry[0])
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
