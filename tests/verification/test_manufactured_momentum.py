"""The momentum equation with density given, and the stationary hyperviscous problem alone."""

import pytest

from ngvisco import Discretisation, Model, StokesViscosity, time
from ngvisco.forms.term import Integrand
from ngvisco.forms.terms.hyperviscosity import Hyperviscosity
from ngvisco.forms.terms.momentum import Convection, Inertia, Stokes
from ngvisco.physics.tensors import inner
from tests.verification.manufactured import Exact
from tests.verification.models import hyperviscosity, material
from tests.verification.problems import Problem, Source, distance, refinements
from tests.verification.rates import RateTable
from tests.verification.sources import Sources

TAU = 0.25
VISCOSITY = StokesViscosity(K_v=0.3, G_v=0.2)


@pytest.mark.parametrize("k", [2, 3])
def test_velocity_rate_is_k_plus_1_without_hyperviscosity(k: int) -> None:
    """Measured on the finest pair: 2.9 and 3.8 (L2), 2.0 and 2.8 (H1)."""
    model = Model(material=material("linear"), viscosity=VISCOSITY)
    sources = Sources(model, 2, TAU)
    force = sources.inertia() + sources.viscous() - 0.5 * sources.continuity * sources.new.v
    table = RateTable(f"inertia, convection and Stokes viscosity, k = {k}")
    for h, mesh in refinements(2, 0.4, 3):
        problem = Problem(
            mesh,
            model,
            Discretisation(k=k),
            ("v",),
            [Inertia(), Convection(), Stokes(VISCOSITY), Source(lambda w: [Integrand(-inner(force, w.v))])],
            TAU,
        )
        exact = Exact(model, 2, time)
        time.Set(0.0)
        problem.set("v", exact.v)
        for n in range(2):
            problem.advance(n * TAU)
        table.add(h, **velocity_errors(problem, exact))
    table.require(L2=k + 0.7, H1=k - 0.25)


def velocity_errors(problem: Problem, exact: Exact) -> dict[str, float]:
    mesh, now = problem.mesh, problem.now
    return {"L2": distance(now.v, exact.v, mesh), "H1": distance(now.grad_v, exact.grad_v, mesh)}


BLOCKS = ("v", "a_1", "a_2", "a_3", "hess", "hyperstress", "hess_square", "hyper_coefficient")
RATES = {  # (k, p): asserted L2 and H1 rates
    (2, 2.0): (1.75, 1.75),
    (2, 4.0): (1.75, 1.75),
    (3, 2.0): (3.5, 2.75),
    (3, 4.0): (3.25, 2.5),
}


def hyperviscous_rates(k: int, p: float, levels: int) -> RateTable:
    model = Model(material=material("linear"), viscosity=VISCOSITY, hyperviscosity=hyperviscosity(p))
    force = Sources(model, 2, TAU).viscous()
    table = RateTable(f"Stokes and hyperviscosity, stationary, p = {p}, k = {k}")
    for h, mesh in refinements(2, 0.4, levels):
        problem = Problem(
            mesh,
            model,
            Discretisation(k=k),
            BLOCKS,
            [
                Stokes(VISCOSITY),
                Hyperviscosity(model.hyperviscosity),
                Source(lambda w: [Integrand(-inner(force, w.v))]),
            ],
            TAU,
        )
        problem.context.curvature.Set(0.05)
        problem.advance(0.0)  # from v = 0
        table.add(h, **velocity_errors(problem, Exact(model, 2, time)))
    return table


@pytest.mark.parametrize(
    ("k", "p"),
    [
        (2, 2.0),
        (3, 2.0),
        pytest.param(2, 4.0, marks=[pytest.mark.long, pytest.mark.ci]),
        pytest.param(3, 4.0, marks=pytest.mark.long),  # two minutes
    ],
)
def test_hyperviscous_rates_are_those_of_the_lifted_penalty(k: int, p: float) -> None:
    """FORMULATION.md, Section 5: order 2 for k = 2, and 3.6 or more (L2), 2.7 or more (H1) for k = 3."""
    L2, H1 = RATES[k, p]
    hyperviscous_rates(k, p, 3).require(L2=L2, H1=H1)
