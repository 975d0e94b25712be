"""The system of one Rothe step, summed in the paper's order.

R(u; w) = 0, every term a left-hand side (paper: Euler-small-viscoelastodyn+disc for E,
Euler-large-viscoelastodyn+disc for F, J, ...):

    continuity           (rho - rho_old)/tau + div(rho v)                         = 0
    momentum             (rho v - rho_old v_old)/tau + div(rho v x v)
                         - div(T + D eps(v) - div S) - f                          = 0
    hyperstress          S - (mu_1 + mu |hess v|^{p-2}) hess v                    = 0
    kinematics           (z - z_old)/tau + (v.grad) z - rate(z; grad v, Pi)       = 0
    conjugates           zeta - phi'(z)                                           = 0
    upwind traces        z_hat - z on the outflow side                            = 0

with Pi = R M the creep rate, or its own equation where nu > 0, and the regularising terms if asked for.
``Step`` owns the spaces, the fields and the compiled forms; it knows no solver and no time loop.
"""

from __future__ import annotations

from collections.abc import Callable

from ngsolve import BilinearForm, GridFunction, Mesh

from ngvisco.forms.boundaries import check_mesh
from ngvisco.forms.context import Context, Entry, Integrand, Term
from ngvisco.forms.creep import CreepRate
from ngvisco.forms.elimination import Elimination
from ngvisco.forms.energy import PointwiseEnergy, StoredEnergy
from ngvisco.forms.hyperviscosity import Hyperviscosity
from ngvisco.forms.momentum import Continuity, Convection, Inertia, Loading, Stokes
from ngvisco.forms.moving_walls import MovingWalls
from ngvisco.forms.quadrature import Quadrature
from ngvisco.forms.regularisation import regularising_terms
from ngvisco.forms.spaces import Discretisation, Fields, Layout
from ngvisco.forms.transport import Conjugates, ElasticForce, Kinematics, UpwindTrace
from ngvisco.forms.wall_terms import wall_terms
from ngvisco.forms.walls import Conditions, Walls
from ngvisco.physics.model import Model


class Step:
    """Spaces, fields and forms of the step (rho, v, z)_old -> (rho, v, z).

    Parameters
    ----------
    mesh : ngsolve.Mesh
    model : Model
    discretisation : Discretisation
    sources : Term, optional
        A further term, for manufactured solutions.
    conditions : mapping of boundary names to Wall objects, optional
        What holds on walls; slip where nothing is said.
    """

    def __init__(
        self,
        mesh: Mesh,
        model: Model,
        discretisation: Discretisation | None = None,
        sources: Term | None = None,
        conditions: Conditions | None = None,
    ) -> None:
        check_mesh(mesh)
        self.mesh, self.model = mesh, model
        self.discretisation = discretisation or Discretisation()
        self.walls = Walls(mesh, conditions)
        self.layout = Layout(
            mesh,
            model,
            self.discretisation,
            self.walls.dirichlet,
            periodic=bool(self.walls.periodic),
            multiplier=self.walls.multiplier_space(self.discretisation.k),
        )
        self.state = GridFunction(self.layout.space, name="state")
        self.state_old = GridFunction(self.layout.space, name="state_old")
        self.now = self.layout.fields(self.state.components)
        self.old = self.layout.fields(self.state_old.components)
        self.moving_walls = MovingWalls(self.walls, self.layout, self.state)
        k, m, bonus = (getattr(self.discretisation, name) for name in ("k", "m", "quadrature_bonus"))
        response = model.material.response(mesh.dim)
        self.quadrature = Quadrature.for_orders(mesh, k, m, bonus)
        self.energy = StoredEnergy(model.material, mesh.dim)
        if response is not None:
            self.energy = PointwiseEnergy(model.material, response, self.quadrature, self.now, self.old, m)
        self.context = Context(mesh, self.old, self.energy)
        self.terms = self._terms(sources)
        self.sources = sources
        self.residual = self._residual()
        self.eliminate = Elimination(self.layout, self.state, self.quadrature, self.terms)

    def _terms(self, sources: Term | None) -> tuple[Term, ...]:
        model, context = self.model, self.context
        terms: list[Term] = [
            Continuity(context, model.regularisation),
            Inertia(context),
            Convection(context, model.regularisation),
            ElasticForce(model, context),
        ]
        if model.viscosity is not None:
            terms.append(Stokes(model.viscosity))
        if model.hyperviscosity is not None:
            terms.append(Hyperviscosity(model.hyperviscosity, context))
        terms += [Loading(load, context) for load in model.loads]
        terms += [
            Kinematics(model, context),
            Conjugates(model, context),
            UpwindTrace(model, context),
        ]
        if model.creep is not None and not model.creep.is_local:
            terms.append(CreepRate(model, context))
        terms += regularising_terms(model.regularisation, context)
        terms += wall_terms(self.walls, context)
        if sources is not None:
            terms.append(sources)
        return tuple(terms)

    def _residual(self) -> BilinearForm:
        """R(u; w) as one nonlinear form with element-local unknowns to be condensed."""
        trial, test = self.layout.space.TnT()
        u, w = self.layout.fields(trial), self.layout.fields(test)
        form = BilinearForm(self.layout.space, condense=True)
        for term in self.terms:
            self.quadrature.add(form, term.form(u, w))
        return form

    def entries(self, fields: Fields | None = None) -> list[Entry]:
        """All entries of the energy ledger at ``fields`` (default: the present state)."""
        u = self.now if fields is None else fields
        return [entry for term in self.terms for entry in term.entries(u)] + self._reactions()

    def _reactions(self) -> list[Entry]:
        """Power of the reactions of moving walls: the residual's rows there, tested by v."""

        def power(name: str) -> Callable[[], float]:
            def evaluate() -> float:
                residual = self.state.vec.CreateVector()
                self.residual.Apply(self.state.vec, residual)
                return self.moving_walls.reaction_power(residual, name)

            return evaluate

        return [
            Entry(f"power_wall_{name}", "power", Integrand(), power(name))
            for name in self.moving_walls.moving
        ]
