"""What NGSolve's meshes and spaces know one by one, as arrays: no loop of Python's over cells or unknowns."""

from itertools import combinations

import numpy as np
from ngsolve import ET, VOL, BitArray, Mesh, Projector
from ngsolve.la import CreateVVector

SIMPLICES = (10, 12, 20, 21)
"""Netgen's numbers of triangles and tetrahedra, straight and of second order."""


def mask_of(bits: BitArray) -> np.ndarray:
    """A set of unknowns as an array of bool."""
    ones = CreateVVector(len(bits))
    ones[:] = 1.0
    Projector(bits, True).Project(ones)
    return ones.FV().NumPy() != 0


_KNOWN = {2: {ET.TRIG, ET.QUAD}, 3: {ET.TET}}
_WORDS = {ET.PYRAMID: "pyramids", ET.PRISM: "prisms", ET.HEX: "hexahedra"}


def unknown_cells(mesh: Mesh) -> list[str]:
    """Types of cells, in words, for which there are no spaces and rules here."""
    if is_simplicial(mesh):
        return []
    found = {cell.type for cell in mesh.Elements(VOL)} - _KNOWN[mesh.dim]
    return sorted(_WORDS.get(kind, str(kind)) for kind in found)


def _cells(mesh: Mesh) -> np.ndarray:
    elements = mesh.ngmesh.Elements2D() if mesh.dim == 2 else mesh.ngmesh.Elements3D()
    return elements.NumPy()


def is_simplicial(mesh: Mesh) -> bool:
    """Whether all cells are triangles or tetrahedra."""
    return bool(np.isin(_cells(mesh)["type"], SIMPLICES).all())


def vertices(mesh: Mesh) -> np.ndarray:
    """Vertices of the cells, cell by cell, from 0; (cells, dim + 1) where all are simplices."""
    if is_simplicial(mesh):
        return _cells(mesh)["nodes"][:, : mesh.dim + 1].astype(np.int64) - 1
    return np.array([v.nr for cell in mesh.Elements(VOL) for v in cell.vertices])


def coordinates(mesh: Mesh) -> np.ndarray:
    """Of the vertices, (vertices, dim), m."""
    return mesh.ngmesh.Coordinates()[: mesh.nv]


def rigid_motions(mesh: Mesh, width: int, count: int) -> np.ndarray:
    """Translations and rotations by the values at the vertices, (n, count).

    Components of v follow each other with ``width`` coefficients each, those of the vertices first.
    """
    dim, places = mesh.dim, coordinates(mesh).T
    pairs, at = list(combinations(range(dim), 2)), np.arange(mesh.nv)
    motions = np.zeros((dim + len(pairs), count))
    for i in range(dim):
        motions[i, i * width + at] = 1.0
    for motion, (i, j) in zip(motions[dim:], pairs, strict=True):
        motion[i * width + at] = -places[j]
        motion[j * width + at] = places[i]
    return motions
