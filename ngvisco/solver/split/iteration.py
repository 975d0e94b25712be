"""The split solver's iteration: when it has converged, starts again, or leaves it to Newton-Krylov.

f(x) = P^{-1} R(x) is the increment of the unknowns x, and x - f(x) the next iterate: Newton's method but for
a coarser rule and a fixed number of sweeps.  An increment of more than half the length of the one before is
judged by its direction (``Successive``): one that leads on may be longer, where it comes out of a jump of the
elastic force, and in place of one that leads back a secant's is taken.  Newton-Krylov solves f(x) = 0 where
that is slow: GMRES takes P^{-1} dR d with the whole derivative dR (``ReducedResidual.derivative``), to which
P is the preconditioner.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ngvisco.algebra.krylov import gmres
from ngvisco.reduced.residual import Evaluation
from ngvisco.solver.solution import NewtonIteration, Problem, Status
from ngvisco.solver.split.narrowing import narrowed
from ngvisco.solver.split.successive import Successive

if TYPE_CHECKING:
    from ngvisco.solver.split.solver import Split


def iterate(split: Split, problem: Problem, history: list[NewtonIteration]) -> Status:
    """Iterate from the present state, which becomes the solution, or some iterate; ``history`` grows."""
    options, tolerance = split.options.split, split.options.tolerance
    wanted, dim = options.margin * tolerance, split.step.mesh.dim
    may_narrow = problem.width == 1.0
    last, best, turned = np.inf, np.inf, 0.0
    best_x, best_f = None, None
    within: tuple[np.ndarray, np.ndarray] | None = None  # the last iterate at which R is a number, and its f
    since, restarts = 0, 0  # iterations since the start or a restart, and restarts
    before: np.ndarray | None = None  # the increment by which x was reached
    nearest, swings = np.inf, 0  # the increment that none has halved since, leaps and secants since it
    leapt = np.inf  # an increment through a jump, if the last one was
    sizes: list[float] = []
    x = split.unknowns.pack()
    while len(history) < split.options.max_iterations:
        fresh = not split.is_factorised
        _, f, size = split.increment(problem, x, last)
        history.append(NewtonIteration(size, size / last if last < np.inf else 1.0, 1.0, fresh))
        since += 1
        # when f has been added, if the contraction stays what it is
        left = size if last == np.inf else min(size * size / last, size)
        if size <= tolerance and left <= wanted:
            return _ends_at(split, x - f)
        if size <= 0.5 * nearest:
            nearest, swings = size, 0
        two = None
        is_slow = 0.5 * last < size <= options.narrowing.largest and size > options.rounding
        if is_slow and before is not None and swings < options.window:
            two = Successive.of(split, x, f, before)
        # far from the solution increments need not fall: those of p = 4 in an impulsive start do not
        most = (4 if best > options.linearised_above else 2) * max(best, wanted)
        diverges = not size <= (0.5 * leapt if leapt < np.inf else most)
        leaps = diverges and two is not None and two.lead_on and best <= options.linearised_above
        if leapt < np.inf and not diverges:  # beyond a jump, where those before it are no measure
            best, sizes, since = np.inf, [], 0
        leapt = size if leaps else np.inf
        if not diverges:
            if size > 0.5 * min(last, best) and since > 3 and size <= options.rounding:
                # by rounding; or slowly, and then this and all that would follow are to be small
                gained = max(1 - size / last, 0.0) or 1.0
                if split.size(f, coarse=True) <= gained * tolerance:
                    return Status.CONVERGED
            if size < best:
                best, best_x, best_f = size, x, f
            sizes.append(size)
        if best_x is None or best_f is None:
            return Status.NOT_FINITE
        if np.isfinite(size):
            within = x, f
        stalled = (
            not leaps
            and since > 2 * options.window
            and options.linearised_above > size > (options.stall * sizes[-1 - options.window :][0])
        )
        turns = not stalled and two is not None and two.are_opposed
        diverges = diverges and not leaps and not turns
        narrows = options.narrowing.least <= best <= options.narrowing.largest
        if may_narrow and narrows and (diverges or stalled):
            may_narrow = False
            near = narrowed(split, problem, best_x, history)
            if near is not None:
                x, since, restarts, last, best, sizes = near, 0, 0, np.inf, np.inf, []
                before, nearest, swings = None, np.inf, 0
                continue
        if diverges:
            restarts += 1
            if restarts > (options.restarts if best <= options.afar else options.restarts_afar):
                return _by_krylov(split, problem, best_x, best, history)
            # from half the step of the best iterate, or of the one that led to where R is no number, with a
            # preconditioner of its own
            from_x, of_f = (best_x, best_f) if np.isfinite(size) or within is None else within
            x = from_x - 0.5**restarts * of_f
            split.reset()
            since, last, before = 0, np.inf, None
            continue
        last = size
        if since > options.slow or stalled:
            return _by_krylov(split, problem, x, size, history)
        worn = split.preconditioner.iterations > options.renewed_after[dim - 2] and size > 1e3 * wanted
        turned, was = split.sizes(f)[1] if split.norm.shared else 0.0, turned
        bends = turned > max(options.bends_above, 0.3 * was)  # and the chord does not contract
        if worn or bends or size > options.renewed_above:
            split.reset()
        swings += leaps or turns
        before = f
        if two is not None and turns:
            x, before = two.secant()
        x = x - before
    return Status.TOO_MANY_ITERATIONS


def _by_krylov(
    split: Split, problem: Problem, x: np.ndarray, size: float, history: list[NewtonIteration]
) -> Status:
    """Newton-Krylov from x, whose increment is of this size: where that is near enough for it."""
    near = size <= split.options.split.krylov.largest
    return newton_krylov(split, problem, x, history) if near else Status.STALLED


def newton_krylov(split: Split, problem: Problem, x: np.ndarray, history: list[NewtonIteration]) -> Status:
    """Iterate from ``x``, where the tangent is made anew, by the whole derivative of R."""
    options, tolerance = split.options.split, split.options.tolerance
    krylov, wanted = options.krylov, options.margin * tolerance
    split.renew(problem, split.residual(x))
    scale = split.unknowns.scales(x, split.residual.exchange)

    def solved(at: Evaluation) -> np.ndarray:
        return split.preconditioner(at, krylov.tolerance * options.forcing)

    at = split.residual(x)
    f = solved(at)
    size = split.size(f)
    sizes = [size]
    while len(history) < split.options.max_iterations:
        derivative = split.residual.derivative(at)

        def along(d: np.ndarray, derivative: Any = derivative, at: Evaluation = at) -> np.ndarray:
            return solved(replace(at, residual=derivative(scale * d))) / scale

        products = split.residual.exchange.products
        d, _ = gmres(along, f / scale, rtol=krylov.tolerance, directions=krylov.directions, products=products)
        split.note(at, scale * d, split.size(scale * d))
        damping = 1.0
        while True:
            new_x = x - damping * scale * d
            new = split.residual(new_x)
            new_f = solved(new)
            new_size = split.size(new_f)
            if new_size <= (1 - 0.25 * damping) * size:
                break
            damping /= 2
            if damping < krylov.min_damping:
                return _ends_at(split, x) if size <= tolerance else Status.STALLED  # by rounding
        history.append(NewtonIteration(new_size, new_size / size, damping, True))
        at, x, f, size = new, new_x, new_f, new_size
        if size <= wanted:
            return _ends_at(split, x - f)
        sizes.append(size)
        window = options.window * (3 if split.norm.shared else 1)  # increments of Pi rise in between
        before = sizes[max(len(sizes) - 1 - window, 0)]
        if len(sizes) > window and size > max(options.stall * before, options.rounding):
            return _ends_at(split, x) if size <= tolerance else Status.STALLED
        split.renew(problem, at)
        f = solved(at)
        size = split.size(f)
    return Status.TOO_MANY_ITERATIONS


def _ends_at(split: Split, x: np.ndarray) -> Status:
    """Make x, with the unknowns that it determines, the state."""
    split.residual.put(x)
    return Status.CONVERGED
