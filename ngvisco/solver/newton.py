"""The coupled solver: damped Newton iteration with a reused factorisation, statically condensed.

A Jacobian is assembled and factorised at the start of a run. It is renewed if the contraction of the last
increment, theta = |d_{i+1}|/|d_i|, is above ``refresh``.  All other increments are computed with the present
factorisation. Damping is the natural monotonicity test of affine invariant Newton methods: a step of length
lambda is taken if the next increment by the same factorisation is shorter by the factor 1 - lambda/4.  The
test is invariant under scaling of the equations, so residuals in different units are never compared. One
scale measures both increments: the larger of the scales before and after the step. With two scales, a step
that is far too long would pass the test, because such a step makes the scale grow.

Rounding. The residual is a sum of parts that cancel. Near F = I the parts of the elastic force have the size
of the modulus G, and their rounding leaves a force of eps G/h. No stiffness resists a force that moves the
body as a whole, so that v is known only to eps G tau/(rho h). To measure this noise, every number of the
state is perturbed by one unit in its last place. The change of the increment is the noise, which no iteration
can remove. If a fresh Jacobian no longer advances the iteration, two kinds of increments are accepted: an
increment as small as the noise, and an increment below the tolerance in the norm with the coarse floor.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from ngsolve import BaseMatrix, BaseVector, BilinearForm, SetHeapSize

from ngvisco.errors import StepError
from ngvisco.forms.driving_stress import LinearisationStress
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.exchange import Exchange
from ngvisco.parallel.petsc import PETScInverse
from ngvisco.solver.options import NewtonOptions
from ngvisco.solver.problem import BlockNorm, NewtonIteration, Problem, Solution, Status, unconverged

NOISE_CAP = 100.0
"""Largest increment that is accepted as rounding, in tolerances. A stalled increment is accepted if it is
below the noise (``BlockNorm.noise``), and below this number of tolerances in the norm with the coarse floor.
In this norm a velocity that comes to rest counts by the strain that it makes."""
NEAR = 10.0
"""Number of tolerances below which a stalled increment is accepted without a measurement of the noise. The
rounding of a stiff pressure may change a slow velocity by as much."""
HEAP_SIZES = (500_000_000, 2_000_000_000)
"""Sizes of NGSolve's heap, bytes. They are tried if the default heap is too small for a cell's matrix, as for
k = 3, m = 2 in 3D."""
_UNITS = (
    ". NGSolve eliminates the unknowns of a cell without scaling, which fails if moduli and (volume of a "
    "cell)/dt differ by twenty orders of magnitude, as in geodynamics in SI units: take units in which these "
    "numbers are near one, or the split solver"
)


class CondensedJacobian:
    """The factorised linearisation of a condensed form; applies its inverse to full residuals."""

    def __init__(self, form: BilinearForm, inverse: str, ranks: Communicator) -> None:
        """``inverse`` names NGSolve's sparse solver; several ranks use PETSc's MUMPS."""
        self.form, self.inverse_type, self.ranks = form, inverse, ranks
        self.free = form.space.FreeDofs(True)
        self.inverse: BaseMatrix | None = None

    def factorise(self, state: BaseVector) -> None:
        """Assemble and factorise at ``state``; raises StepError if the matrix is singular."""
        try:
            with self.ranks.together(Exception):  # NGSolve raises NgException and std::exception alike
                self.assemble(state)
            with self.ranks.together(Exception):
                self._invert(state)
        except Exception as error:
            self.forget()
            message = f"the linearised step has no factorisation: {str(error).strip()}"
            if "CalcLU" in message:  # NGSolve does not scale a cell's rows and columns
                message += _UNITS
            raise StepError(message) from error

    def assemble(self, state: BaseVector) -> None:
        """Assemble at ``state``, with NGSolve's heap enlarged up to ``HEAP_SIZES`` if necessary."""
        for size in (*HEAP_SIZES, None):
            try:
                self.form.AssembleLinearization(state)
                return
            except Exception as error:
                if size is None or "heap overflow" not in str(error).lower():
                    raise
                SetHeapSize(size)

    def _invert(self, state: BaseVector) -> None:
        if self.inverse is not None:
            self.inverse.Update()
        elif self.ranks.is_distributed:
            self.inverse = PETScInverse(self.form.mat, self.free, self.ranks)
        else:
            self.inverse = self.form.mat.Inverse(self.free, inverse=self.inverse_type)
        self._rhs = state.CreateVector()

    def forget(self) -> None:
        """Drop the factorisation, so that the next solve makes a new one; all ranks have to call this
        method."""
        if isinstance(self.inverse, PETScInverse):
            self.inverse.release()
        self.inverse = None

    def solve(self, residual: BaseVector, increment: BaseVector) -> None:
        """Set increment = Jacobian^{-1} residual in all blocks."""
        form, rhs = self.form, self._rhs
        rhs.data = residual
        rhs.data += form.harmonic_extension_trans * residual
        increment.data = self.inverse * rhs
        increment.data += form.harmonic_extension * increment
        increment.data += form.inner_solve * rhs

    def solve_transposed(self, load: BaseVector, solution: BaseVector) -> None:
        """Set solution = Jacobian^{-T} load in all blocks; for one process only."""
        form, rhs = self.form, self._rhs
        rhs.data = load
        rhs.data += form.harmonic_extension.T * load
        assert self.inverse is not None
        solution.data = self.inverse.T * rhs
        solution.data += form.harmonic_extension_trans.T * solution
        solution.data += form.inner_solve.T * rhs


class Newton:
    """Solves R(u; .) = 0 for ``state``; keeps its vectors and factorisation between solves.

    ``update`` recomputes the local unknowns of ``state`` from the other unknowns. ``update_stored`` is called
    before the form is evaluated at a state for which ``update`` was not the last call.  Flow rules are
    linearised at ``stresses``, which are iterated together with the state.  ``has_energy`` says whether the
    state has a stored energy.  An iterate without energy counts as an iterate without a residual, because the
    derivative of a logarithm is finite even where the logarithm is not defined.  ``growths`` counts how often
    evaluations have changed the equations (``ngvisco.forms.upwinding.Largest``).
    """

    def __init__(
        self,
        form: BilinearForm,
        state: BaseVector,
        norm: BlockNorm,
        update: Callable[[], None],
        options: NewtonOptions,
        update_stored: Callable[[], None] = lambda: None,
        exchange: Exchange | None = None,
        stresses: LinearisationStress | None = None,
        has_energy: Callable[[], bool] = lambda: True,
        growths: Callable[[], int] = lambda: 0,
    ) -> None:
        self.has_energy, self.growths = has_energy, growths
        self.form, self.state, self.norm, self.options = form, state, norm, options
        self.update, self.update_stored, self.stresses = update, update_stored, stresses
        self.exchange = exchange or Exchange.of(form.space, Communicator())
        self.jacobian = CondensedJacobian(form, options.inverse, self.exchange.communicator)
        self._residual, self._trial_residual = state.CreateVector(), state.CreateVector()
        self._increment, self._next, self._base = (state.CreateVector() for _ in range(3))

    @property
    def is_factorised(self) -> bool:
        """Whether the next solve can begin with the present factorisation."""
        return self.jacobian.inverse is not None

    def reset(self) -> None:
        """Drop the factorisation, so that the next solve makes a new one."""
        self.jacobian.forget()

    def factorise(self, problem: Problem) -> None:
        """Factorise the Jacobian at the present state; raises StepError if the Jacobian is singular."""
        problem.pose()
        self._factorise(problem)

    def _factorise(self, problem: Problem, residual: BaseVector | None = None) -> None:
        """Factorise within an iteration; evaluate ``residual`` again if flow rules have got new slopes."""
        self.update_stored()
        slopes_are_new = self.stresses is not None and self.stresses.linearise()
        self.jacobian.factorise(self.state)
        problem.factorised()
        if slopes_are_new and residual is not None:
            self.form.Apply(self.state, residual)

    def solve(self, problem: Problem, guess: BaseVector) -> Solution:
        """Iterate from ``guess``; ``state`` becomes the solution, or an iterate after a failure."""
        history: list[NewtonIteration] = []
        self.state.data = guess
        problem.pose()
        if self.stresses:
            self.stresses.start()
            if self.exchange.communicator.any(self.stresses.are_stiff):
                self.reset()
        try:
            status = self._iterate(problem, history)
        except StepError as error:  # a factorisation failed
            return Solution(Status.SINGULAR, tuple(history), str(error))
        if status is Status.CONVERGED:
            return Solution(status, tuple(history))
        if status is Status.NOT_FINITE:
            return Solution(status, (), "the residual at the start of the step is not finite")
        return unconverged(status, history, "Newton", self.options.tolerance)

    def _iterate(self, problem: Problem, history: list[NewtonIteration]) -> Status:
        options, u = self.options, self.state
        self.update_stored()
        self.form.Apply(u, self._residual)
        if not self._is_finite(self._residual):
            return Status.NOT_FINITE
        fresh, damping = not self.is_factorised, 1.0
        self._set_increment(problem, fresh)
        while len(history) < options.max_iterations:
            problem.poll()
            self._base.data, growths = u, self.growths()
            self._follow(self._increment, damping)
            self.form.Apply(u, self._trial_residual)
            size = self.norm(self._increment, self._base, u)
            next_size = contraction = np.inf
            renewed = False
            # the energy is checked first: a state without energy has no finite residual either, and the
            # residual would not tell the reason
            if self.has_energy() and self._is_finite(self._trial_residual):
                next_size, contraction = self._following(size)
                # where matter begins or ceases to yield, the next increment needs new slopes
                renewed = bool(self.stresses) and not contraction <= 1 - damping / 4
                if renewed:
                    self._factorise(problem, self._trial_residual)
                    next_size, contraction = self._following(size)
            history.append(NewtonIteration(size, contraction, damping, fresh))
            is_shorter = contraction <= 1 - damping / 4
            # a residual that is not finite leaves the old increment
            stalled = fresh and options.refresh < contraction < np.inf
            if damping == 1.0 and (next_size <= options.tolerance or (stalled and self._is_rounding())):
                if contraction < 1:
                    self._follow(self._next, 1.0)
                return Status.CONVERGED
            if not is_shorter:
                u.data = self._base
                if self.stresses:
                    self.stresses.undo()
                if self.growths() != growths:  # the equations have changed for good
                    self.update()
                    self.form.Apply(u, self._residual)
                    fresh, renewed, damping = True, True, 1.0
                elif not fresh:
                    fresh, damping = True, 1.0
                elif damping > options.min_damping:
                    damping /= 2
                else:
                    return self._stalled()
                if renewed or damping == 1.0:
                    self._set_increment(problem, fresh)
                continue
            self._residual.data = self._trial_residual
            fresh = renewed or contraction > options.refresh or damping < 1
            if fresh and not renewed:
                self._set_increment(problem, fresh)
            else:
                self._increment.data = self._next
            damping = min(1.0, 2 * damping)
        return Status.TOO_MANY_ITERATIONS

    def _follow(self, increment: BaseVector, length: float) -> None:
        """Subtract ``length`` times an increment from the state, and update stresses and local unknowns."""
        if self.stresses:
            self.stresses.follow(increment, length)
        self.state.data -= length * increment
        self.update()

    def _following(self, size: float) -> tuple[float, float]:
        """The size of the next increment, from the trial residual, and its ratio to the size of the last
        increment."""
        self.jacobian.solve(self._trial_residual, self._next)
        # the contraction is NaN if an increment is not finite, so that no test accepts the increment
        contraction = self.norm(self._next, self._base, self.state) / size if size != 0 else 0.0
        return self.norm(self._next, self.state), contraction

    def _set_increment(self, problem: Problem, fresh: bool) -> None:
        """Compute the increment of the present residual.

        If ``fresh`` is True, the Jacobian is assembled at the present state first.
        """
        if fresh:
            self._factorise(problem, self._residual)
        self.jacobian.solve(self._residual, self._increment)

    def _is_finite(self, residual: BaseVector) -> bool:
        """Whether the residual is finite on all ranks; NGSolve's norm would add up shared entries in a random
        order."""
        values = residual.FV().NumPy()
        with np.errstate(over="ignore", invalid="ignore"):
            return self.exchange.communicator.all(np.isfinite(values @ values))

    def _is_rounding(self) -> bool:
        """Whether the next increment is no larger than rounding errors."""
        tolerance, coarse = self.options.tolerance, self.norm(self._next, self.state, coarse=True)
        if not tolerance < coarse <= NOISE_CAP * tolerance:
            return coarse <= tolerance
        size = self.norm(self._next, self.state)
        return size <= NEAR * tolerance or size <= self._noise()

    def _stalled(self) -> Status:
        """The status of an iteration that ends because no step length reduces the present increment."""
        self._trial_residual.data = self._residual
        if not self.norm(self._increment, self.state) <= self._noise():
            return Status.STALLED
        coarse = self.norm(self._increment, self.state, coarse=True)
        return Status.CONVERGED if coarse <= NOISE_CAP * self.options.tolerance else Status.ROUNDING

    def _noise(self) -> float:
        """The noise (``BlockNorm.noise``) of the present increment.

        The last place of the state itself changes the increment far less.  A wrong derivative, a fold or a
        kink of the equations does not enlarge the noise: the increments that they cause do not change with
        the rounding.
        """
        rows, change = (self.state.CreateVector() for _ in range(2))

        def size() -> float:
            self.update()
            self.form.Apply(self.state, rows)
            self.jacobian.solve((rows - self._trial_residual).Evaluate(), change)
            return self.norm(change, self.state)

        largest = self.norm.noise(self.state, self.exchange, size)
        self.update_stored()
        return largest
