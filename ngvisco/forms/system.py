"""The system of one Rothe step, summed in the paper's order.

R(u; w) = 0, where every term is a left-hand side (paper: Euler-small-viscoelastodyn+disc for E,
Euler-large-viscoelastodyn+disc for F, J, ...):

    continuity           (rho - rho_old)/tau + div(rho v)                         = 0
    momentum             (rho v - m_old)/tau + div(rho v x v)
                         - div(T + D eps(v) - div S) - f                          = 0
    hyperstress          S - (mu_1 + mu |hess v|^{p-2}) hess v                    = 0
    kinematics           (z - z_old)/tau + (v.grad) z - rate(z; grad v, Pi)       = 0
    conjugates           zeta - phi'(z)                                           = 0
    traces               z_hat - (z_1 + z_2)/2 on facets                          = 0

with the creep rate Pi = R M, or the equation of Pi for nu > 0, and with the regularising terms if a model has
them.  The old momentum m_old is rho_old v_old for the paper's scheme; other schemes start from combinations
of states, which are linear in (rho, m, z).  ``Step`` owns the spaces, the fields and the compiled forms; it
knows no solver and no time loop.

Local unknowns are functions of the other unknowns, and are evaluated exactly at every Newton iterate. zeta,
|Hs|^2, its coefficient c_s and the hyperstress are unknowns only so that the elements can be condensed.
Newton's method for all unknowns at once may leave c_s negative and the velocity tangent indefinite.  If the
local unknowns are recomputed from (v, a, z) after every update, the method is Newton's method for the
reduced, convex potential.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
from ngsolve import CF, VOL, BilinearForm, BitArray, CoefficientFunction, ElementId, GridFunction, Mesh

from ngvisco.forms.boundary.axis import require_symmetry
from ngvisco.forms.boundary.wall_terms import Impenetrability, passages_of, wall_terms
from ngvisco.forms.boundary.walls import Conditions, MovingWalls, Walls
from ngvisco.forms.context import Context, StepLayout
from ngvisco.forms.damage import DamageGrowth
from ngvisco.forms.driving_stress import KeptRates, LinearisationStress, LinearisedRates
from ngvisco.forms.energy import PointwiseEnergy, StoredEnergy
from ngvisco.forms.fields import Fields, Tests
from ngvisco.forms.mesh.mesh_arrays import check_mesh
from ngvisco.forms.mesh.quadrature import Quadrature
from ngvisco.forms.mesh.symmetry import Symmetry
from ngvisco.forms.projections import FacetProjection, LocalProjection, slopes_of_interfaces
from ngvisco.forms.rates import Rates, TabulatedRates
from ngvisco.forms.spaces import Discretisation, Proxies
from ngvisco.forms.term import (
    Entry,
    GivenParts,
    Integrand,
    PointTerm,
    Term,
    point_terms,
    refused_by_name,
    tested,
)
from ngvisco.forms.terms.diffusion import diffusion_terms
from ngvisco.forms.terms.heat import heat_terms
from ngvisco.forms.terms.hyperviscosity import Hyperviscosity
from ngvisco.forms.terms.momentum import (
    CellVelocity,
    Continuity,
    Convection,
    Inertia,
    Loading,
    MeanFlux,
    MomentumBalance,
    Stokes,
    UnbalancedMomentum,
)
from ngvisco.forms.terms.regularisation import regularising_terms
from ngvisco.forms.terms.tangents import TangentGap, WithoutEnergy, tangents_of
from ngvisco.forms.terms.transport import (
    Conjugates,
    CreepRate,
    ElasticForce,
    JumpHeat,
    Kinematics,
    PlasticStraining,
    Trace,
    Upwinding,
)
from ngvisco.forms.unfelt import UNFELT, Unfelt
from ngvisco.forms.upwinding import Largest, mean_share
from ngvisco.physics.materials.thermal import entropy_in
from ngvisco.physics.model import Model


class LocalUnknowns:
    """The local unknowns of a step, recomputed in the order of their dependence."""

    def __init__(
        self,
        layout: StepLayout,
        state: GridFunction,
        quadrature: Quadrature,
        terms: Iterable[PointTerm],
        stresses: LinearisationStress | None = None,
    ) -> None:
        self.stresses, self.energy = stresses, layout.context.energy
        u = Fields.of(layout, state.components)
        parts = dict(zip(layout.names, state.components, strict=True))
        self.projections: dict[str, LocalProjection] = {}
        self.largest = Largest()
        """Facet means that only grow during the iterates of a step."""
        self._means: list[LocalProjection | FacetProjection] = []
        """Projections of means over cells and facets; only a step's equations read these means."""
        for term in terms:
            with refused_by_name(term):
                for name, load in term.projections(u):
                    projection = LocalProjection(parts[name], quadrature, load)
                    if layout.unknowns[name].is_mean:
                        self._means.append(projection)
                    else:
                        self.projections[name] = projection
            if term.facet_mean is not None and (value := term.facet_projection(u)) is not None:
                kept = [partial(self.largest, term.facet_mean)] if term.stays else []
                share = mean_share(u.context.inner)
                self._means.append(FacetProjection(parts[term.facet_mean], quadrature, share, value, *kept))
        self._of_energy: LocalProjection | None = None
        if self.energy.projected is not None:
            load = tested(self.energy.density(u))
            self._of_energy = LocalProjection(self.energy.projected, quadrature, load)

    def update(self) -> None:
        """Compute all local unknowns of the state from its v, a and z."""
        self.update_without_means()
        self.energy.refresh_sides()
        for mean in self._means:
            mean()

    def update_without_means(self) -> None:
        """Update the local unknowns without the means that only a step's equations read."""
        self.update_energy()
        for projection in self.projections.values():
            projection()
        if self.stresses:
            self.stresses.refresh()

    def update_stored(self) -> None:
        """Update the energy and the stresses that are stored at points to the present state."""
        self.update_energy()
        self.energy.refresh_sides()
        if self.stresses:
            self.stresses.refresh()

    def update_energy(self) -> None:
        """Update an energy that is stored at the quadrature points, and its projection, to the state."""
        if self.energy.refresh() and self._of_energy is not None:
            self._of_energy()


_NOT_EVOLVED = "reads the old value of {name}, whose declaration lacks evolves=True"
_NO_EQUATION = (
    "has a row of {name}, which is not an unknown; with bodies the density is not an unknown, but "
    "the sum of the bodies' densities"
)


def equations(model: Model, rates: TabulatedRates, m: int = 1) -> tuple[Term, ...]:
    """The terms of a model's equations without walls, for fields of order ``m``, from the model's
    ``rates``."""
    dim = rates.dim
    terms: list[Term] = [] if model.bodies else [Continuity(model.regularisation)]
    law = model.regularisation
    if m == 0 and law is not None and law.rho_max is not None:
        terms.append(MeanFlux())
    terms += [Inertia(), Convection(model.regularisation), ElasticForce()]
    if law is None or not law.bends_the_flux:
        terms += [CellVelocity(), UnbalancedMomentum(), MomentumBalance()]
    if model.viscosity is not None:
        terms.append(Stokes(model.viscosity))
    if model.hyperviscosity is not None:
        terms.append(Hyperviscosity(model.hyperviscosity))
    terms += [Loading(load, dim) for load in model.loads]
    terms += [Kinematics(model), Conjugates(model), Trace()]
    tangents = tangents_of(model.material, dim, m, rates.response)
    if tangents is not None:
        terms += [TangentGap(), WithoutEnergy(), tangents]
    if entropy_in(model.material) is not None:
        terms.append(JumpHeat())
    terms.append(Upwinding(tangents))
    if model.creep is not None and not model.creep.is_local:
        terms.append(CreepRate(model.creep))
    terms += [
        PlasticStraining(mechanism) for mechanism in model.mechanisms if mechanism.rule.hardening is not None
    ]
    return (*terms, *regularising_terms(model, dim))


@dataclass(frozen=True)
class Evolved:
    """Copies of a state's evolving unknowns: coefficients by the unknowns' names.

    ``momentum`` is rho v at the points of the forms' rule, (dim, points), kg/(m^2 s): its integral against a
    test w of the velocity is the momentum functional.
    """

    values: Mapping[str, np.ndarray]
    momentum: np.ndarray


class Step:
    """Spaces, fields and forms of the step (rho, m, z)_old -> (rho, v, z).

    Parameters
    ----------
    sources : Term, optional
        A further term that takes no unknown, for manufactured solutions.
    conditions : mapping of boundary names to Wall objects, optional
        Conditions on walls; by default slip.
    terms : sequence of Term, optional
        Further terms of the system.
    symmetry : str
        "none", or "axisymmetric" (``ngvisco.forms.mesh.symmetry``).
    """

    def __init__(
        self,
        mesh: Mesh,
        model: Model,
        discretisation: Discretisation | None = None,
        sources: Term | None = None,
        conditions: Conditions | None = None,
        terms: Sequence[Term] = (),
        symmetry: str = "none",
    ) -> None:
        check_mesh(mesh)
        if model.viscosity is not None:
            model.viscosity.require_dimension(mesh.dim)
        self.discretisation = discretisation or Discretisation()
        model = model.with_bodies_apart(self.discretisation.sharp)
        self.mesh, self.model = mesh, model
        self.walls = Walls(mesh, conditions)
        source_terms = () if sources is None else (sources,)
        self.impenetrability = Impenetrability(self.walls) if self.walls.multiplied else None
        """The term of the multipliers on oblique or curved walls, or None."""
        self.passages = passages_of(self.walls, model)
        """Terms of the walls that matter crosses."""
        of_mesh = Symmetry.of(mesh, symmetry)
        self.tabulated_rates = TabulatedRates(model, mesh.dim, of_mesh.is_axisymmetric)
        """The rates of the variables for arrays of values."""
        self.terms = (
            *equations(model, self.tabulated_rates, self.discretisation.m),
            *wall_terms(self.walls, model, self.impenetrability, self.passages),
            *heat_terms(model, self.walls),
            *diffusion_terms(model, self.walls),
            *terms,
            *source_terms,
        )
        self.point_terms, self.sources = point_terms(self.terms), sources
        self.layout = StepLayout(
            mesh,
            model.material,
            self.discretisation,
            self.point_terms,
            self.walls.dirichlet,
            periodic=bool(self.walls.periodic),
            symmetry=of_mesh,
        )
        require_symmetry(self.layout.symmetry, self.walls, model, self.point_terms)
        self.state = GridFunction(self.layout.space, name="state")
        self.state_old = GridFunction(self.layout.space, name="state_old")
        self.now = Fields.of(self.layout, self.state.components)
        old = dict(zip(self.layout.names, self.state_old.components, strict=True))
        evolving = {name: old[name] for name in self.layout.evolving}
        self.old = Fields(self.layout, GivenParts(evolving, _NOT_EVOLVED))
        self.moving_walls = MovingWalls(self.walls, self.layout, self.state)
        k, m, bonus = self.discretisation.k, self.discretisation.m, self.discretisation.quadrature_bonus
        response = model.material.response(mesh.dim)
        self.quadrature = Quadrature.for_orders(mesh, k, m, bonus, self.layout.symmetry)
        self.energy = StoredEnergy(model.material, mesh.dim)
        if response is not None:
            self.energy = PointwiseEnergy(model.material, response, self.quadrature, self.now, m)
        self.momentum_old, self._momentum = (self.quadrature.vectors(mesh.dim) for _ in range(2))
        degree = self.quadrature.volume_degree
        context = Context(mesh, model, self.old, self.energy, self.momentum_old, degree, self.passages)
        self.context = self.layout.context = context
        self.context.terms = self.terms
        self._recovered = slopes_of_interfaces(model, self.layout, self.context, self.quadrature)
        self.context.recovered_slopes |= {at: slope.target for at, slope in self._recovered.items()}
        self.lagged: GridFunction | None = None
        """z at the last ``freeze``; its lagged variables enter other variables' conjugates. None without."""
        if model.material.lagged:
            self.lagged = GridFunction(self.layout.blocks["z"], name="lagged")
            self.context.lagged = Fields(self.layout, {"z": self.lagged})
        self.ranges: dict[str, tuple[float, float]] = {}
        """Least and largest start values of the material's parameters, by name."""
        self.stresses = LinearisationStress(self.tabulated_rates, self.layout, self.quadrature, self.state)
        """Stresses at which flow rules are linearised."""
        kept, rates = KeptRates(self.tabulated_rates, self.stresses), self.tabulated_rates
        self._solved = self._fields(self.state.components, kept) if self.stresses else self.now
        """Fields of the present state with creep rates from the stored stresses."""
        self._linearised = LinearisedRates(rates, self.stresses, self.now)
        self.residual = self._residual()
        self.local_unknowns = LocalUnknowns(
            self.layout, self.state, self.quadrature, self.point_terms, self.stresses
        )
        self.damage = DamageGrowth(self) if model.breaks else None
        """The growth of damage after a step; None without damage."""

    def sizes_apart(self) -> dict[str, float]:
        """Sizes of the variables whose increments count by themselves (``Variable.own_scale``), by name.

        The size is ``own_scale`` times the change of the variable that has the energy of a strain of one at
        the mean of the present state, the root of the ratio of both second derivatives; 0 without energy.
        """
        states = self.layout.states
        apart = {v.name: v.own_scale for v in states.variables if v.own_scale is not None}
        if not any(apart.values()):
            return apart
        mean = np.asarray(self.quadrature.integrate_cells(CF((self.now.z, 1.0))))
        curvature = np.diagonal(self.tabulated_rates.response(mean[None, :-1] / mean[-1]).hessian[0])
        strains = np.delete(curvature, np.r_[*(states.slices[name] for name in apart)])
        with np.errstate(all="ignore"):
            sizes = np.nan_to_num(np.sqrt(strains.max() / curvature), posinf=0.0)
        return {name: scale * float(sizes[states.slices[name]].max()) for name, scale in apart.items()}

    @cached_property
    def whole_residual(self) -> BilinearForm:
        """A second form of the residual: the solver does not change the matrix of this form."""
        return self._residual()

    def residual_at(self, coefficients: np.ndarray, condense: bool = True) -> BilinearForm:
        """The residual over some cells: those that have one of ``coefficients``, a mask of coefficients of v.

        The rows of these coefficients are the rows of the whole residual. With ``condense=False`` the same
        holds for the rows of the linearisation's matrix.
        """
        velocity, cells = self.layout.blocks["v"], BitArray(self.layout.mesh.ne)
        for cell in range(self.layout.mesh.ne):
            cells[cell] = bool(coefficients[list(velocity.GetDofNrs(ElementId(VOL, cell)))].any())
        return self._residual(cells, condense)

    @cached_property
    def _residual_at_moving_walls(self) -> BilinearForm:
        return self.residual_at(np.logical_or.reduce([mask for _, mask in self.moving_walls.moving.values()]))

    def _residual(self, cells: BitArray | None = None, condense: bool = True) -> BilinearForm:
        """R(u; w) over all cells or ``cells`` as a nonlinear form with its element-local unknowns."""
        space = self.layout.by_variables()
        trial, test = (self.layout.functions(functions) for functions in space.TnT())
        u = self.linearised_fields(list(trial.whole.values()), trial)
        w = Tests(self.layout, GivenParts(test.whole, _NO_EQUATION), functions=test)
        form = BilinearForm(space, condense=condense)
        for term in self.terms:
            with refused_by_name(term):
                self.quadrature.add(form, term.form(u, w), cells)
        return form

    def tests(self) -> Tests:
        """The test functions of the equations."""
        test = self.layout.space.TestFunction()
        return Tests(self.layout, GivenParts(dict(zip(self.layout.names, test, strict=True)), _NO_EQUATION))

    def linearised_fields(self, parts: Sequence[Any], functions: Proxies | None = None) -> Fields:
        """Fields of trial functions, with creep rates linearised at the stored stresses."""
        return self._fields(parts, self._linearised if self.stresses else self.context.rates, functions)

    def fields_from(self, old: Fields, momentum: CoefficientFunction) -> Fields:
        """Fields of the present state in a step that starts from the fields ``old``, and from ``momentum``,
        kg/(m^2 s)."""
        u = self.linearised_fields(self.state.components)
        context = copy.copy(u.context)
        context.old, context.momentum_old = old, momentum
        return Fields(self.layout, u.parts, context)

    def _fields(self, parts: Sequence[Any], rates: Rates, functions: Proxies | None = None) -> Fields:
        """Fields with the creep rates ``rates``."""
        context = copy.copy(self.context)
        context.rates = rates
        return Fields(
            self.layout, dict(zip(self.layout.names, parts, strict=True)), context, functions=functions
        )

    def evolved(self) -> Evolved:
        """Copies of the present state's evolving unknowns."""
        self._momentum.Interpolate(self.now.rho * self.now.v)
        state, ranges = self.state.vec.FV().NumPy(), self.layout.ranges
        values = {name: state[ranges[name]].copy() for name in self.layout.evolving}
        return Evolved(values, self._momentum.vec.FV().NumPy().copy())

    @cached_property
    def _energy(self) -> CoefficientFunction:
        return self.energy.density(self.now).Compile()

    def without_energy(self) -> np.ndarray:
        """Numbers of this rank's cells with a point of the rule at which there is no stored energy.

        The array is always empty for an energy that has values at the quadrature points only. For such an
        energy ``StoredEnergy.failure`` tells why a point has no energy.
        """
        if self.energy.projected is not None:
            return np.zeros(0, dtype=int)
        return np.flatnonzero(~np.isfinite(self.quadrature.each_cell(self._energy)))

    def freeze(self) -> None:
        """Set the lagged variables that other variables' conjugates read to those of the present state."""
        if self.lagged is not None:
            self.lagged.vec.FV().NumPy()[:] = self.state.vec.FV().NumPy()[self.layout.ranges["z"]]

    def start_from(self, parts: Sequence[tuple[float, Evolved]]) -> None:
        """Start the step from a weighted sum of states, linear in (rho, m, z) and further evolving unknowns.

        The velocity of ``old`` becomes the weighted sum of the velocities; no term reads this velocity.
        """
        old, ranges = self.state_old.vec.FV().NumPy(), self.layout.ranges
        for name in self.layout.evolving:
            old[ranges[name]] = sum(weight * part.values[name] for weight, part in parts)
        self.momentum_old.vec.FV().NumPy()[:] = sum(weight * part.momentum for weight, part in parts)
        for slope in self._recovered.values():
            slope()

    def start_from_old(self) -> None:
        """Start the step from ``state_old``: m_old = rho_old v_old."""
        self.momentum_old.Interpolate(self.old.rho * self.old.v)
        for slope in self._recovered.values():
            slope()

    def entries(self, fields: Fields | None = None) -> list[Entry]:
        """All entries of the energy ledger at ``fields`` (default: the present state)."""
        u = self._solved if fields is None else fields
        entries: list[Entry] = []
        for term in self.terms:
            with refused_by_name(term):
                entries += term.entries(u)
        k, m = self.discretisation.k, self.discretisation.m
        if m < k - 1:
            entries.append(Entry(UNFELT, "monitor", Integrand(), Unfelt(u, self.quadrature, m)))
        # the reactions of moving walls have power, too
        return entries + [
            Entry(f"power_wall_{name}", "power", Integrand(), partial(self._reaction_power, name))
            for name in self.moving_walls.moving
        ]

    def _reaction_power(self, name: str) -> float:
        """Power of a moving wall, W: the residual's rows on the wall, tested by v."""
        residual = self.state.vec.CreateVector()
        self._residual_at_moving_walls.Apply(self.state.vec, residual)
        return self.moving_walls.reaction_power(residual, name)
