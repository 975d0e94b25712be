"""Models of the manufactured solutions, with chosen mechanisms, and the errors of their runs."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from ngsolve import BilinearForm, CoefficientFunction, GridFunction, Mesh, x

import ngvisco as nv
from ngvisco.forms.boundary.walls import Walls
from ngvisco.forms.context import Context, StepLayout, time
from ngvisco.forms.fields import Fields
from ngvisco.forms.mesh.quadrature import Quadrature
from ngvisco.forms.rates import TabulatedRates
from ngvisco.forms.start.initial import complete
from ngvisco.forms.system import LocalUnknowns, equations
from ngvisco.forms.term import Entry, Integrand, Term, point_terms
from ngvisco.forms.terms.momentum import Continuity
from ngvisco.forms.terms.transport import Kinematics, Trace, Upwinding
from ngvisco.physics.tensors import inner, sqrt, square
from ngvisco.physics.variables import SmallStrain
from ngvisco.solver.newton import Newton
from ngvisco.solver.problem import Attempt, BlockNorm
from ngvisco.solver.problem import Problem as Posed
from tests.verification.case import RateTable
from tests.verification.differences import Coefficients
from tests.verification.manufactured import Exact, Sources
from tests.verification.setups import balls, distance, refinements, square_mesh

KINDS = ("linear", "neo-hookean")
FURTHER = ("by B", "cofactors", "Yosida", "Yosida, quartic", "with heat", "two bodies")
"""Materials with other variables, by kind. Their variables are B = F F^T, also with another law of creep; F,
Cof F and J; the variables of Yosida approximations, of the neo-Hookean energy and of an energy that grows
faster than E squared; A and the entropy; the amounts of two bodies that share every point."""
HEAT_CAPACITY, THETA_R, GRUNEISEN, CONDUCTIVITY = 1.5, 1.2, 0.8, 0.25
"""Constants of the material with heat; the conductivity is CONDUCTIVITY times theta^1.5."""
DELTA, DELTA_FIELDS, EPSILON, WEIGHT = 0.02, 0.03, 1.0, -0.7
"""Constants of the regularisation, and the second component of gravity."""
RULES: dict[str, tuple[Callable[..., nv.FlowRule], dict[str, float]]] = {
    "linear": (partial(nv.Creep, G_m=2.0, q=4.0), {"R": 0.5}),
    "Norton": (partial(nv.Norton, A=0.3, n=3.0, q=4.0), {"A": 0.3, "n": 3.0}),
    "Eyring": (partial(nv.Eyring, A=0.1, sigma_0=0.5, q=4.0), {"A": 0.1, "sigma": 0.5}),
    "Perzyna": (
        partial(nv.Perzyna, sigma_Y=0.5, G_m=2.0, n=2.0, q=4.0),
        {"R": 0.5, "n": 2.0, "sigma": math.sqrt(2 / 3) * 0.5},
    ),
}
"""Flow rules that lack nu, and their constants for the formulas in numpy."""
HYPER = {None: 0.0, 2.0: 1e-2, 4.0: 1e-3}
"""The hyperviscosity mu for each p; its effect on the exact fields is about that of the Stokes viscosity."""


def material(kind: str) -> nv.Material:
    """The material of a kind: of the linearised model, of the finite-strain model, or one of ``FURTHER``."""
    neo_hookean = partial(nv.NeoHookean, K_e=2.0, G_e=1.0, epsilon=0.5)
    by_F = neo_hookean(elastic_state="F")
    made: dict[str, Callable[[], nv.Material]] = {
        "linear": lambda: nv.LinearElastic(K_e=2.0, G_e=1.0),
        "neo-hookean": lambda: by_F,
        "cofactors": lambda: nv.MooneyRivlin(K_e=2.0, G_e=0.6, G_mr=0.4, epsilon=0.5, elastic_state="F"),
        "by B": lambda: neo_hookean(elastic_state="B"),
        "Yosida": lambda: nv.Yosida(material=by_F, eps=0.05),
        "Yosida, quartic": lambda: nv.Yosida(
            material=nv.CustomMaterial(transported=(SmallStrain(),), stored_energy=_quartic), eps=0.05
        ),
        "with heat": lambda: nv.Thermal(material=by_F, c=HEAT_CAPACITY, theta_R=THETA_R, gruneisen=GRUNEISEN),
    }
    return made[kind]()


def _quartic(E: CoefficientFunction) -> CoefficientFunction:
    """The energy E : E + (E : E)^2, Pa."""
    return square(E) + square(E) * square(E)


def hyperviscosity(p: float | None) -> nv.HyperViscosity | None:
    return None if p is None else nv.HyperViscosity(mu=HYPER[p], p=p)


def bodies() -> tuple[nv.Body, ...]:
    """Two bodies that differ in shear modulus, viscosity, creep and density."""
    return (
        nv.Body(
            name="one",
            where=0.5 - x,
            material=nv.ReferentialNeoHookean(K_e=2.0, G_e=1.0),
            viscosity=nv.StokesViscosity(K_v=0.3, G_v=0.2),
            creep=nv.Creep(G_m=2.0),
            density=1.5,
        ),
        nv.Body(
            name="two",
            material=nv.ReferentialNeoHookean(K_e=2.0, G_e=0.4),
            viscosity=nv.StokesViscosity(K_v=0.2, G_v=0.2),
            creep=nv.Creep(G_m=1.0),
            density=1.0,
        ),
    )


def model(
    kind: str,
    dim: int,
    p: float | None,
    regularised: bool = False,
    delta: bool = True,
    nu: float = 0.0,
    rule: str = "linear",
) -> nv.Model:
    """Model with creep, gravity and viscosity, with p hyperviscosity, and delta- and epsilon-terms by choice.

    With nu > 0, creep by one of ``RULES`` has the gradient term (q = 4), and the creep rate is an unknown
    field. The material with heat has conduction.
    """
    law = nv.Regularisation(
        delta_density=DELTA if delta else 0.0, delta_fields=DELTA_FIELDS if delta else 0.0, epsilon=EPSILON
    )
    own: dict[str, Any] = {"bodies": bodies()}
    if kind != "two bodies":
        viscosity, creep = nv.StokesViscosity(K_v=0.3, G_v=0.2), RULES[rule][0](nu=nu)
        if rule == "Perzyna" and nu > 0:
            creep = replace(creep, rate_floor=1e-4)  # type: ignore[type-var]
        own = {"material": material(kind), "viscosity": viscosity, "creep": creep}
    return nv.Model(
        **own,
        hyperviscosity=hyperviscosity(p),
        loads=(nv.Gravity((0.0, WEIGHT, 0.0)[:dim]),),
        regularisation=law if regularised else None,
        heat=nv.Heat(conductivity=_conductivity) if kind == "with heat" else None,
    )


def _conductivity(theta: CoefficientFunction) -> CoefficientFunction:
    return CONDUCTIVITY * theta * sqrt(theta)


def coefficients(
    kind: str, p: float | None, regularised: bool = False, nu: float = 0.0, rule: str = "linear"
) -> Coefficients:
    """Constants of ``model`` for the formulas in numpy."""
    of_law = {"delta": DELTA, "delta_fields": DELTA_FIELDS, "damping": EPSILON} if regularised else {}
    elastic = {"K_e": 2.0, "G_e": 1.0, "epsilon": 0.0 if kind == "linear" else 0.5}
    flow: dict[str, Any] = {"K_v": 0.3, "G_v": 0.2, "mu": HYPER[p], "p": p or 2.0, "g": WEIGHT}
    warm = {"c": HEAT_CAPACITY, "theta_R": THETA_R, "Gamma": GRUNEISEN, "kappa": CONDUCTIVITY}
    return Coefficients(**elastic, **flow, **of_law, **warm, rule=rule, nu=nu, **RULES[rule][1])


# --- errors ----------------------------------------------------------------------------------------------

SHORT = 1e-6
"""Step of the sources' time differences, s, when orders in time are measured: the sources' error is of this
order."""


def coupled_rates(
    kind: str,
    dim: int,
    p: float | None,
    k: int,
    m: int,
    maxh: float,
    levels: int,
    *,
    regularised: bool = False,
    delta: bool = True,
    nu: float = 0.0,
    rule: str = "linear",
    curved: bool = False,
    sources: Callable[..., Sources] = Sources,
) -> RateTable:
    """Errors in space, in L2 after two steps of 0.05 s, of the whole system of ``model``, in the unit ball if
    ``curved``.  Negative controls give ``sources`` other than the sources of the exact fields."""
    system = model(kind, dim, p, regularised, delta, nu, rule)
    terms = (", all terms" if delta else ", all terms but delta") if regularised else ""
    table = RateTable(f"coupled, {kind}, {dim}D, p = {p}, k = {k}, m = {m}{terms}")
    for h, mesh in (balls if curved else refinements)(dim, maxh, levels):
        time.Set(0.0)
        exact, start = Exact(system, dim, time, curved), Exact(system, dim, 0.0, curved)
        given: dict[str, Any] = {"density": start.rho, "values": start.values}
        simulation = nv.Simulation(
            mesh,
            system,
            dt=0.05,
            initial=nv.Initial(velocity=start.v, **({} if system.bodies else given)),
            discretisation=nv.Discretisation(k=k, m=m),
            sources=sources(system, dim, 0.05, curved),
        )
        if system.bodies:
            _mix(simulation, start)
        for _ in range(2):
            simulation.advance()
        table.add(h, **errors(simulation, exact))
    return table


def _mix(simulation: nv.Simulation, start: Exact) -> None:
    """Set a run's bodies to their exact fields; by default each body starts in its own place."""
    step = simulation.rothe_step
    parts = dict(zip(step.layout.names, step.state.components, strict=True))
    parts["z"].Set(start.z)
    complete(step)
    step.state_old.vec.data = step.state.vec
    step.start_from_old()


def errors(simulation: nv.Simulation, exact: Exact) -> dict[str, float]:
    """L2 errors of v, rho and z, and of Pi if it is an unknown field."""
    u = simulation.rothe_step.now
    names = ("v", "rho", "z", *(("Pi",) if "Pi" in u.parts else ()))
    return {name: distance(getattr(u, name), getattr(exact, name), simulation.mesh) for name in names}


def free_solution(
    kind: str,
    steps: int,
    duration: float,
    *,
    p: float | None = None,
    driven: bool = False,
    delta: bool = True,
    **options: Any,
) -> nv.Simulation:
    """A run from the manufactured initial state, with creep, gravity and viscosity.

    A ``driven`` run has all terms (the delta-terms only with ``delta``) and the manufactured sources, whose
    time differences are far shorter than any step; ``p`` is the hyperviscosity's exponent, None for no
    hyperviscosity; ``options`` are the simulation's.
    """
    system = model(kind, 2, p, regularised=driven, delta=delta)
    time.Set(0.0)
    exact = Exact(system, 2, 0.0)
    initial = nv.Initial(density=exact.rho, velocity=exact.v, values=exact.values)
    sources = Sources(system, 2, SHORT) if driven else None
    mesh, options = square_mesh(0.6), {"initial": initial, "sources": sources, **options}
    simulation = nv.Simulation(mesh, system, dt=duration / steps, **options)
    simulation.run(duration)
    return simulation


# --- transport alone --------------------------------------------------------------------------------------


class PartialLayout(StepLayout):
    """Layout with some of a step's blocks; the other fields are given functions."""

    def __init__(
        self, mesh: Mesh, model: nv.Model, discretisation: nv.Discretisation, names: Sequence[str]
    ) -> None:
        terms = point_terms(equations(model, TabulatedRates(model, mesh.dim), discretisation.m))
        super().__init__(mesh, model.material, discretisation, terms, Walls(mesh).dirichlet)
        self._make([name for name in self.names if name in names])

    def with_given(self, parts: Sequence[Any], exact: Exact) -> Fields:
        """Fields of this layout's blocks, completed by exact fields."""
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
    """Rothe steps with some of the equations."""

    def __init__(
        self,
        mesh: Mesh,
        model: nv.Model,
        discretisation: nv.Discretisation,
        names: Sequence[str],
        terms: Sequence[Term],
        tau: float,
    ) -> None:
        """``terms`` are the equations' terms; fields that ``names`` lacks are the exact ones."""
        self.mesh, self.tau = mesh, tau
        self.layout = layout = PartialLayout(mesh, model, discretisation, names)
        self.state, self.state_old = GridFunction(layout.space), GridFunction(layout.space)
        new, old = Exact(model, mesh.dim, time), Exact(model, mesh.dim, time - tau)
        self.now = layout.with_given(self.state.components, new)
        before = layout.with_given(self.state_old.components, old)
        self.context = layout.context = Context(mesh, model, before)
        self.context.tau.Set(tau)
        self.quadrature = Quadrature.for_orders(mesh, discretisation.k, discretisation.m)
        self.terms = tuple(terms)
        trial, test = layout.space.TnT()
        u, w = layout.with_given(trial, new), Fields.of(layout, test)
        form = BilinearForm(layout.space, condense=True)
        for term in self.terms:
            self.quadrature.add(form, term.form(u, w))
        local = LocalUnknowns(layout, self.state, self.quadrature, point_terms(self.terms))
        norm = BlockNorm(layout.ranges, dict.fromkeys(set(layout.names) & {"v", "rho", "z"}, 1.0))
        self.newton = Newton(form, self.state.vec, norm, local.update, nv.NewtonOptions())

    def set(self, name: str, value: CoefficientFunction) -> None:
        """Set the start value of a block."""
        self.state.components[self.layout.names.index(name)].Set(value)

    def advance(self, t_old: float) -> None:
        """Make a step from t_old; terms without a time derivative pose a stationary problem."""
        self.state_old.vec.data = self.state.vec
        solution = self.newton.solve(_StepFrom(self.context, t_old, self.tau), self.state_old.vec)
        if not solution.converged:
            raise nv.StepError(solution.reason, [Attempt("coupled", solution)])


@dataclass(frozen=True)
class _StepFrom(Posed):
    """The step from ``begin`` over ``tau``, s."""

    context: Context
    begin: float
    tau: float

    def pose(self) -> None:
        self.context.set_step(self.tau, self.begin + self.tau, self.begin, self.tau)


def transport_rates(kind: str, m: int, maxh: float, levels: int) -> RateTable:
    """Errors of density and E, or F and J, in 2D with the exact velocity given, after two steps of 0.25 s."""
    system, tau = nv.Model(material=material(kind)), 0.25
    sources, table = Sources(system, 2, tau), RateTable(f"transport alone, {kind}, m = {m}")
    load = Source(
        lambda w: [nv.Integrand(-sources.continuity * w.rho), nv.Integrand(-inner(sources.kinematics, w.z))]
    )
    terms: list[Any] = [Continuity(), Kinematics(system), Trace(), Upwinding(), load]
    names, exact = ("rho", "rho_hat", "z", "z_hat"), Exact(system, 2, time)
    for h, mesh in refinements(2, maxh, levels):
        problem = Problem(mesh, system, nv.Discretisation(m=m), names, terms, tau)
        time.Set(0.0)
        problem.set("rho", exact.rho)
        problem.set("z", exact.z)
        for n in range(2):
            problem.advance(n * tau)
        table.add(h, rho=distance(problem.now.rho, exact.rho, mesh), z=distance(problem.now.z, exact.z, mesh))
    return table
