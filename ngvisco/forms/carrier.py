"""Transport of fields that do not act on the flow: one implicit Euler step of many fields with one matrix."""

from __future__ import annotations

import copy
from collections.abc import Sequence

import ngsolve as ngs
import numpy as np
from ngsolve import L2, CoefficientFunction, FESpace, GridFunction, Mesh
from ngsolve.krylovspace import GMRESSolver

from ngvisco.forms.fields import Fields
from ngvisco.forms.rates import Conjugate, Rates
from ngvisco.forms.system import Step
from ngvisco.forms.terms.transport import Trace, Upwinding, transport_in_cells, transport_through_facets
from ngvisco.forms.unknown_values import UnknownValues
from ngvisco.physics.material import StateSpace
from ngvisco.physics.parameters import Parameter
from ngvisco.physics.tensors import inner

TOLERANCE, ENOUGH, ITERATIONS = 1e-12, 1e-9, 200
"""The linear systems' tolerance; the relative residual that is still accepted because of rounding; and the
largest number of iterations."""


def cells_of(mesh: Mesh, order: int, vector: bool) -> FESpace:
    """The space of a carried field, discontinuous P_order: a scalar or a vector of dim components."""
    return ngs.VectorL2(mesh, order=order) if vector else L2(mesh, order=order)


class _Growth(Rates):
    """The rate A f of a passive field, in place of the rates of the material's variables."""

    def __init__(self, step: Step, A: CoefficientFunction | None) -> None:
        super().__init__(step.model, step.mesh.dim, step.layout.symmetry.is_axisymmetric)
        self._A = A

    def power(
        self, z: UnknownValues, along: UnknownValues, G: UnknownValues, name: Conjugate
    ) -> Sequence[CoefficientFunction]:
        return [] if self._A is None else [inner(self._A * z.z, G.parts[name])]


class Carrier:
    """Solves f/tau + (v . grad) f - A f = f_old/tau + source, with one matrix for many fields.

    Fields have the same form of transport as the material's variables (``ngvisco.forms.terms.transport``).
    The unknowns in cells are condensed, so that the system has the traces between cells alone.
    """

    def __init__(
        self,
        step: Step,
        vector: bool,
        rate: CoefficientFunction | None,
        velocity: CoefficientFunction | None = None,
    ) -> None:
        """``rate`` is A, a scalar or (dim, dim), None for A = 0; ``vector`` fields have dim components.

        If ``velocity`` is given, the fields have this velocity, and the step ``tau`` of their own. Otherwise
        they have the velocity and the step of the present state.
        """
        mesh, order = step.mesh, step.discretisation.k
        self.vector, self.cells = vector, cells_of(mesh, order, vector)
        traces = ngs.FacetFESpace(mesh, order=order)
        traces = ngs.VectorValued(traces, mesh.dim) if vector else traces
        self.space = FESpace([self.cells, ngs.Periodic(traces) if step.layout.periodic else traces])
        (f, f_hat), (g, g_hat) = self.space.TnT()
        c, layout, rules = copy.copy(step.context), copy.copy(step.layout), step.quadrature
        c.rates = _Growth(step, rate)
        v = step.now.v if velocity is None else velocity
        if velocity is not None:
            c.tau = ngs.Parameter(1.0)
        self.tau = c.tau
        layout.states = StateSpace.of((Parameter("f"),), mesh.dim)
        u = Fields(layout, {"v": v, "z": f, "z_hat": f_hat}, c)
        w = Fields(layout, {"z": g, "z_hat": g_hat}, c)
        cells = c.rate(inner(f, g)) - sum(transport_in_cells(u, u, w, "z"))
        facets = sum(Trace().facets(u, w)) + sum(Upwinding().facets(u, w))
        facets -= transport_through_facets(u, u, w, "z")
        self.form = ngs.BilinearForm(self.space, condense=True)
        self.form += rules.cells(cells.Compile())
        self.form += rules.facets(facets.Compile())
        self._preconditioner = ngs.Preconditioner(self.form, "local")
        # old values are integrated by the matrix's rule; by another rule a field at rest would grow
        self._old = GridFunction(self.cells)
        self._load = ngs.LinearForm(self.space)
        self._load += rules.cells(c.rate(inner(self._old, g)))
        self._tests, self._rules = g, rules
        self._traces = ngs.Projector(self.space.FreeDofs(True), True)
        self._solution = GridFunction(self.space)

    def carry(self, old: np.ndarray, source: CoefficientFunction | None) -> tuple[np.ndarray, bool]:
        """Coefficients of the field after a step from ``old``, with the form's present matrix.

        Returns the coefficients, and whether the linear system is solved.  If the system is not solved, the
        coefficients are the last iterate, or ``old`` if the iterate is not finite.
        """
        is_solved = True
        form, solution = self.form, self._solution
        self._old.vec.FV().NumPy()[:] = old
        rhs = self._load.Assemble().vec
        if source is not None:
            rhs += ngs.LinearForm(self._rules.cells(source * self._tests)).Assemble().vec
        reduced = (rhs + form.harmonic_extension_trans * rhs).Evaluate()
        self._traces.Project(reduced)
        solution.vec[:] = 0.0
        if reduced.Norm() > 0:
            pre = self._preconditioner.mat
            solver = GMRESSolver(form.mat, pre, tol=TOLERANCE, maxiter=ITERATIONS, printrates=False)
            solution.vec.data = solver * reduced
            # GMRES lists no residual for a single iteration, as for a body at rest
            rest = (reduced - form.mat * solution.vec).Evaluate()
            self._traces.Project(rest)
            is_solved = bool(rest.Norm() <= ENOUGH * reduced.Norm())
        solution.vec.data += form.harmonic_extension * solution.vec
        solution.vec.data += form.inner_solve * rhs
        values: np.ndarray = solution.components[0].vec.FV().NumPy().copy()
        return (values, is_solved) if np.isfinite(values).all() else (old.copy(), False)
