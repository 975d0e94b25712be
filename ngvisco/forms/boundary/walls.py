"""Walls: impenetrability v.n = 0 with a free tangential part (paper: Euler-small-BC-hyper).

On a wall parallel to the axes the condition is one component of v, constrained exactly in the space.
Anything that a wall adds to the system as a form (a multiplier for an oblique or curved wall, friction,
traction) is a ``Term`` that ``wall_terms`` returns; the step sums it like every other.  Wall terms are
integrals over cell boundaries with a facetwise indicator of the wall, so that they have the quadrature
of all facet terms.  On curved geometries the mesh must be curved (``mesh.Curve(order)``): v.n = 0 on
polygons that approach a curved wall locks v (Babuska).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np
from ngsolve import H1, Compress, FacetFESpace, FESpace, Mesh, Region

from ngvisco.errors import ParameterError
from ngvisco.forms.boundary.boundaries import (
    axis_parallel_walls,
    check_boundary_names,
    interior_boundaries,
    periodic_boundaries,
    walls_of,
)
from ngvisco.forms.boundary.kinks import require_curved_cells
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.exchange import Exchange
from ngvisco.physics.heat import WallHeat
from ngvisco.physics.loads import as_vector
from ngvisco.physics.walls import HELD, MOVING, NoSlip, Passage, Slip, Traction, Wall

Conditions: TypeAlias = "Mapping[str | tuple[str, ...], Wall] | Sequence[tuple[str | tuple[str, ...], Wall]]"


class Walls:
    """Which condition holds on which boundary of a mesh, and what the spaces must do for it.

    Parameters
    ----------
    mesh : ngsolve.Mesh
    conditions : mapping of boundary names (or tuples of them) to Wall objects, or pairs of these
        Boundaries that are not named slip; boundaries that the mesh identifies, and interfaces between
        cells, are no walls, also where they have the name of one.

    Raises
    ------
    UnknownNameError
        For a name that the mesh does not have.
    ParameterError
        If a boundary is given two conditions, is periodic or an interface, or the condition is no Wall.
    MeshError
        If a wall that has to be curved is not (``kinks``).
    """

    def __init__(self, mesh: Mesh, conditions: Conditions | None = None) -> None:
        self.mesh = mesh
        self._regions: dict[tuple[str, ...], Region] = {}
        self.periodic = periodic_boundaries(mesh)
        given = _by_name(conditions or {})
        check_boundary_names(mesh, given)
        for name in given:
            if name in self.periodic:
                raise ParameterError(
                    f"walls[{name!r}]", given[name], "no condition: it is a periodic boundary"
                )
        interfaces = interior_boundaries(mesh)
        for name in interfaces.intersection(given):
            raise ParameterError(
                f"walls[{name!r}]", given[name], "no condition: it lies between two cells and is no wall"
            )
        names = sorted(set(mesh.GetBoundaries()) - self.periodic - interfaces)
        self.conditions: dict[str, Wall] = {name: given.get(name, Slip()) for name in names}
        self.axis, self.oblique = axis_parallel_walls(mesh)
        self.crossed = self._having(Passage)
        """Walls that matter crosses."""
        closed = [name for name in self.conditions if name not in self.crossed]
        self.axis = [[name for name in group if name in closed] for group in self.axis]
        fixed = self._having(*HELD)
        self.multiplied = [n for n in self.oblique if n in closed and n not in fixed]
        """Oblique or curved walls, where v.n = 0 is held by a multiplier."""
        bent = [name for name in self.multiplied if not self.conditions[name].straight]
        require_curved_cells(mesh, {name: self.region([name]) for name in bent})
        for name, wall in self.conditions.items():
            if not (wall.heat is None or isinstance(wall.heat, WallHeat)):
                raise ParameterError(f"walls[{name!r}].heat", wall.heat, "a WallHeat, or None")
            if isinstance(wall, MOVING):
                as_vector(wall.velocity, mesh.dim, f"walls[{name!r}].velocity")
            if isinstance(wall, Traction):
                as_vector(wall.f, mesh.dim, f"walls[{name!r}].f")

    def _having(self, *kinds: type[Wall]) -> list[str]:
        return [name for name, wall in self.conditions.items() if isinstance(wall, kinds)]

    @property
    def dirichlet(self) -> tuple[Region, ...]:
        """Where v_i is prescribed, one region for each i."""
        fixed = self._having(*HELD)
        return tuple(self.region([*names, *fixed]) for names in self.axis)

    @property
    def homogeneous(self) -> tuple[Region, ...]:
        """Where v_i = 0: as ``dirichlet`` without what is prescribed and not zero."""
        return tuple(self.region([*names, *self._having(NoSlip)]) for names in self.axis)

    def region(self, names: Sequence[str]) -> Region:
        """The walls of these names, without interfaces of the same name."""
        key = tuple(names)
        if key not in self._regions:
            self._regions[key] = walls_of(self.mesh, names)
        return self._regions[key]

    def multiplier_space(self, mesh: Mesh, k: int) -> FESpace:
        """Space of the multiplier of v.n = 0 for velocities in P_k: P_{k-2}, and in 2D P_2 for k = 3.

        On the mesh of the step, or on the whole of which that is a rank's part.

        P_{k-1} is the most that the traces v.n allow.  In 3D it has more unknowns than there are normal
        traces.  In 2D it has as many on a closed curve, and for even k the trace that is the same
        Legendre polynomial of degree k on every edge is orthogonal to all of it: measured on a disc with
        k = 2, rates 2.5 of v and 1.5 of grad v, against 3 and 2 with P_0.  For k = 3 P_2 and P_1 give the
        same rates, and P_2 holds a wall pressure that varies better.  On a chain of n edges that ends
        where v is constrained there are n k - 1 traces, so that its edges at such ends have one unknown
        less.
        """
        fine = mesh.dim == 2 and k == 3
        order = k - 1 if fine else k - 2
        space, multiplied = FacetFESpace(mesh, order=order), walls_of(mesh, self.multiplied)
        active = space.GetDofs(multiplied)
        others = [name for name in self.conditions if name not in self.multiplied]
        if fine and others:
            ends = _vertices(walls_of(mesh, others))
            for element in multiplied.Elements():
                if ends[[v.nr for v in element.vertices]].any():
                    active[max(space.GetDofNrs(element))] = False
        return Compress(space, active)


def _vertices(region: Region) -> np.ndarray:
    """Which vertices lie on a boundary, (vertices,), of whichever rank its facets are; collective."""
    mesh = region.mesh
    found = np.zeros(mesh.nv)
    found[[v.nr for element in region.Elements() for v in element.vertices]] = 1.0
    return Exchange.of(H1(mesh, order=1), Communicator.of(mesh)).sum(found) > 0


def _by_name(conditions: Conditions) -> dict[str, Wall]:
    pairs = conditions.items() if isinstance(conditions, Mapping) else conditions
    result: dict[str, Wall] = {}
    for key, wall in pairs:
        for name in (key,) if isinstance(key, str) else tuple(key):
            if not isinstance(wall, Wall):
                raise ParameterError(f"walls[{name!r}]", wall, "one Wall object, e.g. Slip() or NoSlip()")
            if name in result:
                raise ParameterError(f"walls[{name!r}]", (result[name], wall), "one condition, not two")
            result[name] = wall
    return result
