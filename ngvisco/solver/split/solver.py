"""The split solver: a Rothe step by Newton's method on what the fields and the flow leave of each other.

(FORMULATION.md, Section 7.)  The coupled residual R(u) = 0 is evaluated with everything that is an
explicit function of (v, a, rho, z) - upwind traces, conjugates, local creep, the hyperviscosity's local
unknowns - put in exactly, at the points of cells and sides (``Transport``, ``Momentum``,
``MatrixHyperviscosity``).  An increment takes sweeps of the transport and one linear system of the flow,
into which the change of the fields is carried (``FlowOperator``), solved by GMRES to 3 per cent
(``Preconditioner``): Newton's method but for a coarser rule and a fixed number of sweeps.  The operator
follows the state, its preconditioner is made anew where it wears out.  Where the iteration is slow the
whole derivative of R takes its place (``krylov``, ``Linearisation``).

What was tried, on the neo-Hookean swirl (p = 4, P2/DG1, tau = 0.02 s; sums over a step):

- forms assembled by NGSolve in every iteration, one scalar product for each component: 7.6 s a step at
  739 tetrahedra, one thread, 18 iterations; dense blocks of cells (``LocalMatrix``), phi' by arrays and
  the next point: 2.8 s, 14 iterations;
- 2,639 tetrahedra, one run: 11.5 s a step; 8.5 s with what crosses facets (``SideCoupling``) and the
  hyperviscosity's derivative in dense blocks of cells too, a smoother without the matrix' small entries, and
  the operator's blocks followed to increments of 1e-2 (1e-3 takes as many iterations, so does 1e-1);
- the linear operator by passes over the quadrature points, a dozen: 25 ms on 2,258 triangles; by element
  matrices (``FlowElements``) 9 ms, half of them the hyperviscosity's derivative, which is in blocks of cells
  as well now;
- the tangent of v factorised as a whole in 2D: 10 ms a solve on 2,258 triangles; two levels 4 ms for a
  tenth more iterations, with mu a thousand times larger for a fifth more;
- the fields predicted inside each cell only, without what crosses facets: 18 iterations of 1/4 each;
  with the fields carried by the transport 11 to 14 (739 tetrahedra); three or four sweeps over the cells
  take as many iterations as two (206 tetrahedra, Courant numbers below one), or three fewer (``Sweep``);
- the hyperviscosity by its coefficient c in the matrix of v alone, linearised once: 0.55 to 0.9 an
  iteration; with the penalty's derivative by means over the sides: eigenvalue 0.38 of the error on 762
  triangles; by a rule with as many points as P_{k-1} has functions: right to 1e-3 there, 0.5 on refined
  tetrahedra; by one of degree 4: exact for p = 4;
- inertia by the coarse rule, which does not see all of P_2: eigenvalue 2.2 on a disc, diverges;
- GMRES to 1/10: 28 iterations instead of 12 in the second step of 2,258 triangles, because what it leaves
  is not small in Newton's norm; to 1/100: a fifth more of its iterations and hardly fewer of Newton's;
- Anderson acceleration: no fewer iterations once the operator is Newton's (it had helped before);
- the operator in single precision: the same iterations, GMRES's at 2,639 tetrahedra in 42 instead of 66 ms;
- above a Courant number of one (0.99 and 1.98, a fast body on 65 triangles) no fewer than 24 iterations and
  Newton-Krylov after these, or none that converged: 14 to 21 where it takes over when four iterations, after
  the first eight, shorten the increment by less than 0.3, with a tangent made anew for each of its own;
- without the derivative of the upwinding in v: 13 instead of 11 iterations on 206 tetrahedra;
- the preconditioner kept from rest: 268 GMRES iterations in the first step of 739 tetrahedra, made anew
  after more than 12: 106;
- start values extrapolated: one or two iterations of 14 fewer.
"""

from __future__ import annotations

import time as clock
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from ngsolve import BaseVector

from ngvisco.errors import StepError
from ngvisco.forms.hyperviscosity import Hyperviscosity
from ngvisco.forms.system import Step
from ngvisco.solver.norm import BlockNorm
from ngvisco.solver.options import NewtonIteration, NewtonOptions
from ngvisco.solver.split.hyper import MatrixHyperviscosity
from ngvisco.solver.split.iteration import iterate
from ngvisco.solver.split.linearisation import Linearisation
from ngvisco.solver.split.momentum import Momentum
from ngvisco.solver.split.operators import Operators
from ngvisco.solver.split.preconditioner import FORCING, Preconditioner, Residual
from ngvisco.solver.split.sources import KnownRows
from ngvisco.solver.split.transport import Transport
from ngvisco.solver.split.unknowns import Unknowns
from ngvisco.threads import on_arrays

FOLLOWED = 1e-2
"""Increment below which only what changes suddenly is linearised anew: hyperviscosity and upwinding."""


class Split:
    """Solves R(u; .) = 0 for the state of a step; keeps its tangent between solves."""

    def __init__(
        self,
        step: Step,
        norm: BlockNorm,
        options: NewtonOptions,
        on_factorise: Callable[[], None] = lambda: None,
    ) -> None:
        """``on_factorise`` is called with the state at which the tangent has just been factorised."""
        self.step, self.norm, self.options, self.on_factorise = step, norm, options, on_factorise
        self.unknowns = Unknowns(step)
        op = Operators(step, step.quadrature.volume_degree // 2)
        self.transport = Transport(step, op, self.unknowns)
        self.momentum = Momentum(step, self.transport, self.unknowns)
        laws = [term for term in step.terms if type(term) is Hyperviscosity]
        self.hyper: MatrixHyperviscosity | None = None
        if laws:
            self.hyper = MatrixHyperviscosity(step, laws[0], op.points, self.transport.facets.points)
        self.preconditioner = Preconditioner(step, self.momentum, self.hyper, self.unknowns, options.inverse)
        self.sources = None if step.sources is None else KnownRows(step, self.transport, self.unknowns)
        self.exists = False
        self.seconds: dict[str, float] = defaultdict(float)
        """Wall time by parts of the work, s, since the solver was made."""
        self._linearisation: Linearisation | None = None
        self._full = step.state.vec.CreateVector()

    @property
    def jacobian(self) -> Split:
        """What is factorised is the tangent of this object."""
        return self

    def forget(self) -> None:
        """Drop the tangent, so that the next solve makes a new one."""
        self.exists = False

    def factorise(self, state: BaseVector) -> None:
        """Make the tangent at the present state (``state`` is its vector); raises StepError."""
        with on_arrays():
            self._start()
            self.residual()
            self.renew()

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

    def solve(self) -> list[NewtonIteration]:
        """Iterate from the present state to a solution; returns the history.

        Raises
        ------
        StepError
            When the iteration does not converge; the state is then some iterate.
        """
        history: list[NewtonIteration] = []
        with on_arrays():
            self._start()
            try:
                iterate(self, history)
            except (FloatingPointError, np.linalg.LinAlgError) as error:
                raise StepError(f"the split solver met a singular block: {error}", history) from error
            # an energy that is kept at the quadrature points is asked for by the ledger and the output
            self.step.eliminate.refresh()
        return history

    def increment(self, last: float) -> tuple[np.ndarray, np.ndarray, float]:
        """The iterated unknowns, their increment and its size, infinite where R is no number.

        ``last`` is the size of the one before.
        """
        x = self.unknowns.pack()
        with np.errstate(all="ignore"):  # a diverging iterate is inf or NaN here
            r = self.residual()
        if not all(np.isfinite(part).all() for part in (r.flow, r.density, r.z)):
            return x, np.zeros_like(x), np.inf
        if not self.exists:
            self.renew()
        else:
            with self._clock("assembly"):
                self.preconditioner.linearise(last > FOLLOWED)
        with self._clock("solves"):
            f = self.preconditioner(r, FORCING)
        return x, f, self.size(f)

    def renew(self) -> None:
        """Make the tangent anew at the present state, whose residual has just been evaluated."""
        self.preconditioner.update(self._clock)
        self.exists = True
        self.on_factorise()

    def size(self, f: np.ndarray, coarse: bool = False) -> float:
        full = self._full.FV().NumPy()
        full[:] = 0.0
        for name in self.unknowns.names:
            full[self.unknowns.ranges[name]] = f[self.unknowns.slices[name]]
        return self.norm(self._full, self.step.state.vec, coarse=coarse)
