"""L2 projections of start values, each on its own space: no matrix over all unknowns of a step.

A facet unknown's mass matrix is one block a facet, a cell unknown's one block a cell, and components
of a vector share it.  The velocity's is in ``velocity``.
"""

from ngsolve import (
    BaseVector,
    BilinearForm,
    CoefficientFunction,
    FacetFESpace,
    FESpace,
    GridFunction,
    LinearForm,
    NormalFacetFESpace,
    Periodic,
)

from ngvisco.forms.context import Context
from ngvisco.forms.mesh.quadrature import Quadrature
from ngvisco.forms.spaces import Layout
from ngvisco.forms.system import LocalProjection
from ngvisco.forms.term import Unknown, tested
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.petsc import Direct, inverse_of
from ngvisco.physics.tensors import inner


class FacetProjection:
    """Scalar facet unknowns as the means of both sides' values, in L2 of every facet.

    ``space`` is a ``FacetFESpace``, or with ``normal`` (the cells' outward normal) a
    ``NormalFacetFESpace``, whose unknown is a multiple of it.
    """

    def __init__(
        self, space: FESpace, quadrature: Quadrature, normal: CoefficientFunction | None = None
    ) -> None:
        self.space, self.quadrature = space, quadrature
        trial, test = space.TnT()
        self._test = test if normal is None else test * normal
        mass = BilinearForm(space)
        mass += (trial if normal is None else trial * normal) * self._test * quadrature.facets
        # free are neither facets of coarser meshes nor identified copies
        self._inverse = inverse_of(mass.Assemble().mat, space.FreeDofs(), Communicator.of(space.mesh))

    def __call__(self, value: CoefficientFunction) -> BaseVector:
        """Coefficients of the projection of a scalar that may differ on the two sides of a facet."""
        load = LinearForm(value * self._test * self.quadrature.facets).Assemble()
        return (self._inverse * load.vec).Evaluate()

    def release(self) -> None:
        """Give the factorisation's memory back; collective."""
        if isinstance(self._inverse, Direct):
            self._inverse.release()


def project(
    unknown: Unknown, target: GridFunction, quadrature: Quadrature, value: CoefficientFunction
) -> None:
    """Make an unknown that evolves the L2 projection of ``value``, in cells or on the walls that it lives on.

    What is prescribed stays.
    """
    space = target.space
    if unknown.is_local:
        LocalProjection(space, target, quadrature, tested(value))()
        return
    trial, test = space.TnT()
    mass, load = BilinearForm(space, symmetric=True), LinearForm(space)
    weight, measure = (1.0, quadrature.cells) if unknown.on is None else (unknown.on, quadrature.walls)
    mass += weight * inner(trial, test) * measure
    load += weight * inner(value - target, test) * measure
    inverse = inverse_of(mass.Assemble().mat, space.FreeDofs(), Communicator.of(space.mesh))
    target.vec.data += inverse * load.Assemble().vec
    if isinstance(inverse, Direct):
        inverse.release()


def set_traces(layout: Layout, state: GridFunction, context: Context, quadrature: Quadrature) -> None:
    """Traces of the state as the means of both sides' values of rho, z, ... and d_n v."""
    parts = dict(zip(layout.names, state.components, strict=True))
    now = layout.fields(state.components)
    projections: dict[tuple[str, int], FacetProjection] = {}
    for name in layout.names_of("facets", "normals"):
        unknown = layout.unknowns[name]
        normal = context.normal if unknown.place == "normals" else None
        key = unknown.place, unknown.order
        if key not in projections:
            make = FacetFESpace if normal is None else NormalFacetFESpace
            space = _identified(layout, make(layout.mesh, order=unknown.order))
            projections[key] = FacetProjection(space, quadrature, normal)
        if normal is not None:
            value = (now.grad_v * normal)[unknown.component]
            parts[name].vec.data = projections[key](value)
            continue
        if unknown.trace_of is None:
            continue
        value = now.parts[unknown.trace_of]
        for i in range(value.dim):
            row = projections[key](value[i] if value.dim > 1 else value)
            parts[name].vec[i * len(row) : (i + 1) * len(row)] = row
    for projection in projections.values():
        projection.release()


def _identified(layout: Layout, space: FESpace) -> FESpace:
    return Periodic(space) if layout.periodic else space
