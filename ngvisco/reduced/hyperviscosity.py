"""The hyperviscosity as a function of (v, a), by matrices; its local unknowns are eliminated.

Lifting and jump are linear in (v, a) and the same for every component of v.  Their matrices are assembled
once, from the term's form for one component.  All nonlinearity is in scalars on cells
(``ngvisco.forms.terms.hyperviscosity``):

    Hs = lifting(v, a),  s = P |Hs|^2,  c_s = P c(s) + facets,  S = P (c_s Hs),

where each P is an L2 projection in a cell.  The term evaluates coefficients and penalty, at the points of the
forms' rules.  NGSolve's form takes 7 to 24 times as long (``tests/benchmarks/kernels.py``).
``tests/solver/test_split_agrees.py`` compares solutions with those of the form.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import scipy.sparse as sp
from ngsolve import BilinearForm, CoefficientFunction, FESpace, VectorValued

from ngvisco.algebra.local import LocalMatrix
from ngvisco.algebra.sparse import apply, inverse_of_blocks, mass_matrix, pruned
from ngvisco.forms.fields import Fields
from ngvisco.forms.mesh.points import csr
from ngvisco.forms.system import Step
from ngvisco.forms.terms.hyperviscosity import Hyperviscosity
from ngvisco.forms.unknown_values import hessian_basis
from ngvisco.physics.arrays import Array
from ngvisco.physics.point_products import contracted
from ngvisco.physics.variables import Values
from ngvisco.reduced.operators import Operators, PointOperators, SideOperators
from ngvisco.reduced.point_fields import FACETS, Lazy


class SideJumps:
    """The penalty's arguments at the sides' points of one rule: the jumps j = a - d_n v, h, |Hs|^2 and z."""

    jump: LocalMatrix
    """The matrix from (v, a), side by side, to j."""

    def __init__(self, hyper: MatrixHyperviscosity, op: PointOperators, other: SideJumps | None) -> None:
        """``other`` are the jumps at the points of another rule.

        ``other`` also provides the nodes, if the values at this rule's points follow from the values at those
        nodes.
        """
        matrix = op.points.operator(hyper.component, lambda u: hyper.fields_of(u).jump[0])
        shared = None if other is None else other.jump
        self.jump = LocalMatrix(matrix, hyper.step.mesh.ne, op.weights, pieces=op.pieces, other=shared)
        self.op, self.weights, self._context = op, op.weights, hyper.step.context
        if not hyper.law.is_linear:
            self.scalar = op.of("hess_square")

    @property
    def h(self) -> np.ndarray:
        """Sizes of the points' cells, m, (points,)."""
        return self.op.h

    def values(
        self, j: np.ndarray, s: np.ndarray | None, z: np.ndarray, op: PointOperators | None = None
    ) -> Fields:
        """Fields on the sides, at the points of ``op`` (by default of all sides).

        The fields are the jumps ``j``, and |Hs|^2 and z from their coefficients ``s`` and ``z``."""
        c, op = {"z": z} if s is None else {"z": z, "hess_square": s}, op or self.op
        context: Any = SimpleNamespace(h=Array(op.h, None), curvature=self._context.curvature.Get())
        u = Fields(op.layout, Lazy(lambda name: Array(op.of(name)(c[name]), None), c, FACETS), context)
        u.__dict__["jump"] = Array(j, None)
        return u


@dataclass
class HyperValues:
    """Values of the hyperviscosity's quantities at one (v, a).

    ``local`` has the coefficients of the local unknowns by name: "hess" and "hyperstress", (dim components,
    functions).  If the hyperstress is nonlinear, ``local`` also has |Hs|^2 as "hess_square", and c_s as
    "hyper_coefficient".
    """

    x: np.ndarray  # (dim, unknowns of v and a)
    local: dict[str, np.ndarray]
    jumps: np.ndarray  # (dim, sides' points)
    z: np.ndarray  # coefficients, (n, functions)
    rows: np.ndarray  # (dim, unknowns of v and a)


class MatrixHyperviscosity:
    """Evaluates the rows of v and a of one step's hyperviscosity."""

    def __init__(self, step: Step, term: Hyperviscosity, op: Operators, sides: SideOperators) -> None:
        self.step, self.term, self.law = step, term, term.law
        layout, self.dim = step.layout, step.mesh.dim
        k = layout.discretisation.k
        ones = layout.states.tensors(lambda: Array(np.ones((layout.states.size, 1)), None))
        is_uniform = all(isinstance(modulus, (int, float)) for modulus in self.law.moduli(ones))
        # functions of Hs need only one point if Hs is constant in each cell
        self.op = Operators(step, 0) if k == 2 and step.mesh.GetCurveOrder() <= 1 and is_uniform else op
        velocity = layout.scalar_space("v")
        self.velocities = velocity.ndof
        self.component = FESpace([velocity, layout.scalar_space(layout.names_of("normals")[0])])
        """The space of (v_i, a_i); lifting and jump are the same linear functions for every component i."""
        self._lifting()
        self.sides = SideJumps(self, sides, None)
        if not self.law.is_linear:
            self.s_values = self.op.of("hess_square")
            self.s_inverse = inverse_of_blocks(mass_matrix(self.s_values.matrix, self.op.weights))

    def tensors(self, z: np.ndarray) -> Values:
        """Values of the variables at the cells' points of this rule, from the coefficients ``z``."""
        return self.step.layout.states.tensors(lambda: Array(self.op.z(z), None))

    def fields_of(self, parts: Sequence[CoefficientFunction]) -> Fields:
        """One component of v and a as fields, from functions of the space of (v_i, a_i)."""
        names = ("v", self.step.layout.names_of("normals")[0])
        return Fields(self.step.layout, dict(zip(names, parts, strict=True)), rows=1)

    def _lifting(self) -> None:
        """Assemble the lifting of (v_i, a_i) from the term's form."""
        step, mesh = self.step, self.step.mesh
        scalar, size = step.layout.scalar_space("hess"), hessian_basis(self.dim).shape[1]
        tests = VectorValued(scalar, size)
        form = BilinearForm(trialspace=self.component, testspace=tests)
        X = Fields(step.layout, {"hyperstress": tests.TestFunction()}, rows=1)
        step.quadrature.add(form, self.term.lifting(self.fields_of(self.component.TrialFunction()), X))
        loads = pruned(csr(form.Assemble().mat))
        self.h_values = self.op.of("hess")
        self.h_inverse = inverse_of_blocks(mass_matrix(self.h_values.matrix, self.op.weights))
        self.size, self.h_count = size, scalar.ndof
        # rows are ordered by cells, and in a cell by the components of Hs
        inverse = sp.block_diag([self.h_inverse] * size, format="csr")
        order = np.arange(size * self.h_count).reshape(size, mesh.ne, self.h_values.local)
        self.lift = LocalMatrix((inverse @ loads).tocsr()[order.transpose(1, 0, 2).ravel()], mesh.ne)

    def lifted(self, x: np.ndarray) -> np.ndarray:
        """Coefficients of Hs, (dim size, h_count), from x = (v, a) side by side, (dim, .)."""
        by_cells = self.lift(x).reshape(self.dim, self.step.mesh.ne, self.size, self.h_values.local)
        return by_cells.swapaxes(1, 2).reshape(self.dim * self.size, self.h_count)

    def tested(self, loads: np.ndarray) -> np.ndarray:
        """Rows of (v, a), side by side, from the integrals of a stress times the basis functions of Hs."""
        by_components = loads.reshape(self.dim, self.size, self.step.mesh.ne, self.h_values.local)
        return self.lift.test(by_components.swapaxes(1, 2).reshape(self.dim, -1))

    def dissipated_on_sides(self, cells: slice, of: Mapping[str, np.ndarray]) -> dict[str, Array]:
        """Dissipation by the penalty, W/m^2, by the ledger's names, at the points of some cells' sides.

        ``of`` has the coefficients of v, a, z and |Hs|^2 in all cells, by name."""
        jumps = self.sides.jump.part(cells)(np.concatenate([of["v"], of["a"]], axis=1))
        values = self.sides.values(jumps, of.get("hess_square"), of["z"], self.sides.op.part(cells))
        return self.term.dissipated_on_facets(values)

    def __call__(self, v: np.ndarray, a: np.ndarray, z: np.ndarray) -> HyperValues:
        """Evaluate at coefficients of v, a (dim, .) and z; each may have an infinitesimal imaginary part."""
        law, sides, x = self.law, self.sides, np.concatenate([v, a], axis=1)
        hess, j, tensors = self.lifted(x), sides.jump(x), self.tensors(z)
        at_points, local = self.h_values(hess), {"hess": hess}
        if law.is_linear:
            on_sides = sides.values(j, None, z)
            at_points = at_points * value_of(law.linear(tensors))
        else:
            s = local["hess_square"] = self.s_inverse @ self.s_values.test(contracted(at_points, at_points))
            on_sides = sides.values(j, s, z)
            in_cells = law.coefficient(Array(self.s_values(s), None), tensors)
            _, coupling = self.term.penalty(on_sides)
            assert coupling is not None
            loads = self.s_values.test(in_cells.value) + sides.scalar.test(coupling.value)
            coefficient = local["hyper_coefficient"] = self.s_inverse @ loads
            at_points = at_points * self.s_values(coefficient)
        loads = self.h_values.test(at_points)
        local["hyperstress"] = apply(self.h_inverse, loads)
        rows = self.tested(loads) + sides.jump.test(value_of(self.term.stiffness(on_sides)) * j)
        return HyperValues(x, local, j, z, rows)


def value_of(modulus: Any) -> Any:
    """Return the number itself, or the values of an ``Array``."""
    return modulus.value if isinstance(modulus, Array) else modulus
