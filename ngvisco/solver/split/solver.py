"""The split solver: a Rothe step by Newton's method on what the fields and the flow leave of each other.

(formulation.md, Section 5.)  The coupled residual R(u) = 0 is evaluated with everything that is an
explicit function of (v, a, rho, z) - upwind traces, conjugates, local creep, the hyperviscosity's local
unknowns - put in exactly, at the points of cells and sides (``Transport``, ``Momentum``,
``MatrixHyperviscosity``).  An increment takes sweeps of the transport and one linear system of the flow,
into which the change of the fields is carried (``FlowOperator``), solved by GMRES to 3 per cent
(``Preconditioner``): Newton's method but for a coarser rule and a fixed number of sweeps.  The operator
follows the state, its preconditioner is made anew where it wears out.  Where the iteration is slow the
whole derivative of R takes its place (``newton_krylov``, ``Linearisation``).  Measurements are in
``ngvisco/solver/NOTES.md``.
"""

from __future__ import annotations

import time as clock
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from ngsolve import BaseVector

from ngvisco.errors import StepError
from ngvisco.forms.hyperviscosity import Hyperviscosity
from ngvisco.forms.system import Step
from ngvisco.solver.norm import BlockNorm
from ngvisco.solver.options import NewtonOptions
from ngvisco.solver.solution import NewtonIteration, Problem, Solution, Status
from ngvisco.solver.split.hyper import MatrixHyperviscosity
from ngvisco.solver.split.iteration import iterate
from ngvisco.solver.split.linearisation import Linearisation
from ngvisco.solver.split.momentum import Momentum
from ngvisco.solver.split.operators import Operators
from ngvisco.solver.split.preconditioner import Preconditioner, Residual
from ngvisco.solver.split.sources import KnownRows
from ngvisco.solver.split.transport import Transport
from ngvisco.solver.split.unknowns import Unknowns
from ngvisco.threads import on_arrays


class Split:
    """Solves R(u; .) = 0 for the state of a step; keeps its tangent between solves."""

    def __init__(self, step: Step, norm: BlockNorm, options: NewtonOptions) -> None:
        self.step, self.norm, self.options = step, norm, options
        self.unknowns = Unknowns(step)
        op = Operators(step, step.quadrature.volume_degree // 2)
        self.transport = Transport(step, op, self.unknowns)
        self.momentum = Momentum(step, self.transport, self.unknowns)
        laws = [term for term in step.terms if type(term) is Hyperviscosity]
        self.hyper: MatrixHyperviscosity | None = None
        if laws:
            self.hyper = MatrixHyperviscosity(step, laws[0], op.points, self.transport.facets.points)
        self.preconditioner = Preconditioner(step, self.momentum, self.hyper, self.unknowns, options)
        self.sources = None if step.sources is None else KnownRows(step, self.transport, self.unknowns)
        self.is_factorised = False
        self.seconds: dict[str, float] = defaultdict(float)
        """Wall time by parts of the work, s, since the solver was made."""
        self._linearisation: Linearisation | None = None
        self._full = step.state.vec.CreateVector()

    def reset(self) -> None:
        """Drop the tangent, so that the next solve makes a new one."""
        self.is_factorised = False

    def factorise(self, problem: Problem) -> None:
        """Make the tangent at the present state; raises StepError if it is singular."""
        problem.pose()
        self.step.eliminate.refresh()
        with on_arrays():
            self._start()
            self.residual()
            self.renew(problem)

    def residual(self) -> Residual:
        """R at the present state, whose derived unknowns are put in first."""
        t = self.transport
        with self._clock("transport"):
            t.set_velocity()
            t.set_traces()
            if self.sources is not None:
                self.sources.correct_traces()
        with self._clock("projections"):
            t.set_conjugates()
        with self._clock("transport"):
            density, z = t.residual()
        with self._clock("momentum"):
            flow, normals = self.momentum.residual(), None
        with self._clock("hyperviscosity"):
            if self.hyper is not None:
                self.hyper.set_local()
                of_v, normals = self.hyper.residual()
                flow[: of_v.size] += of_v.ravel()
        residual = Residual(flow, normals, density, z)
        if self.sources is not None:
            self.sources.add_to(residual)
        return residual

    def linearisation(self) -> Linearisation:
        """The whole derivative of R; made where it is first needed, and kept."""
        if self._linearisation is None:
            self._linearisation = Linearisation(self.momentum, self.hyper, self.unknowns)
        return self._linearisation

    def _start(self) -> None:
        """Evaluate what is known through the step."""
        self.momentum.start()
        if self.sources is not None:
            self.sources.start()

    @contextmanager
    def _clock(self, name: str) -> Iterator[None]:
        began = clock.perf_counter()
        yield
        self.seconds[name] += clock.perf_counter() - began

    def solve(self, problem: Problem, guess: BaseVector, full_steps: int | None = None) -> Solution:
        """Iterate from ``guess``; the step's state is then the solution, or some iterate."""
        if full_steps is not None:
            return Solution(Status.NOT_TRIED, (), "the split solver has no iteration by full steps only")
        history: list[NewtonIteration] = []
        self.step.state.vec.data = guess
        problem.pose()
        if not np.isfinite(guess.Norm()):
            return Solution(Status.NOT_FINITE, (), "the split solver's start value is not finite")
        try:
            with on_arrays():
                self._start()
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

    def increment(self, problem: Problem, last: float) -> tuple[np.ndarray, np.ndarray, float]:
        """The iterated unknowns, their increment and its size, infinite where R is no number.

        ``last`` is the size of the one before.
        """
        x = self.unknowns.pack()
        with np.errstate(all="ignore"):  # a diverging iterate is inf or NaN here
            r = self.residual()
        if not all(np.isfinite(part).all() for part in (r.flow, r.density, r.z)):
            return x, np.zeros_like(x), np.inf
        options = self.options.split
        if not self.is_factorised:
            self.renew(problem)
        else:
            with self._clock("assembly"):
                self.preconditioner.linearise(last > options.linearised_above)
        with self._clock("solves"):
            f = self.preconditioner(r, options.forcing)
        return x, f, self.size(f)

    def renew(self, problem: Problem) -> None:
        """Make the tangent anew at the present state, whose residual has just been evaluated."""
        self.is_factorised = False
        self.preconditioner.update(self._clock)  # where it fails there is no tangent
        self.is_factorised = True
        problem.factorised()

    def size(self, f: np.ndarray, coarse: bool = False) -> float:
        full = self._full.FV().NumPy()
        full[:] = 0.0
        for name in self.unknowns.names:
            full[self.unknowns.ranges[name]] = f[self.unknowns.slices[name]]
        return self.norm(self._full, self.step.state.vec, coarse=coarse)
