"""The boundaries of a mesh: their names, directions and identifications, and meshes that are refused."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from ngsolve import BND, CF, BitArray, FacetFESpace, GridFunction, Integrate, Mesh, Region, specialcf

from ngvisco.errors import MeshError, UnknownNameError
from ngvisco.forms.context import periodic_facets
from ngvisco.forms.mesh.mesh_arrays import (
    boundary_facets,
    check_orientation,
    facets_of_walls,
    facets_with_two_sides,
    mask_of,
    unknown_cells,
)

_PARALLEL = 1e-10


def check_mesh(mesh: Mesh) -> None:
    """Raise MeshError unless the mesh is 2D or 3D, has cells, all of known types, and none is inverted."""
    if mesh.dim not in (2, 3):
        raise MeshError(f"the mesh has dimension {mesh.dim}: expected 2 (plane strain) or 3")
    if mesh.comm.Sum(mesh.ne) == 0:
        raise MeshError("the mesh has no volume elements: mesh the interior, not only its surface")
    others = unknown_cells(mesh)
    if mesh.comm.Sum(len(others)):
        names = ", ".join(others) or "others"
        raise MeshError(
            f"the mesh has cells of the types {names}: expected triangles and quadrilaterals, or tetrahedra "
            "(mesh.ngmesh.Split2Tets() divides hexahedra and prisms)"
        )
    check_orientation(mesh)


def check_boundary_names(mesh: Mesh, names: Iterable[str]) -> None:
    """Raise UnknownNameError for a name that no boundary of the mesh has; NGSolve stays silent."""
    known = set(mesh.GetBoundaries())
    for name in names:
        if name not in known:
            raise UnknownNameError("boundary", name, known)


def axis_parallel_walls(mesh: Mesh) -> tuple[list[list[str]], list[str]]:
    """For each axis the boundaries normal to it, and the boundaries that are normal to none."""
    n = specialcf.normal(mesh.dim)
    walls: list[list[str]] = [[] for _ in range(mesh.dim)]
    others: list[str] = []
    for name in sorted(set(mesh.GetBoundaries())):
        region = walls_of(mesh, [name])
        area = Integrate(CF(1.0), mesh, BND, definedon=region)
        tilt = [abs(Integrate(1 - n[i] * n[i], mesh, BND, definedon=region)) for i in range(mesh.dim)]
        axis = int(np.argmin(tilt))
        (walls[axis] if tilt[axis] <= _PARALLEL * area else others).append(name)
    return walls, others


def periodic_boundaries(mesh: Mesh) -> set[str]:
    """Names of the boundaries that the mesh identifies with each other.

    Raises
    ------
    MeshError
        If only a part of a name's boundary is identified.
    """
    names, identified = np.array(mesh.GetBoundaries()), np.zeros_like(boundary_facets(mesh))
    identified[list(periodic_facets(mesh))] = True
    totals = _counts(mesh, identified)
    counts = {str(name): totals[names == name].sum(axis=0) for name in sorted(set(names))}
    for name, (free, both) in counts.items():
        if free and both:
            raise MeshError(f"boundary {name!r} is periodic in a part only: give that part a name of its own")
    return {name for name, (_, both) in counts.items() if both}


def interior_boundaries(mesh: Mesh) -> set[str]:
    """Names of boundaries that lie between two cells with all their parts: interfaces, which are no walls.

    Raises
    ------
    MeshError
        If a part of the boundary (Netgen: an edge or face of the geometry) does so in a part only.
    """
    names, interfaces = mesh.GetBoundaries(), _interfaces(mesh)
    return {names[i] for i in interfaces} - {name for i, name in enumerate(names) if i not in interfaces}


def walls_of(mesh: Mesh, names: Iterable[str]) -> Region:
    """The boundaries of these names without the parts of them that lie between two cells.

    Interfaces between subdomains often have the name that all unnamed boundaries have.  A name of which all
    parts are interfaces has them all.
    """
    wanted, known = set(names), mesh.GetBoundaries()
    mask = BitArray(len(known))
    mask.Clear()
    left_out = _interfaces(mesh) if any(known.count(name) > 1 for name in wanted) else set()
    outer = {name for i, name in enumerate(known) if i not in left_out}
    for i, name in enumerate(known):
        if name in wanted and not (i in left_out and name in outer):
            mask[i] = True
    return Region(mesh, BND, mask)


def _interfaces(mesh: Mesh) -> set[int]:
    """Numbers of the boundaries' parts that lie between two cells; MeshError for one that does in a part."""
    totals = _counts(mesh, facets_with_two_sides(mesh) & boundary_facets(mesh))
    for name, (outer, inner) in zip(mesh.GetBoundaries(), totals, strict=True):
        if outer and inner:
            raise MeshError(
                f"boundary {name!r} has a part that lies between cells in a part only: divide it, in the "
                "geometry or by physical groups, into what is wall and what is interface"
            )
    return {int(i) for i in np.flatnonzero(totals[:, 1])}


def _counts(mesh: Mesh, chosen: np.ndarray) -> np.ndarray:
    """How many facets of each part of the boundary are not among the chosen ones, and are, (parts, 2)."""
    counts = np.zeros((len(mesh.GetBoundaries()), 2), dtype=int)
    if mesh.comm.Sum(int(chosen.any())):
        parts = [element.index for element in mesh.Elements(BND)]
        np.add.at(counts, (parts, chosen[facets_of_walls(mesh)].astype(int)), 1)
        counts = np.array([[mesh.comm.Sum(int(count)) for count in pair] for pair in counts])
    return counts


def facet_indicator(mesh: Mesh, names: Iterable[str]) -> GridFunction:
    """1 on the facets of these boundaries (``walls_of``), 0 on all others."""
    space = FacetFESpace(mesh, order=0)
    indicator = GridFunction(space)
    indicator.vec.FV().NumPy()[:] = mask_of(space.GetDofs(walls_of(mesh, names)))
    return indicator
