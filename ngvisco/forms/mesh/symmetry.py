"""Symmetry of a mesh of two dimensions: a slab in plane strain, or a body of revolution.

The fields of a body of revolution about the line x = 0 that does not swirl depend on y and r = x alone. With
the unit vector e around the axis, which is the third direction of tensors, the velocity gradient is

    L = grad v + (v_r/r) e x e.

Integrals are int f r dr dy in cells and int f r ds on facets: the integrals in 3D, divided by 2 pi. For such
fields the scheme is the three-dimensional one: tests w also have the strain w_r/r, and the same terms cancel.
Quadrature points lie inside cells and facets, where r > 0.

A facet on the axis has no area.  Integrands on a facet of the axis are zero, since v . n = 0 and the trace is
the cell's value.  Only the equations of the traces keep a positive weight on the axis.
"""

from __future__ import annotations

from dataclasses import dataclass

from ngsolve import CF, CoefficientFunction, IfPos, Mesh, x

from ngvisco.errors import MeshError, ParameterError
from ngvisco.forms.mesh.mesh_arrays import coordinates
from ngvisco.parallel.communicator import Communicator

AXISYMMETRIC = "axisymmetric"
SYMMETRIES = ("none", AXISYMMETRIC)
"""Values of ``Simulation(symmetry=...)``; without a symmetry, a mesh of two dimensions is in plane strain."""

ON_AXIS = 1e-10
"""The share of the largest radius below which a point is on the axis."""


@dataclass(frozen=True)
class Symmetry:
    """Weights of integrals over cells and facets, and whether v_r/r is a strain rate.

    Attributes
    ----------
    largest_radius : float or None
        Largest distance from the axis of a body of revolution, m; None for other bodies.
    """

    largest_radius: float | None = None

    @classmethod
    def of(cls, mesh: Mesh, kind: str) -> Symmetry:
        """Return the symmetry of a mesh that is named ``kind``.

        Raises ParameterError for an unknown kind or three dimensions, MeshError for r < 0.
        """
        if kind not in SYMMETRIES:
            raise ParameterError("Simulation.symmetry", kind, f"one of {', '.join(map(repr, SYMMETRIES))}")
        if kind != AXISYMMETRIC:
            return cls()
        if mesh.dim != 2:
            raise ParameterError("Simulation.symmetry", kind, "'none' in three dimensions")
        ranks, r = Communicator.of(mesh), coordinates(mesh)[:, 0]
        least, largest = ranks.least(r), ranks.most(r)
        if least < -ON_AXIS * largest:
            raise MeshError(
                f"the mesh has x = {least:.4g} m, but x is the distance from the axis of an axisymmetric "
                "body; expected x >= 0"
            )
        return cls(largest)

    @property
    def is_axisymmetric(self) -> bool:
        return self.largest_radius is not None

    @property
    def radius(self) -> CoefficientFunction | None:
        """Distance from the axis, m, the weight of integrals over cells; None without an axis."""
        return x if self.is_axisymmetric else None

    @property
    def on_facets(self) -> CoefficientFunction | None:
        """Weight of integrals over facets, positive on the axis too; None without an axis."""
        if self.largest_radius is None:
            return None
        return IfPos(x - ON_AXIS * self.largest_radius, x, CF(self.largest_radius))


NO_SYMMETRY = Symmetry()


def weighted(integrand: CoefficientFunction, weight: CoefficientFunction | None) -> CoefficientFunction:
    """Return an integrand multiplied by a weight; the weight None means 1."""
    return integrand if weight is None else weight * integrand
