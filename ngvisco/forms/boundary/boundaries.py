"""The boundaries of a mesh: their names, directions and identifications, and walls that are refused.

Straight facets on a curved wall are refused.  A continuous velocity with v.n = 0 on every side of a polygon
vanishes at all corners. In the limit it vanishes on the whole wall that the polygon approaches (Babuska):
slip turns into no slip, and refinement does not help.  On polygons in a disc the measured convergence rates
of v and grad v are 1.3 and 0.6 with k = 3.  With k = 2 only the mean of v.n vanishes on each side: the rates
are 2.4 and 2, and the error of the geometry remains.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import combinations
from typing import TypeAlias

import numpy as np
from ngsolve import (
    BND,
    CF,
    ET,
    BitArray,
    FacetFESpace,
    GridFunction,
    Integrate,
    IntegrationRule,
    Mesh,
    Region,
    specialcf,
    x,
    y,
    z,
)

from ngvisco.errors import MeshError, require_known
from ngvisco.forms.mesh.mesh_arrays import (
    VERTICES,
    boundary_facets,
    facet_sums,
    facets_of_walls,
    facets_with_two_sides,
    mask_of,
    periodic_facets,
)
from ngvisco.parallel.communicator import Communicator
from ngvisco.words import Words, call

_PARALLEL = 1e-10
# rad; two facets with a smaller angle lie in one plane, up to rounding of their coordinates
_FLAT = 1e-4
_CORNER = np.deg2rad(59.0)  # a larger angle is a corner of the domain, not of its approximation
_CURVED = 0.5  # largest ratio, on a curved wall, of the facets' angle to their chords' angle; 1 if straight


def check_boundary_names(mesh: Mesh, names: Iterable[str], owner: str = "walls") -> None:
    """Raise UnknownNameError for a name that no boundary of the mesh has; NGSolve stays silent."""
    require_known("boundary", names, set(mesh.GetBoundaries()), f"{owner}[]")


def axis_parallel_walls(mesh: Mesh) -> tuple[list[list[str]], list[str]]:
    """Names of the boundaries normal to each axis, and of the boundaries normal to no axis."""
    n = specialcf.normal(mesh.dim)
    walls: list[list[str]] = [[] for _ in range(mesh.dim)]
    oblique: list[str] = []
    for name in sorted(set(mesh.GetBoundaries())):
        region = walls_of(mesh, [name])
        area = Integrate(CF(1.0), mesh, BND, definedon=region)
        tilt = [abs(Integrate(1 - n[i] * n[i], mesh, BND, definedon=region)) for i in range(mesh.dim)]
        axis = int(np.argmin(tilt))
        (walls[axis] if tilt[axis] <= _PARALLEL * area else oblique).append(name)
    return walls, oblique


def periodic_boundaries(mesh: Mesh) -> set[str]:
    """Names of the boundaries that the mesh identifies with each other.

    Raises MeshError for a boundary of which only a part is identified.
    """
    names, identified = np.array(mesh.GetBoundaries()), np.zeros_like(boundary_facets(mesh))
    identified[list(periodic_facets(mesh))] = True
    totals = _counts(mesh, identified)
    counts = {str(name): totals[names == name].sum(axis=0) for name in sorted(set(names))}
    for name, (free, both) in counts.items():
        if free and both:
            raise MeshError(f"a part of the boundary {name!r} is periodic; give this part a name of its own")
    return {name for name, (_, both) in counts.items() if both}


def interior_boundaries(mesh: Mesh) -> set[str]:
    """Names of interfaces: boundaries whose parts all lie between two cells. Interfaces are not walls.

    Raises MeshError if a part of the boundary (Netgen: an edge or face of the geometry) lies only partly
    between two cells.
    """
    names, interfaces = mesh.GetBoundaries(), _interfaces(mesh)
    return {names[i] for i in interfaces} - {name for i, name in enumerate(names) if i not in interfaces}


def walls_of(mesh: Mesh, names: Iterable[str]) -> Region:
    """The boundaries with ``names``, without parts that lie between two cells.

    Interfaces between subdomains often have the name that all boundaries without a name of their own share.
    If all parts of a name are interfaces, the result has all of them.
    """
    chosen, boundaries = set(names), mesh.GetBoundaries()
    mask = BitArray(len(boundaries))
    mask.Clear()
    left_out = _interfaces(mesh) if any(boundaries.count(name) > 1 for name in chosen) else set()
    outer = {name for i, name in enumerate(boundaries) if i not in left_out}
    for i, name in enumerate(boundaries):
        if name in chosen and not (i in left_out and name in outer):
            mask[i] = True
    return Region(mesh, BND, mask)


def _interfaces(mesh: Mesh) -> set[int]:
    """Numbers of the boundaries' parts that lie between two cells. Raises MeshError for a part that lies only
    partly between cells."""
    totals = _counts(mesh, facets_with_two_sides(mesh) & boundary_facets(mesh))
    for name, (outer, inner) in zip(mesh.GetBoundaries(), totals, strict=True):
        if outer and inner:
            raise MeshError(
                f"a part of the boundary {name!r} lies between cells; divide the boundary, in the geometry "
                "or by physical groups, into a wall and an interface"
            )
    return {int(i) for i in np.flatnonzero(totals[:, 1])}


def _counts(mesh: Mesh, chosen: np.ndarray) -> np.ndarray:
    """Numbers of facets that are not chosen and that are chosen, in each part of the boundary, (parts, 2)."""
    counts = np.zeros((len(mesh.GetBoundaries()), 2), dtype=int)
    if mesh.comm.Sum(int(chosen.any())):
        parts = [element.index for element in mesh.Elements(BND)]
        np.add.at(counts, (parts, chosen[facets_of_walls(mesh)].astype(int)), 1)
        counts = np.array([[mesh.comm.Sum(int(count)) for count in pair] for pair in counts])
    return counts


def facet_indicator(mesh: Mesh, names: Iterable[str]) -> GridFunction:
    """Indicator of the facets of the boundaries ``names`` (``walls_of``): 1 there, 0 on all others."""
    space = FacetFESpace(mesh, order=0)
    indicator = GridFunction(space)
    indicator.vec.FV().NumPy()[:] = mask_of(space.GetDofs(walls_of(mesh, names)))
    return indicator


def cells_at(mesh: Mesh, walls: Region) -> BitArray:
    """The cells with a facet on the region ``walls`` of the boundary."""
    cells = BitArray(mesh.ne)
    cells.Clear()
    for element in walls.Elements():
        for facet in element.facets:
            for cell in mesh[facet].elements:
                cells[cell.nr] = True
    return cells


def require_curved_cells(mesh: Mesh, walls: Mapping[str, Region]) -> None:
    """Raise MeshError if a wall is bent by small angles between straight facets.

    A polyhedron cannot be distinguished from an approximation of a curved wall with certainty.  The check
    compares the normals of neighbouring facets of one wall, where the facets meet. On curved cells the angle
    of these normals is far smaller than the angle of the straight facets with the same vertices; on straight
    cells the two angles are equal.  Facets of different names are not compared: planes with different names
    may meet at any angle.
    """
    for name, region in walls.items():
        if angle := bend(mesh, region):
            message = (
                f"wall {name!r} is bent by {np.rad2deg(angle):.3g} degrees between straight facets, like a "
                "polygon that approximates a curved wall. On such a wall v.n = 0 acts as no slip, however "
                "fine the mesh is. Expected curved cells: call mesh.Curve(order) on a mesh that has its "
                "geometry, as the functions of ngvisco.geometries do. If the wall is really a polyhedron, "
                "give each plane a name, or give the wall "
            )
            raise MeshError(Words(message, call("Slip", straight=True)))


def bend(mesh: Mesh, wall: Region) -> float:
    """Largest angle, rad, between straight facets that may approximate a curved wall; 0 for other walls."""
    chords, left = _kinks(mesh, wall)
    return max(chords) if sum(left) > _CURVED * sum(chords) else 0.0


_Facet: TypeAlias = tuple[np.ndarray, dict[bytes, np.ndarray]]
"""Outward unit normals of a facet: the normal of its chord, and the normals at its vertices by the vertices'
coordinates."""


def _kinks(mesh: Mesh, wall: Region) -> tuple[list[float], list[float]]:
    """Angles between neighbouring facets' chords, and between their normals where the facets meet.

    Pairs of facets in one plane, and pairs at corners of the domain, are left out.
    """
    near: dict[frozenset[bytes], list[_Facet]] = {}
    for facets in Communicator.of(mesh).gathered(_facets(mesh, wall)):  # neighbours may be on two ranks
        for facet in facets:
            # the common part of a facet and its neighbour is a vertex, in 3D an edge
            for part in combinations(facet[1], mesh.dim - 1):
                near.setdefault(frozenset(part), []).append(facet)
    chords, left = [], []
    for part, both in near.items():
        for (chord, normals), (chord_there, normals_there) in combinations(both, 2):
            if _FLAT < (angle := _angle(chord, chord_there)) < _CORNER:
                chords.append(angle)
                left.append(float(np.mean([_angle(normals[end], normals_there[end]) for end in part])))
    return chords, left


def _facets(mesh: Mesh, wall: Region) -> list[_Facet]:
    """This rank's facets of a wall."""
    n, position = specialcf.normal(mesh.dim), CF((x, y, z)[: mesh.dim])
    outward = np.array([facet_sums(mesh, n[i]) for i in range(mesh.dim)]).T[facets_of_walls(mesh)]
    kind = ET.SEGM if mesh.dim == 2 else ET.TRIG
    corners = VERTICES[kind]
    mapped = mesh.MapToAllElements({kind: IntegrationRule(corners, [1.0] * len(corners))}, wall)
    where, normals = (np.asarray(f(mapped)).reshape(-1, len(corners), mesh.dim) for f in (position, n))
    facets = []
    for element, X, N in zip(wall.Elements(), where, normals, strict=True):
        points, out = np.array([mesh[v].point for v in element.vertices]), outward[element.nr]
        chord = np.linalg.svd(points - points.mean(axis=0))[2][-1]
        nearest = [int(np.argmin(np.linalg.norm(X - point, axis=1))) for point in points]
        at = {p.tobytes(): np.sign(N[i] @ out) * N[i] for p, i in zip(points, nearest, strict=True)}
        facets.append((np.sign(chord @ out) * chord, at))
    return facets


def _angle(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.arccos(np.clip(a @ b, -1.0, 1.0)))
