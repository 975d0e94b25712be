"""Every term of the system is taken by exactly one part of the split solver, or refused by its name."""

from dataclasses import dataclass

import numpy as np
import pytest
from ngsolve import cos, pi, sin, x, y

import ngvisco as nv
from ngvisco.forms.momentum import Stokes
from ngvisco.forms.term import Entry, Integrand
from ngvisco.geometries import box
from ngvisco.physics.tensors import inner, square
from ngvisco.solver.split import claims


@dataclass(frozen=True)
class Drag:
    """int c rho v . w: a resistance of the body's surroundings, which no solver of ours has heard of."""

    c: float  # 1/s

    def form(self, u, w):
        return [Integrand(self.c * u.rho * inner(u.v, w.v))]

    def entries(self, u):
        return [Entry("dissipation_drag", "dissipation", Integrand(self.c * u.rho * square(u.v)))]


@dataclass(frozen=True)
class Growth:
    """-int s rho q: a source of mass, a row that the split solver does not take from a form."""

    s: float  # 1/s

    def form(self, u, w):
        return [Integrand(-self.s * u.rho * w.rho)]

    def entries(self, u):
        return []


class OtherStokes(Stokes):
    """A class of its own: not the viscosity that the split solver knows."""


def simulation(terms=(), maxh=0.25, scheme="backward-euler", **options):
    model = nv.Model(
        material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1),
        hyperviscosity=nv.HyperViscosity(mu=1e-5, p=4),
        loads=[nv.Gravity((0.0, -1.0))],
    )
    velocity = (sin(pi * x) * cos(pi * y), -cos(pi * x) * sin(pi * y))
    initial = nv.Initial(density=1 + 0.2 * x, velocity=velocity)
    mesh = box((1, 1), maxh=maxh)
    return nv.Simulation(mesh, model, dt=0.02, initial=initial, terms=terms, scheme=scheme, **options)


@pytest.mark.parametrize("scheme", ["backward-euler", "midpoint"])
def test_a_term_of_the_users_acts_in_both_solvers(scheme):
    states, ledgers = [], []
    for solver in ("split", "coupled"):
        run = simulation([Drag(8.0)], scheme=scheme, solver=solver)
        ledgers.append(run.run(0.06))
        state, ranges = run.rothe_step.state.vec.FV().NumPy(), run.rothe_step.layout.ranges
        states.append({name: state[ranges[name]].copy() for name in ("v", "rho", "z")})
    for name, values in states[0].items():
        assert np.abs(values - states[1][name]).max() <= 1e-9 * np.abs(values).max()
    free = simulation(scheme=scheme, solver="split").run(0.06)
    for ledger in ledgers:
        assert np.abs(ledger.column("closure_relative")).max() <= 1e-12
        assert ledger.column("dissipation_drag").max() > 0.1
        assert ledger.column("kinetic")[-1] < 0.8 * free.column("kinetic")[-1]
    assert simulation([Drag(1.0)]).solver.newton.jacobian is not None


def test_auto_takes_the_split_solver_with_a_term_that_it_can_take():
    assert type(simulation([Drag(1.0)], maxh=0.15).solver.newton).__name__ == "Split"
    assert type(simulation([Growth(1.0)], maxh=0.15).solver.newton).__name__ == "Newton"


@pytest.mark.parametrize("term", [Growth(0.1)], ids=lambda term: type(term).__name__)
def test_a_term_that_only_forms_can_express_is_refused_by_its_name(term):
    with pytest.raises(nv.ParameterError, match=rf"'coupled': {type(term).__name__}: it has a row of rho"):
        simulation([term], solver="split")
    ledger = simulation([term], maxh=0.5, solver="coupled").run(0.04)
    mass = ledger.column("mass")  # grows as (1 - s tau)^-1 a step
    assert mass[-1] / mass[0] == pytest.approx((1 - 0.1 * 0.02) ** -2, rel=1e-12)


def test_every_term_of_a_step_is_claimed_exactly_once():
    """Of all terms that the package's models make."""
    own = [
        *(*claims.DENSITY, *claims.FIELDS, *claims.AT_POINTS, *claims.HYPERVISCOSITY),
        *(*claims.BY_FORMS, *claims.WITHOUT_ROWS),
    ]
    assert len(set(own)) == len(own)
    model = nv.Model(
        material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1),
        viscosity=nv.StokesViscosity(K_v=0.1, G_v=0.1),
        hyperviscosity=nv.HyperViscosity(mu=1e-5),
        creep=nv.Creep(G_m=1.0, nu=1e-3),
        loads=[nv.Gravity((0, -1))],
        regularisation=nv.Regularisation(delta_density=1e-3, delta_fields=1e-2, epsilon=0.1, rho_max=2.0),
    )
    walls = {"top": nv.Traction(f=(1.0, 0.0), friction=0.1)}
    run = nv.Simulation(box((1, 1), maxh=0.5), model, dt=0.1, walls=walls)
    assert {type(term) for term in run.rothe_step.terms} <= set(own)
    assert claims.term_obstacle(run.rothe_step) is None


def test_a_derived_class_is_another_term():
    """It is evaluated by its own form, not taken for its parent."""
    run = simulation([OtherStokes(nv.StokesViscosity(K_v=0.1, G_v=0.1))])
    assert [type(term) for term in claims.flow_terms(run.rothe_step)] == [OtherStokes]


@pytest.mark.parametrize("wrong", [Drag, 3, [3], [Drag]])
def test_what_is_no_term_is_refused(wrong):
    with pytest.raises(nv.ParameterError, match=r"Simulation\.terms"):
        simulation(wrong)
