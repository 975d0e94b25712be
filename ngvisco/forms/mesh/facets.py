"""Which facets lie between two cells."""

import numpy as np
from ngsolve import CoefficientFunction, FacetFESpace, LinearForm, Mesh, dx, specialcf

from ngvisco.forms.mesh.mesh_arrays import mask_of

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
