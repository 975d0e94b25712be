"""Single equations of a step, with the other unknowns given; and sequences of meshes."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from ngsolve import BilinearForm, CoefficientFunction, GridFunction, Integrate, Mesh

from ngvisco import Discretisation, Model, NewtonOptions, time
from ngvisco.errors import StepError
from ngvisco.forms.boundary.walls import Walls
from ngvisco.forms.context import Context
from ngvisco.forms.fields import Fields
from ngvisco.forms.mesh.quadrature import Quadrature
from ngvisco.forms.spaces import Layout
from ngvisco.forms.system import Elimination, equations
from ngvisco.forms.term import Entry, Integrand, Term
from ngvisco.geometries import box, disc, sphere
from ngvisco.physics.tensors import square
from ngvisco.solver.newton import Newton
from ngvisco.solver.problem import Attempt, BlockNorm
from ngvisco.solver.problem import Problem as Posed
from tests.verification.manufactured import Exact

ERROR_ORDER = 12


def refinements(dim: int, maxh: float, levels: int) -> Iterator[tuple[float, Mesh]]:
    """The unstructured mesh of the unit box and its uniform refinements, each with its cell size."""
    mesh = box((1.0,) * dim, maxh)
    for level in range(levels):
        if level:
            mesh.Refine()
        yield maxh / 2**level, mesh


def balls(dim: int, maxh: float, levels: int) -> Iterator[tuple[float, Mesh]]:
    """Meshes of the unit disc or ball, each with its cell size: uniform refinement would keep the walls."""
    for level in range(levels):
        mesh = (disc if dim == 2 else sphere)(1, maxh / 2**level)
        yield mesh.ne ** (-1 / dim), mesh


def distance(f: CoefficientFunction, g: CoefficientFunction, mesh: Mesh) -> float:
    """L2 norm of f - g."""
    return float(Integrate(square(f - g), mesh, order=ERROR_ORDER)) ** 0.5


class PartialLayout(Layout):
    """Some of a step's blocks; the other fields are given functions."""

    def __init__(
        self, mesh: Mesh, model: Model, discretisation: Discretisation, names: Sequence[str]
    ) -> None:
        terms = equations(model, mesh.dim)
        super().__init__(mesh, model.material, discretisation, terms, Walls(mesh).dirichlet)
        self._make([name for name in self.names if name in names])

    def with_given(self, parts: Sequence[Any], exact: Exact) -> Fields:
        """Fields of this layout's blocks, completed by the exact ones."""
        given = {name: getattr(exact, name) for name in ("v", "rho", "z") if name not in self.names}
        fields = Fields(self, dict(zip(self.names, parts, strict=True)) | given)
        if "v" not in self.names:
            fields.grad_v = exact.grad_v
        return fields


class Source:
    """A load -int s . w of a partial system, given as integrands of the test functions."""

    def __init__(self, integrands: Callable[[Fields], list[Integrand]]) -> None:
        self.integrands = integrands

    def form(self, u: Fields, w: Fields) -> list[Integrand]:
        return self.integrands(w)

    def entries(self, u: Fields) -> list[Entry]:
        return []


class Problem:
    """Rothe steps of some of the equations."""

    def __init__(
        self,
        mesh: Mesh,
        model: Model,
        discretisation: Discretisation,
        names: Sequence[str],
        terms: Sequence[Term],
        tau: float,
    ) -> None:
        """``terms`` are those of the equations; fields not in ``names`` are the exact ones."""
        self.mesh, self.tau = mesh, tau
        self.layout = layout = PartialLayout(mesh, model, discretisation, names)
        self.state, self.state_old = GridFunction(layout.space), GridFunction(layout.space)
        new, old = Exact(model, mesh.dim, time), Exact(model, mesh.dim, time - tau)
        self.now = layout.with_given(self.state.components, new)
        before = layout.with_given(self.state_old.components, old)
        self.context = layout.context = Context(mesh, model, before, new.v)
        self.context.tau.Set(tau)
        self.context.eta.Set(1e-4)
        self.quadrature = Quadrature.for_orders(mesh, discretisation.k, discretisation.m)
        self.terms = tuple(terms)
        trial, test = layout.space.TnT()
        u, w = layout.with_given(trial, new), layout.fields(test)
        form = BilinearForm(layout.space, condense=True)
        for term in self.terms:
            self.quadrature.add(form, term.form(u, w))
        eliminate = Elimination(layout, self.state, self.quadrature, self.terms)
        norm = BlockNorm(layout.ranges, dict.fromkeys(set(layout.names) & {"v", "rho", "z"}, 1.0))
        self.newton = Newton(form, self.state.vec, norm, eliminate, NewtonOptions())

    def set(self, name: str, value: CoefficientFunction) -> None:
        """Start value of a block."""
        self.state.components[self.layout.names.index(name)].Set(value)

    def advance(self, t_old: float) -> None:
        """One step from t_old; with terms without a time derivative, their stationary problem."""
        self.state_old.vec.data = self.state.vec
        solution = self.newton.solve(_StepFrom(self.context, t_old, self.tau), self.state_old.vec)
        if not solution.converged:
            raise StepError(solution.reason, [Attempt("coupled", solution)])


@dataclass(frozen=True)
class _StepFrom(Posed):
    """The step from ``begin`` over ``tau``, s."""

    context: Context
    begin: float
    tau: float

    def pose(self) -> None:
        self.context.set_step(self.tau, self.begin + self.tau, self.begin, self.tau)
