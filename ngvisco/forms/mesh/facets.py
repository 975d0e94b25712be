"""Facets between two cells, and inverted cells: NGSolve integrates with |det|, no volume shows one."""

import numpy as np
from ngsolve import (
    ET,
    VOL,
    CoefficientFunction,
    Det,
    FacetFESpace,
    IntegrationRule,
    LinearForm,
    Mesh,
    dx,
    specialcf,
)

from ngvisco.errors import MeshError
from ngvisco.forms.mesh.mesh_arrays import mask_of
from ngvisco.parallel.communicator import Communicator

_OPPOSED = 1e-6  # of the facet's area: what is left of the normals' sum


def facets_with_two_sides(mesh: Mesh) -> np.ndarray:
    """Where two cells lie on different sides of a facet, so that their outward normals cancel; (facets,).

    Facets that the mesh identifies with another one have one side each.
    """
    q = FacetFESpace(mesh, order=0).TestFunction()
    n = specialcf.normal(mesh.dim)

    def assembled(value: CoefficientFunction) -> np.ndarray:
        sums = LinearForm(value * q * dx(element_boundary=True)).Assemble().vec
        sums.Cumulate()  # the other side may belong to another rank
        return sums.FV().NumPy().copy()

    # the mean normals of both sides, over twice the area of the facet
    sums = np.array([assembled(n[i]) for i in range(mesh.dim)])
    return np.linalg.norm(sums, axis=0) <= _OPPOSED * assembled(1 + 0 * n[0])


def boundary_facets(mesh: Mesh) -> np.ndarray:
    """Where the mesh has boundary elements: walls, identified boundaries, interfaces; (facets,)."""
    space = FacetFESpace(mesh, order=0)
    return mask_of(space.GetDofs(mesh.Boundaries(".*")))


_ORDER = 4  # degree of the points at which the determinant is looked at; curved cells vary inside


def check_orientation(mesh: Mesh) -> None:
    """Raise MeshError for a cell that is turned inside out, in part or as a whole.

    Two things are looked at.  The determinant of the map from the reference cell keeps its sign and
    is nowhere zero in a cell; which sign is only a matter of the order of its vertices.  The two cells
    of an inner facet lie on different sides of it, so that their outward normals cancel.
    """
    for check in (_of_determinants, _of_sides):
        error = Communicator.of(mesh).agree(check(mesh))
        if error is not None:
            raise error


def _of_determinants(mesh: Mesh) -> MeshError | None:
    types = (ET.TRIG, ET.QUAD) if mesh.dim == 2 else (ET.TET,)
    determinant = Det(specialcf.JacobianMatrix(mesh.dim))
    for et in types:
        rule = IntegrationRule(et, _ORDER)
        points = mesh.MapToAllElements({et: rule}, VOL)
        values = np.asarray(determinant(points)).reshape(-1, len(rule.points))
        flat = np.sign(values).min(axis=1) * np.sign(values).max(axis=1) <= 0
        if flat.any():
            row = int(np.argmax(flat))
            numbers = [element.nr for element in mesh.Elements(VOL) if element.type == et]
            return MeshError(
                f"element {numbers[row]} is inverted or flat: the determinant of its map takes values from "
                f"{values[row].min():.3e} to {values[row].max():.3e}; expected one sign and no zero"
            )
    return None


def _of_sides(mesh: Mesh) -> MeshError | None:
    doubled = ~(facets_with_two_sides(mesh) | boundary_facets(mesh))
    if not doubled.any():
        return None
    facet = int(np.argmax(doubled))
    return MeshError(
        f"facet {facet}, on no boundary, has cells on one side only: "
        "a cell is inverted, cells overlap, or the mesh lacks a boundary element there"
    )
