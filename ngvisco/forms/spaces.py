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
from typing import TYPE_CHECKING, Any

from ngsolve import (
    H1,
    L2,
    FacetFESpace,
    FESpace,
    Mesh,
    NormalFacetFESpace,
    Periodic,
    VectorH1,
    VectorValued,
)

from ngvisco.errors import ParameterError, require_choice
from ngvisco.forms.fields import Fields, hessian_basis
from ngvisco.physics.model import Model
from ngvisco.physics.state_space import StateSpace
from ngvisco.physics.tensors import trace_free_tensors

if TYPE_CHECKING:
    from ngvisco.forms.context import Context


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

    context: Context
    """What is known through the step, set by its owner (``ngvisco.forms.system.Step``)."""

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
        self.states = StateSpace.of(model.material.variables, dim)
        components = self.states.size
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
