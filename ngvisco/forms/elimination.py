"""Local unknowns as functions of the others, evaluated exactly at every Newton iterate.

zeta, |Hs|^2, its coefficient c_s and the hyperstress are unknowns only so that the elements can be
condensed.  Newton on all of them at once may leave c_s negative and the velocity tangent indefinite
(measured: 45 iterations with restarts, or failure, where the flow turns round at p = 4); with them
recomputed from (v, a, z) after every update, it is Newton on the reduced, convex potential.
"""

from collections.abc import Iterable

from ngsolve import BaseMatrix, BilinearForm, FESpace, GridFunction, LinearForm

from ngvisco.forms.mesh.mesh_arrays import is_simplicial
from ngvisco.forms.mesh.quadrature import Quadrature
from ngvisco.forms.spaces import Layout
from ngvisco.forms.term import Integrands, Projecting, Term, refused_by_name, tested
from ngvisco.physics.tensors import inner


class LocalProjection:
    """target = cellwise L2 projection of an integrand that may have a part on the cell's boundary."""

    def __init__(
        self, space: FESpace, target: GridFunction, quadrature: Quadrature, integrands: Integrands
    ) -> None:
        self.target = target
        self.load = LinearForm(space)
        quadrature.add(self.load, integrands(space.TestFunction()))
        self.inverse_mass = _inverse_mass(space, quadrature)

    def __call__(self) -> None:
        self.load.Assemble()
        self.target.vec.data = self.inverse_mass * self.load.vec


def _inverse_mass(space: FESpace, quadrature: Quadrature) -> BaseMatrix:
    """The inverse mass matrix by the rule of the forms, which ``Mass`` has on straight simplices only."""
    mesh = quadrature.mesh
    # the same on all ranks, also on those without cells
    if mesh.comm.Max(mesh.GetCurveOrder()) <= 1 and mesh.comm.Min(is_simplicial(mesh)):
        return space.Mass(1).Inverse()
    trial, test = space.TnT()
    mass = BilinearForm(space, symmetric=True, condense=True)
    mass += inner(trial, test) * quadrature.cells
    mass.Assemble()
    return mass.inner_solve  # all unknowns belong to cells: the inverse, cell by cell


class Elimination:
    """The local unknowns of a step, recomputed in the order in which they depend on each other."""

    def __init__(
        self, layout: Layout, state: GridFunction, quadrature: Quadrature, terms: Iterable[Term]
    ) -> None:
        u = layout.fields(state.components)
        parts = dict(zip(layout.names, state.components, strict=True))
        self.energy = layout.context.energy
        self.projections: dict[str, LocalProjection] = {}
        for term in terms:
            if isinstance(term, Projecting):
                with refused_by_name(term):
                    for name, load in term.projections(u):
                        one = LocalProjection(layout.blocks[name], parts[name], quadrature, load)
                        self.projections[name] = one
        self._project_energy: LocalProjection | None = None
        target = self.energy.projected
        if target is not None:
            load = tested(self.energy.density(u))
            self._project_energy = LocalProjection(target.space, target, quadrature, load)

    def __call__(self) -> None:
        """Make the local unknowns of the state consistent with its v, a and z."""
        self.refresh()
        for projection in self.projections.values():
            projection()

    def refresh(self) -> None:
        """Make an energy that is kept at the quadrature points that of the present state."""
        if self.energy.refresh() and self._project_energy is not None:
            self._project_energy()
