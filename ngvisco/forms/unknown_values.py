"""Values of a step's unknowns at points, under the paper's symbols."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from itertools import combinations_with_replacement
from typing import Any

import numpy as np
from ngsolve import CF, CoefficientFunction, Grad, specialcf

from ngvisco.forms.spaces import Layout, Proxies
from ngvisco.physics.tensors import constant, embed_gradient, trace_free_tensors
from ngvisco.physics.variables import Values


def hessian_basis(dim: int) -> np.ndarray:
    """Orthonormal basis of symmetric dim x dim matrices, as columns, (dim^2, dim(dim+1)/2)."""
    columns = []
    for i, j in combinations_with_replacement(range(dim), 2):
        B = np.zeros((dim, dim))
        B[i, j] = B[j, i] = 1.0 if i == j else np.sqrt(0.5)
        columns.append(B.ravel())
    return np.array(columns).T


class Part:
    """Descriptor of an attribute that is the part of ``UnknownValues`` with the attribute's name."""

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    def __get__(self, fields: UnknownValues, owner: type) -> CoefficientFunction:
        return fields.parts[self.name]


class Density(Part):
    """Density or its trace: an unknown of the step, or the sum of rho_i n_i if the variables are amounts of
    matter."""

    def __get__(self, fields: UnknownValues, owner: type) -> CoefficientFunction:
        if self.name in fields.layout.unknowns:
            return fields.parts[self.name]
        return fields.layout.states.density(fields.parts[self.name.replace("rho", "z")])[0]


class UnknownValues:
    """The unknowns of a step (or tests, or known values) under the paper's symbols.

    Attributes are evaluated when they are read, so that a form contains only the attributes that it names.
    """

    v = Part()
    """Velocity, length dim."""
    rho = Density()
    rho_hat = Density()
    z = Part()
    """All transported components, a vector."""
    z_hat = Part()
    wall_stress = Part()
    """Multiplier of v.n = 0 on oblique and curved walls, Pa; on cell boundaries only."""
    zeta = Part()
    """Projected conjugates, components."""
    rho_delta_hat = Part()
    """Trace of rho in the delta-regularisation."""
    zeta_delta_hat = Part()
    """Mean of both sides' conjugates in the delta-regularisation."""
    z_slope_hat = Part()
    """Jump of the slope's normal part, divided by the sum of both sides' weights."""
    hess_square = Part()
    """Projected square s = |Hs|^2 of the recovered Hessian."""
    hyper_coefficient = Part()
    """Projected coefficient c_s of the hyperstress."""

    context: Any
    """The known data at the same points; ``Fields`` have the ``Context`` of their step."""

    def __init__(
        self,
        layout: Layout,
        parts: Mapping[str, Any],
        gradient: Callable[[str], Any] | None = None,
        rows: int | None = None,
        functions: Proxies | None = None,
    ) -> None:
        """``functions``, if given, are the trial or test functions whose parts are ``parts``; they provide
        gradients."""
        self.layout, self.parts = layout, parts
        self.dim: int = layout.mesh.dim
        self.rows = self.dim if rows is None else rows
        # this function refers to the parts alone: a reference to the values would keep their arrays alive
        self.gradient = gradient or (functions.gradient if functions else lambda name: Grad(parts[name]))
        self._variables = functions.of_variables if functions else {}
        self._made: dict[str, Any] = {}

    def once(self, name: str, make: Callable[[], Any]) -> Any:
        """The result of ``make``, a function of these values. The result is made once, for all terms that
        read it."""
        if name not in self._made:
            self._made[name] = make()
        return self._made[name]

    @cached_property
    def grad_v(self) -> CoefficientFunction:
        """Velocity gradient (grad v)_ij = d_j v_i, dim x dim."""
        gradient = self.gradient("v")
        return gradient if self.rows == self.dim else gradient.Reshape((self.rows, self.dim))

    @cached_property
    def hoop(self) -> CoefficientFunction | None:
        """Strain rate v_r/r about the axis of a body of revolution, 1/s; None for other bodies."""
        radius = self.layout.symmetry.radius
        return None if radius is None else (1 / self.context.given(radius)) * self.v[0]

    @cached_property
    def L(self) -> CoefficientFunction:
        """Velocity gradient as a 3x3 tensor."""
        return embed_gradient(self.grad_v, self.dim, self.hoop)

    @cached_property
    def grad_rho(self) -> CoefficientFunction:
        if "rho" in self.layout.unknowns:
            return self.gradient("rho")
        return self.layout.states.density(self.grad_z, self.dim)

    @cached_property
    def grad_z(self) -> CoefficientFunction:
        """Gradient of the components, (components, dim)."""
        return self.gradient("z")

    @cached_property
    def grad_zeta(self) -> CoefficientFunction:
        """Gradient of the conjugates' components, (components, dim)."""
        return self.gradient("zeta")

    @cached_property
    def z_slope(self) -> CoefficientFunction:
        """Slope of z from its conjugates in the delta-regularisation, (components, dim), 1/m."""
        return self.parts["z_slope"].Reshape((self.parts["z_slope"].dim // self.dim, self.dim))

    @cached_property
    def Pi(self) -> CoefficientFunction:
        """Creep rate for nu > 0, 3x3, symmetric and trace-free, 1/s."""
        return trace_free_tensors(self.dim).tensor(self.parts["Pi"])

    @cached_property
    def grad_Pi(self) -> CoefficientFunction:
        """Gradient of the creep rate's components, (components, dim), 1/(m s)."""
        return self.gradient("Pi")

    @cached_property
    def z_tensors(self) -> Values:
        """Transported variables by name, 3x3 or scalar."""
        return self._tensors("z")

    @cached_property
    def zeta_tensors(self) -> Values:
        """Conjugates by name, 3x3 or scalar."""
        return self._tensors("zeta")

    def _tensors(self, name: str) -> Values:
        parts = self.parts  # without a reference to self, which would keep the fields and their values alive
        return self.layout.states.tensors(lambda: parts[name], self._variables.get(name))

    @cached_property
    def hess(self) -> CoefficientFunction:
        """Components of the recovered Hessian, (dim, dim(dim+1)/2), in an orthonormal basis."""
        return self._components("hess")

    @cached_property
    def hyperstress(self) -> CoefficientFunction:
        """Components of the projected hyperstress, (dim, dim(dim+1)/2)."""
        return self._components("hyperstress")

    def hyperstress_normal(self, n: CoefficientFunction) -> CoefficientFunction:
        """Normal part (S n)_ij = S_ijk n_k of the hyperstress, dim x dim."""
        basis = hessian_basis(self.dim)
        along = constant(basis.T.reshape(-1, self.dim)) * n  # rows B n, B of the basis
        return self.hyperstress * along.Reshape((basis.shape[1], self.dim))

    @cached_property
    def div_hyperstress(self) -> CoefficientFunction:
        """Divergence (div S)_ij = d_k S_ijk of the hyperstress in a cell, dim x dim."""
        basis, dim, rows = hessian_basis(self.dim), self.dim, self.rows
        of_row = basis.reshape(dim, dim, -1).transpose(0, 2, 1).reshape(dim, -1)  # (j, (B, k))
        matrix = np.kron(np.eye(rows), of_row)
        flat = constant(matrix) * self.gradient("hyperstress").Reshape((matrix.shape[1],))  # ((i, B), k)
        return flat.Reshape((rows, dim))

    @cached_property
    def normal_derivative(self) -> CoefficientFunction:
        """Single-valued d_n v on facets, length dim; on a cell's boundary only."""
        n = specialcf.normal(self.dim)
        return CF(tuple(self.parts[name] * n for name in self.layout.names_of("normals")[: self.rows]))

    @cached_property
    def jump(self) -> CoefficientFunction:
        """Jump d_n v (facet) - d_n v (cell), length dim; on a cell's boundary only."""
        return self.normal_derivative - self.grad_v * specialcf.normal(self.dim)

    def _components(self, name: str) -> CoefficientFunction:
        return self.parts[name].Reshape((self.rows, hessian_basis(self.dim).shape[1]))
