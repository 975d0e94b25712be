"""Straight facets where a wall is curved: v.n = 0 on them is a wrong condition.

A continuous velocity with v.n = 0 on every side of a polygon vanishes at all corners, and in the limit on
the whole wall that the polygon approaches (Babuska): slip turns into no slip, and refinement does not help.
Measured on polygons in a disc: with k = 3 rates 1.3 of v and 0.6 of grad v; with k = 2, where only the mean
of v.n vanishes on each side, 2.4 and 2, and the geometry's error is left.  A polyhedron cannot be told
from an approximation of a curved wall with certainty.  What is looked at is
the angle between the normals of neighbouring facets of one wall, where they meet: on curved cells it is
far smaller than that between the straight facets of the same vertices, on straight ones the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from ngsolve import (
    BND,
    CF,
    IntegrationRule,
    Mesh,
    Region,
    specialcf,
    x,
    y,
    z,
)

from ngvisco.errors import MeshError
from ngvisco.forms.mesh.mesh_arrays import VERTICES, facet_sums, facets_of_walls
from ngvisco.parallel.communicator import Communicator

_FLAT = 1e-4  # rad: of facets in one plane, whose coordinates were rounded
_CORNER = np.deg2rad(59.0)  # angles above are corners of the domain, not of its approximation
_CURVED = 0.5  # share of the chords' angles that may be left; straight facets keep all


def require_curved_cells(mesh: Mesh, walls: Mapping[str, Region]) -> None:
    """Raise MeshError if a wall is bent by small angles between straight facets.

    Facets of different names are not compared: planes with names of their own may meet at any angle.
    """
    for name, region in walls.items():
        chords, left = _kinks(mesh, region)
        if sum(left) > _CURVED * sum(chords):
            worst = max(chords)
            raise MeshError(
                f"wall {name!r} is bent by {np.rad2deg(worst):.3g} degrees between straight facets, like a "
                "polygon that stands for a curved wall: there v.n = 0 tends to no slip, however fine "
                "the mesh; expected curved cells, mesh.Curve(order) on a mesh that knows its geometry (as "
                "the functions of geometries do). If the wall really is a polyhedron, give its planes "
                "names of their own, or say so by Slip(straight=True) for it"
            )


def _kinks(mesh: Mesh, wall: Region) -> tuple[list[float], list[float]]:
    """Angles between neighbouring facets of a wall, of their chords and of the facets where they meet.

    Facets in one plane and those that form a corner are left out.  Collective: two ranks may have them.
    """
    near: dict[frozenset[bytes], list[_Facet]] = {}
    for facets in Communicator.of(mesh).gathered(_facets(mesh, wall)):
        for facet in facets:
            for part in facet.parts:
                near.setdefault(part, []).append(facet)
    result: tuple[list[float], list[float]] = ([], [])
    for part, both in near.items():
        for one, other in combinations(both, 2):
            angle = _angle(one.chord, other.chord)
            if not _FLAT < angle < _CORNER:
                continue
            left = [_angle(one.normals[end], other.normals[end]) for end in part]
            result[0].append(angle)
            result[1].append(float(np.mean(left)))
    return result


@dataclass(frozen=True)
class _Facet:
    """Of a wall: outward unit normals of its chord and at its vertices, which their coordinates name.

    ``parts`` are its vertices in 2D and its edges in 3D, where it meets others.
    """

    chord: np.ndarray
    normals: dict[bytes, np.ndarray]
    parts: list[frozenset[bytes]]


def _facets(mesh: Mesh, wall: Region) -> list[_Facet]:
    """The facets of a wall that this rank has."""
    means, corners = _mean_normals(mesh)[facets_of_walls(mesh)], _corner_normals(mesh)
    result = []
    for e in wall.Elements():
        mean = means[e.nr]
        names = {v.nr: np.array(mesh[v].point).tobytes() for v in e.vertices}
        chord, at = _chord_normal(mesh, e), {v.nr: corners[e.nr, v.nr] for v in e.vertices}
        parts = [[v.nr] for v in e.vertices]
        if mesh.dim == 3:
            parts = [[v.nr for v in mesh[edge].vertices] for edge in e.edges]
        result.append(
            _Facet(
                chord=np.sign(chord @ mean) * chord,
                normals={names[nr]: np.sign(n @ mean) * n for nr, n in at.items()},
                parts=[frozenset(names[nr] for nr in part) for part in parts],
            )
        )
    return result


def _chord_normal(mesh: Mesh, element: Any) -> np.ndarray:
    """The unit normal of the straight facet between a boundary element's vertices."""
    X = [np.asarray(mesh[v].point) for v in element.vertices]
    if mesh.dim == 2:
        n = np.array([X[1][1] - X[0][1], X[0][0] - X[1][0]])
    else:  # of a quadrilateral the diagonals span it
        n = np.cross(X[1] - X[0], X[2] - X[0]) if len(X) == 3 else np.cross(X[2] - X[0], X[3] - X[1])
    return n / np.linalg.norm(n)


def _mean_normals(mesh: Mesh) -> np.ndarray:
    """(facets, dim): the outward unit normal of every boundary facet, its mean; sense elsewhere none."""
    n = specialcf.normal(mesh.dim)
    sums = np.array([facet_sums(mesh, n[i]) for i in range(mesh.dim)]).T
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    return sums / np.where(lengths > 0, lengths, 1.0)


def _corner_normals(mesh: Mesh) -> dict[tuple[int, int], np.ndarray]:
    """The unit normal, of either sign, of every boundary element at each of its vertices."""
    n = specialcf.normal(mesh.dim)
    elements = list(mesh.Elements(BND))
    result = {}
    position = CF((x, y, z)[: mesh.dim])
    for kind in sorted({e.type for e in elements}, key=str):
        points = VERTICES[kind]
        rule = IntegrationRule(points, [1.0] * len(points))
        mapped = mesh.MapToAllElements({kind: rule}, BND)
        where = np.asarray(position(mapped)).reshape(-1, len(points), mesh.dim)
        normals = np.asarray(n(mapped)).reshape(-1, len(points), mesh.dim)
        for e, X, N in zip((e for e in elements if e.type == kind), where, normals, strict=True):
            for v in e.vertices:
                distance = np.linalg.norm(X - np.asarray(mesh[v].point), axis=1)
                result[e.nr, v.nr] = N[int(np.argmin(distance))]
    return result


def _angle(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.arccos(np.clip(a @ b, -1.0, 1.0)))
