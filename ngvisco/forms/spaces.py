"""Spaces of one Rothe step and access to their unknowns by name.

| unknown          | space                                             | where it lives |
|------------------|---------------------------------------------------|----------------|
| v                | continuous P_k, v.n = 0 on axis-parallel walls    | global         |
| a_1 ... a_d      | normal derivatives of v, P_{k-1} on facets        | global         |
| hess, hyperstress| P_{k-2}, symmetric in the last two indices        | local          |
| rho, rho_hat     | discontinuous P_m, its trace on facets            | local, global  |
| z, z_hat, zeta   | all transported components, trace, conjugates     | local, global  |
| Pi               | creep rate where nu > 0, continuous P_max(1, m)   | global         |
| rho_delta_hat, z_delta_hat | traces of the delta-regularisation      | global         |
| wall_stress      | P_{k-2} (2D, k = 3: P_2) on oblique, curved walls | global         |

The local unknowns are condensed out cell by cell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from ngsolve import (
    CF,
    H1,
    L2,
    CoefficientFunction,
    FacetFESpace,
    FESpace,
    Grad,
    Mesh,
    NormalFacetFESpace,
    Periodic,
    VectorH1,
    VectorValued,
    specialcf,
)

from ngvisco.errors import ParameterError, require_choice
from ngvisco.physics.material import component_count, tensors_of
from ngvisco.physics.model import Model
from ngvisco.physics.tensors import embed_gradient, trace_free_tensors


@dataclass(frozen=True, kw_only=True)
class Discretisation:
    """Orders of the spaces and the few numbers of the scheme.

    Parameters
    ----------
    k : int
        Order of the continuous velocity, 2 (default) or 3.
    m : int
        Order of the discontinuous density and transported fields, 0, 1 (default) or 2.
    quadrature_bonus : int
        Added to the default quadrature degree of forms and ledger alike, >= 0.
    """

    k: int = 2
    m: int = 1
    quadrature_bonus: int = 0

    def __post_init__(self) -> None:
        require_choice(self, (2, 3), k=self.k)
        require_choice(self, (0, 1, 2), m=self.m)
        require_choice(self, tuple(range(13)), quadrature_bonus=self.quadrature_bonus)


class Layout:
    """The compound space of a Rothe step, its blocks by name, and views of them as fields."""

    def __init__(
        self,
        mesh: Mesh,
        model: Model,
        discretisation: Discretisation,
        dirichlet: Sequence[str],
        *,
        periodic: bool = False,
        multiplier: FESpace | None = None,
    ) -> None:
        """``dirichlet[i]`` is the boundary pattern on which v_i is prescribed.

        ``periodic`` identifies the unknowns on identified boundaries; ``multiplier`` is the space of
        the wall stress that holds v.n = 0 on oblique and curved walls.
        """
        self.mesh, self.model, self.discretisation = mesh, model, discretisation
        self.periodic = periodic
        dim, k, m = mesh.dim, discretisation.k, discretisation.m
        components = component_count(model.material, dim)
        blocks: dict[str, FESpace] = {
            "v": self.velocity_space(dirichlet),
            "rho": L2(mesh, order=m),
            "rho_hat": FacetFESpace(mesh, order=m),
            "z": VectorValued(L2(mesh, order=m), components),
            "zeta": VectorValued(L2(mesh, order=m), components),
            "z_hat": VectorValued(FacetFESpace(mesh, order=m), components),
        }
        if model.hyperviscosity is not None:
            size = dim * hessian_basis(dim).shape[1]
            blocks["hess"] = VectorValued(L2(mesh, order=k - 2), size)
            blocks["hyperstress"] = VectorValued(L2(mesh, order=k - 2), size)
            if not model.hyperviscosity.is_linear:
                blocks["hess_square"] = L2(mesh, order=2 * k - 4)
                blocks["hyper_coefficient"] = L2(mesh, order=2 * k - 4)
            for i in range(dim):
                blocks[f"a_{i + 1}"] = NormalFacetFESpace(mesh, order=k - 1)
        if model.creep is not None and not model.creep.is_local:
            blocks["Pi"] = VectorValued(H1(mesh, order=max(1, m)), trace_free_tensors(dim).size)
        if model.regularisation is not None:
            diffused = {"delta_density": model.regularisation.delta_density}
            diffused["delta_fields"] = model.regularisation.delta_fields
            for name, delta in diffused.items():
                if delta > 0 and m == 0:
                    raise ParameterError(
                        f"Regularisation.{name}", delta, "0 with m = 0, which has no gradients"
                    )
            if model.regularisation.delta_density > 0:
                blocks["rho_delta_hat"] = FacetFESpace(mesh, order=m)
            if model.regularisation.delta_fields > 0:
                blocks["z_delta_hat"] = VectorValued(FacetFESpace(mesh, order=m), components)
        if periodic:  # v is so already
            for name in blocks:
                if name.startswith("a_") or name.endswith("_hat") or name == "Pi":
                    blocks[name] = Periodic(blocks[name])
        if multiplier is not None:
            blocks["wall_stress"] = multiplier
        self.blocks = blocks
        self.names = tuple(blocks)
        self.space = FESpace(list(blocks.values()))
        self.ranges = {
            name: slice(r.start, r.stop)
            for name, r in ((name, self.space.Range(i)) for i, name in enumerate(self.names))
        }

    def velocity_space(self, dirichlet: Sequence[str]) -> FESpace:
        """Continuous P_k with v_i prescribed on the boundary pattern ``dirichlet[i]``."""
        patterns = dict(zip(_DIRICHLET[: self.mesh.dim], dirichlet, strict=True))
        space = VectorH1(self.mesh, order=self.discretisation.k, **patterns)
        if not self.periodic:
            return space
        identified = Periodic(space)
        free = identified.FreeDofs()  # Periodic forgets the constraints of components
        free &= space.FreeDofs()
        return identified

    def scalar_velocity_space(self) -> FESpace:
        """The scalar space, without constraints, that every component of v lives in."""
        space = H1(self.mesh, order=self.discretisation.k)
        return Periodic(space) if self.periodic else space

    def scalar_facet_space(self) -> FESpace:
        """The scalar space that every component of z_hat lives in."""
        space = FacetFESpace(self.mesh, order=self.discretisation.m)
        return Periodic(space) if self.periodic else space

    def scalar_creep_space(self) -> FESpace:
        """The scalar space that every component of Pi lives in."""
        space = H1(self.mesh, order=max(1, self.discretisation.m))
        return Periodic(space) if self.periodic else space

    def fields(self, parts: Sequence[Any]) -> Fields:
        """Fields of trial or test proxies, or of a grid function's components."""
        return Fields(self, dict(zip(self.names, parts, strict=True)))


_DIRICHLET = ("dirichletx", "dirichlety", "dirichletz")


def hessian_basis(dim: int) -> np.ndarray:
    """(dim^2, dim(dim+1)/2): orthonormal basis of symmetric dim x dim matrices, as columns."""
    columns = []
    for i in range(dim):
        for j in range(i, dim):
            B = np.zeros((dim, dim))
            B[i, j] = B[j, i] = 1.0 if i == j else np.sqrt(0.5)
            columns.append(B.ravel())
    return np.array(columns).T


class Fields:
    """The unknowns of a step (or tests, or known values) under the paper's symbols.

    Everything is lazy: a form takes only what it names.
    """

    def __init__(self, layout: Layout, parts: dict[str, Any]) -> None:
        self.layout, self.parts = layout, parts
        self.dim: int = layout.mesh.dim

    @property
    def v(self) -> CoefficientFunction:
        """Velocity, length dim."""
        return self.parts["v"]

    @cached_property
    def grad_v(self) -> CoefficientFunction:
        """(grad v)_ij = d_j v_i, dim x dim."""
        return Grad(self.parts["v"])

    @cached_property
    def L(self) -> CoefficientFunction:
        """grad v as a 3x3 tensor."""
        return embed_gradient(self.grad_v, self.dim)

    @property
    def rho(self) -> CoefficientFunction:
        return self.parts["rho"]

    @cached_property
    def grad_rho(self) -> CoefficientFunction:
        return Grad(self.parts["rho"])

    @property
    def rho_hat(self) -> CoefficientFunction:
        return self.parts["rho_hat"]

    @property
    def z(self) -> CoefficientFunction:
        """All transported components, a vector."""
        return self.parts["z"]

    @cached_property
    def grad_z(self) -> CoefficientFunction:
        """Gradient of the components, (components, dim)."""
        return Grad(self.parts["z"])

    @property
    def z_hat(self) -> CoefficientFunction:
        return self.parts["z_hat"]

    @property
    def wall_stress(self) -> CoefficientFunction:
        """Multiplier of v.n = 0 on oblique and curved walls, Pa; on cell boundaries only."""
        return self.parts["wall_stress"]

    @property
    def zeta(self) -> CoefficientFunction:
        """Projected conjugates, components."""
        return self.parts["zeta"]

    @cached_property
    def grad_zeta(self) -> CoefficientFunction:
        """Gradient of the conjugates' components, (components, dim)."""
        return Grad(self.parts["zeta"])

    @property
    def rho_delta_hat(self) -> CoefficientFunction:
        """Trace of rho in the delta-regularisation."""
        return self.parts["rho_delta_hat"]

    @property
    def z_delta_hat(self) -> CoefficientFunction:
        """Trace of z in the delta-regularisation."""
        return self.parts["z_delta_hat"]

    @cached_property
    def Pi(self) -> CoefficientFunction:
        """Creep rate, 3x3, symmetric and trace-free, 1/s (where nu > 0)."""
        return trace_free_tensors(self.dim).tensor(self.parts["Pi"])

    @cached_property
    def grad_Pi(self) -> CoefficientFunction:
        """Gradient of the creep rate's components, (components, dim), 1/(m s)."""
        return Grad(self.parts["Pi"])

    @cached_property
    def z_tensors(self) -> dict[str, CoefficientFunction]:
        """Transported variables by name, 3x3 or scalar."""
        return tensors_of(self.layout.model.material, self.z, self.dim)

    @cached_property
    def zeta_tensors(self) -> dict[str, CoefficientFunction]:
        """Conjugates by name, 3x3 or scalar."""
        return tensors_of(self.layout.model.material, self.zeta, self.dim)

    @cached_property
    def hess(self) -> CoefficientFunction:
        """Components of the recovered Hessian, (dim, dim(dim+1)/2), in an orthonormal basis."""
        return self._components("hess")

    @cached_property
    def hyperstress(self) -> CoefficientFunction:
        """Components of the projected hyperstress, (dim, dim(dim+1)/2)."""
        return self._components("hyperstress")

    @property
    def hess_square(self) -> CoefficientFunction:
        """s = |Hs|^2."""
        return self.parts["hess_square"]

    @property
    def hyper_coefficient(self) -> CoefficientFunction:
        """c_s, the projected coefficient of the hyperstress."""
        return self.parts["hyper_coefficient"]

    def hyperstress_normal(self, n: CoefficientFunction) -> CoefficientFunction:
        """(S n)_ij = S_ijk n_k, dim x dim."""
        return self.hyperstress * contraction(n, self.dim)

    @cached_property
    def div_hyperstress(self) -> CoefficientFunction:
        """(div S)_ij = d_k S_ijk in a cell, dim x dim."""
        basis = hessian_basis(self.dim)
        size, dim = basis.shape[1], self.dim
        gradient = Grad(self.parts["hyperstress"])  # ((i, B), k)
        matrix = np.zeros((dim * dim, dim * size * dim))
        for i in range(dim):
            for j in range(dim):
                for b in range(size):
                    for k in range(dim):
                        matrix[i * dim + j, (i * size + b) * dim + k] = basis[j * dim + k, b]
        flat = CF(tuple(matrix.ravel()), dims=matrix.shape) * gradient.Reshape((matrix.shape[1],))
        return flat.Reshape((dim, dim))

    @cached_property
    def normal_derivative(self) -> CoefficientFunction:
        """The single-valued d_n v on facets, length dim; on a cell's boundary only."""
        n = specialcf.normal(self.dim)
        return CF(tuple(self.parts[f"a_{i + 1}"] * n for i in range(self.dim)))

    @cached_property
    def jump(self) -> CoefficientFunction:
        """d_n v (facet) - d_n v (cell), length dim; on a cell's boundary only."""
        return self.normal_derivative - self.grad_v * specialcf.normal(self.dim)

    def _components(self, name: str) -> CoefficientFunction:
        return self.parts[name].Reshape((self.dim, hessian_basis(self.dim).shape[1]))


def contraction(n: CoefficientFunction, dim: int) -> CoefficientFunction:
    """The (dim(dim+1)/2, dim) matrix with rows B n for the basis matrices B of ``hessian_basis``."""
    basis = hessian_basis(dim)
    matrix = np.zeros((basis.shape[1] * dim, dim))
    for b in range(basis.shape[1]):
        matrix[b * dim : (b + 1) * dim] = basis[:, b].reshape(dim, dim)
    rows = CF(tuple(matrix.ravel()), dims=matrix.shape) * n
    return rows.Reshape((basis.shape[1], dim))
