"""Spaces of one Rothe step and access to their unknowns by name.

| unknown          | space                                             | where it lives | introduced by |
|------------------|---------------------------------------------------|----------------|---------------|
| v                | continuous P_k, v.n = 0 on axis-parallel walls    | global         | Inertia |
| rho, rho_hat     | discontinuous P_m, its trace on facets            | local, global  | Continuity |
| hess, hyperstress| P_{k-2}, symmetric in the last two indices        | local          | Hyperviscosity |
| a_1 ... a_d      | normal derivatives of v, P_{k-1} on facets        | global         | Hyperviscosity |
| z                | transported components, P_m                       | local          | Kinematics |
| zeta             | their conjugates, P_m                             | local          | Conjugates |
| z_hat            | the trace of z                                    | global         | Trace |
| jump_heat        | mean of upwinding's power over a facet, with heat | global         | JumpHeat |
| tangent_gap      | -1/2 of a jump's thrust N, P_0 on facets          | global         | TangentGap |
| without_energy   | traces without an energy, P_0 on facets           | global         | WithoutEnergy |
| cell_velocity    | mean of v over a cell                             | local          | CellVelocity |
| unbalanced_momentum | mean residual of the continuity equation tested by v | local    | UnbalancedMomentum |
| stored_mean      | mean of an energy without values on walls         | local          | StoredMean |
| Pi               | creep rate for nu > 0, continuous P_max(1, m)     | global         | CreepRate |
| rho_delta_hat    | the trace of rho in its diffusion                 | global         | DensityDiffusion |
| z_slope          | slope of z in its diffusion, P_m                  | local          | FieldDiffusion |
| zeta_delta_hat   | mean of both sides' conjugates in diffusion of z  | global         | FieldDiffusion |
| z_slope_hat      | jump of the slope's normal part                   | global         | FieldDiffusion |
| wall_stress      | P_{k-2} (2D, k = 3: P_2) on oblique, curved walls | global         | Impenetrability |

The local unknowns are condensed out cell by cell.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated, Any, Protocol

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
    Region,
    VectorH1,
    VectorValued,
)

from ngvisco.errors import ParameterError, Quantity, require_fields
from ngvisco.forms.mesh.symmetry import NO_SYMMETRY, Symmetry
from ngvisco.forms.unknown import Setting, SpaceKind, Unknown
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.mesh import MeshPart
from ngvisco.physics.material import Material, StateSpace


@dataclass(frozen=True, kw_only=True)
class Discretisation:
    """Orders of the spaces, and numbers of the scheme.

    Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    k : int
        Order of the continuous velocity, 1, 2 or 3. Order 1 needs walls along the axes, and admits no
        hyperviscosity.
    m : int
        Order of the discontinuous density and transported variables, 0, 1 or 2.
    quadrature_bonus : int
        Number added to the degree of all quadrature of forms and ledger, 0 to 12.
    sharp : bool
        Whether smeared interfaces between bodies of one density are sharpened after each step, in cells of
        two bodies.  A cell that an interface crosses completely in a step is not sharpened.  The option needs
        m = 1.
    outlines : bool
        Whether sharp interfaces follow outlines that the flow carries, in place of one plane in each cell.
        Slots and films of a body may then be thinner than a cell.  The option needs ``sharp`` and a mesh of
        triangles.
    """

    k: Annotated[int, Quantity("1", "from 1 to 3")] = 2
    m: Annotated[int, Quantity("1", "from 0 to 2")] = 1
    quadrature_bonus: Annotated[int, Quantity("1", "from 0 to 12")] = 0
    sharp: bool = False
    outlines: bool = False

    def __post_init__(self) -> None:
        require_fields(self)
        if self.outlines and not self.sharp:
            raise ParameterError("Discretisation.outlines", True, False, " unless interfaces are sharp")


class Introducing(Protocol):
    """The part of a term that the layout of the unknowns needs."""

    def unknowns(self, setting: Setting) -> tuple[Unknown, ...]: ...


@dataclass(frozen=True)
class Proxies:
    """Trial or test functions by the unknowns' names. The parts of z and zeta are also available by the
    variables' names."""

    whole: dict[str, Any]
    of_variables: dict[str, dict[str, Any]]

    def gradient(self, name: str) -> CoefficientFunction:
        """The gradient of an unknown, (components, dim)."""
        if name not in self.of_variables:
            return Grad(self.whole[name])
        rows = [Grad(part) for part in self.of_variables[name].values()]
        return CF(tuple(rows)).Reshape((self.whole[name].dim, rows[0].dims[1]))


class Layout:
    """The compound space of a Rothe step, its blocks by name, and fields of its parts."""

    def __init__(
        self,
        mesh: Mesh,
        material: Material,
        discretisation: Discretisation,
        terms: Iterable[Introducing],
        dirichlet: Sequence[Region | None],
        *,
        periodic: bool = False,
        symmetry: Symmetry = NO_SYMMETRY,
    ) -> None:
        """``terms`` introduce the unknowns; v_i is prescribed on the boundaries ``dirichlet[i]``.

        ``periodic`` identifies the unknowns on identified boundaries.  Raises ParameterError if two terms
        introduce unknowns with one name, an evolving unknown has the name of a variable of the material, or
        an order does not exist.
        """
        self.mesh, self.discretisation, self.periodic = mesh, discretisation, periodic
        self.symmetry = symmetry
        self.states = StateSpace.of(material.variables, mesh.dim)
        self._dirichlet: tuple[Region | None, ...] = tuple(dirichlet)
        setting = Setting(mesh.dim, self.states, discretisation.k, discretisation.m)
        self.unknowns: dict[str, Unknown] = {}
        for term in terms:
            for unknown in term.unknowns(setting):
                if unknown.evolves and unknown.name in self.states.slices:
                    expected = (
                        f"another name for this unknown, since the material has a variable {unknown.name!r}"
                    )
                    raise ParameterError(f"{type(term).__name__}.unknowns", unknown.name, expected)
                if unknown.name in self.unknowns:
                    expected = "a name that no other term introduces"
                    raise ParameterError(f"{type(term).__name__}.unknowns", unknown.name, expected)
                self.unknowns[unknown.name] = unknown
        self._make(list(self.unknowns))

    def on(self, mesh: Mesh) -> Layout:
        """A layout of the same unknowns on another mesh, without prescribed coefficients."""
        other = copy.copy(self)
        other.mesh, other._dirichlet = mesh, (None,) * mesh.dim  # a region belongs to one mesh
        other._make(self.names)
        return other

    def _make(self, names: Sequence[str]) -> None:
        """Make the compound space of the unknowns ``names``."""
        self.blocks = {name: self._space(self.unknowns[name]) for name in names}
        self.names = tuple(names)
        self.space = FESpace(list(self.blocks.values()))
        ranges = (self.space.Range(i) for i in range(len(self.names)))
        self.ranges = {name: slice(r.start, r.stop) for name, r in zip(self.names, ranges, strict=True)}
        kinds = {(u.place, u.order): u for u in self.unknowns.values() if u.place in _SPACES}
        # all ranks make the space here: a space made on demand would wait for ever for a failed rank
        self._scalars = {kind: self._of_place(unknown, None) for kind, unknown in kinds.items()}

    def by_variables(self) -> FESpace:
        """The compound space with one block for each variable's part of z and of zeta. Its coefficients are
        those of ``space``.

        NGSolve differentiates an integrand for pairs of components: one of a block that the integrand reads,
        and one of a block that tests the integrand. All such pairs are evaluated.
        """
        spaces: list[FESpace] = []
        for name, block in self.blocks.items():
            if name in _BY_VARIABLES:
                unknown = self.unknowns[name]
                spaces += [self._of_place(unknown, part.size) for part in self.states.spaces.values()]
            else:
                spaces.append(block)
        return FESpace(spaces)

    def functions(self, of_blocks: Sequence[Any]) -> Proxies:
        """Trial or test functions of ``by_variables`` by the unknowns' names."""
        given, whole, parts = iter(of_blocks), dict[str, Any](), dict[str, dict[str, Any]]()
        for name in self.names:
            if name in _BY_VARIABLES:
                parts[name] = {variable: next(given) for variable in self.states.spaces}
                whole[name] = CF(tuple(parts[name].values()))
            else:
                whole[name] = next(given)
        return Proxies(whole, parts)

    def count(self) -> int:
        """Number of unknowns on the whole mesh; collective."""
        mesh, ranks = self.mesh, Communicator.of(self.mesh)
        if not ranks.is_distributed:
            return int(self.space.ndof)
        if self.periodic and isinstance(mesh, MeshPart):  # a rank also sees images of identified unknowns
            return ranks.on_first(lambda: int(self.on(mesh.whole).space.ndof))
        return int(self.space.ndofglobal)

    @property
    def evolving(self) -> tuple[str, ...]:
        """The unknowns with a time derivative, the velocity first."""
        names = [name for name in self.names if self.unknowns[name].evolves]
        return tuple(sorted(names, key=lambda name: self.unknowns[name].place != "velocity"))

    @property
    def further(self) -> tuple[str, ...]:
        """Names of the further terms' evolving unknowns, all except the paper's v, rho and z."""
        return tuple(name for name in self.evolving if name not in ("v", "rho", "z"))

    def names_of(self, *places: SpaceKind) -> list[str]:
        """Names of the unknowns at these places, in their order."""
        return [name for name in self.names if self.unknowns[name].place in places]

    def _space(self, unknown: Unknown) -> FESpace:
        if unknown.place == "velocity":
            return self.velocity_space(self._dirichlet)
        return unknown.space(self.mesh) if unknown.space else self._of_place(unknown, unknown.size)

    def scalar_space(self, name: str) -> FESpace:
        """Scalar space of every component of an unknown, without constraints."""
        unknown = self.unknowns[name]
        return self._scalars[unknown.place, unknown.order]

    def _of_place(self, unknown: Unknown, size: int | None) -> FESpace:
        space = _SPACES[unknown.place](self.mesh, order=unknown.order)
        if size is not None:
            space = VectorValued(space, size)
        return Periodic(space) if self.periodic and not unknown.is_local else space

    def velocity_space(self, dirichlet: Sequence[Region | None]) -> FESpace:
        """Continuous P_k with v_i prescribed on the boundaries ``dirichlet[i]``."""
        with _numbered_boundaries(self.mesh) as names:
            patterns = {
                key: "|".join(name for name, is_in in zip(names, region.Mask(), strict=True) if is_in)
                for key, region in zip(_DIRICHLET, dirichlet, strict=False)
                if region is not None
            }
            space = VectorH1(self.mesh, order=self.discretisation.k, **patterns)
            if not self.periodic:
                return space
            identified = Periodic(space)
        free = identified.FreeDofs()  # NGSolve's Periodic loses the constraints of components
        free &= space.FreeDofs()
        return identified


_BY_VARIABLES = ("z", "zeta")
"""Unknowns with a part for each variable of the material; laws read the parts one by one."""

_SPACES = {
    "velocity": H1,
    "cells": L2,
    "facets": FacetFESpace,
    "normals": NormalFacetFESpace,
    "continuous": H1,
}
"""Spaces of scalars by the unknown's place."""

_DIRICHLET = ("dirichletx", "dirichlety", "dirichletz")


@contextmanager
def _numbered_boundaries(mesh: Mesh) -> Iterator[list[str]]:
    """Give all parts of the boundary different names within the context.

    NGSolve's vector spaces constrain components by names alone, and a wall and an interface may share a name.
    """
    given = list(mesh.GetBoundaries())
    numbered = [f"part{i}" for i, _ in enumerate(given)]
    try:
        for i, name in enumerate(numbered):
            mesh.ngmesh.SetBCName(i, name)
        yield numbered
    finally:
        for i, name in enumerate(given):
            mesh.ngmesh.SetBCName(i, name)
