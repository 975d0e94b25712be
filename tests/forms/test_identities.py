"""Identities of the discrete forms on random states, with the paper's labels."""

import numpy as np
import pytest
from ngsolve import CF, Id, OuterProduct, x, y
from support import Case, block, parts_of, randomise, residual, step_of, uncondensed

from ngvisco import StokesViscosity
from ngvisco.forms.fields import Fields
from ngvisco.forms.projections import set_traces
from ngvisco.forms.start.initial import complete
from ngvisco.forms.system import Step
from ngvisco.forms.term import Integrand, Term
from ngvisco.forms.terms.transport import transport_in_cells, transport_through_facets
from ngvisco.physics.material import cauchy_stress
from ngvisco.physics.tensors import embed_gradient, inner, square

CASES = [
    Case(),
    Case(k=3, m=2, p=None),
    Case(m=0, p=None),
    Case(material="linear", p=None),
    Case(material="hardening", m=2, p=None, creep=False),
    Case(dim=3, p=None),
    Case(dim=3, material="linear", m=0, p=None),
]
by_case = pytest.mark.parametrize("case", CASES, ids=str)


def term_of(step: Step, name: str) -> Term:
    (term,) = (term for term in step.terms if type(term).__name__ == name)
    return term


def rows(step: Step, name: str) -> np.ndarray:
    """R(u; .) of one term at the step's state, by test coefficient."""
    trial, test = step.layout.space.TnT()
    parts = term_of(step, name).form(Fields.of(step.layout, trial), Fields.of(step.layout, test))
    return residual(uncondensed(step, parts), step.state.vec)


def powers(step: Step, parts: list[Integrand]) -> np.ndarray:
    return residual(uncondensed(step, parts), step.state.vec)


def coefficients(step: Step, name: str) -> np.ndarray:
    return block(step, step.state.vec.FV().NumPy(), name)


def unit_test(step: Step) -> np.ndarray:
    """Coefficients of q = 1, other tests 0."""
    parts = parts_of(step)
    kept = step.state.vec.FV().NumPy().copy()
    step.state.vec[:] = 0.0
    parts["rho"].Set(1.0)
    one = step.state.vec.FV().NumPy().copy()
    step.state.vec.FV().NumPy()[:] = kept
    return one


@by_case
def test_continuity_conserves_mass_for_any_state(case: Case) -> None:
    """For q = 1 only the storage remains, for any v and rho; rho_hat is the mean of both sides."""
    step = step_of(case)
    randomise(step, 1)
    set_traces(step.layout, step.state, step.context, step.quadrature)
    rate = rows(step, "Continuity") @ unit_test(step)
    old, now = (step.quadrature.integrate_cells(f.rho) for f in (step.old, step.now))
    tau = step.context.tau.Get()
    assert rate == pytest.approx((now - old) / tau, abs=1e-13)
    assert abs(now - old) > 1e-4  # the storage term by itself is not zero


@by_case
def test_convection_has_no_power(case: Case) -> None:
    step = step_of(case)
    randomise(step, 2)
    force = block(step, rows(step, "Convection"), "v")
    assert np.abs(force).max() > 1e-4
    assert force @ coefficients(step, "v") == pytest.approx(0, abs=1e-14)


@by_case
def test_the_power_of_inertia_is_the_change_of_kinetic_energy_plus_a_remainder(case: Case) -> None:
    """If m_old = rho_old v_old, tau <R, v> = kinetic - kinetic_old + 1/2 int rho_old |v - v_old|^2."""
    step = step_of(case)
    randomise(step, 3)
    power = block(step, rows(step, "Inertia"), "v") @ coefficients(step, "v")
    u, old = step.now, step.old
    energy = 0.5 * (u.rho * square(u.v) - old.rho * square(old.v) + old.rho * square(u.v - old.v))
    assert step.context.tau.Get() * power == pytest.approx(step.quadrature.integrate_cells(energy), rel=1e-12)


@by_case
def test_elastic_force_is_the_adjoint_of_the_transport(case: Case) -> None:
    """B_h(v; z, zeta) in the momentum equation cancels B_h in the kinematic equation, also on facets."""
    step = step_of(case)
    randomise(step, 4)
    power = block(step, rows(step, "ElasticForce"), "v") @ coefficients(step, "v")
    trial, test = step.layout.space.TnT()
    u, w = Fields.of(step.layout, trial), Fields.of(step.layout, test)
    transport = [Integrand(part) for part in transport_in_cells(u, u, w, "z")]
    transport.append(Integrand(facets=transport_through_facets(u, u, w, "z")))
    rate = block(step, powers(step, transport), "z") @ coefficients(step, "zeta")
    assert abs(power) > 1e-3
    assert rate == pytest.approx(power, rel=1e-12)


@by_case
def test_the_power_of_creep_is_a_square(case: Case) -> None:
    """With the projected conjugates, - int rate(z; 0, Pi) : zeta = int R |M|^2."""
    step = step_of(case)
    randomise(step, 5)
    trial, test = step.layout.space.TnT()
    u, w = Fields.of(step.layout, trial), Fields.of(step.layout, test)
    rates = step.context.rates
    if not case.creep:
        assert rates.creep(u) == []
        return
    creep = [Integrand(part) for part in rates.creep_power(u, rates.creep(u), w, "z")]
    released = -block(step, powers(step, creep), "z") @ coefficients(step, "zeta")
    R = step.model.creep.R
    assert released > 1e-3
    assert released == pytest.approx(
        step.quadrature.integrate_cells(R * square(rates.mandel(step.now))), rel=1e-12
    )


@by_case
def test_creep_does_not_change_the_jacobian(case: Case) -> None:
    step = step_of(case)
    if not case.creep or "J" not in step.now.z_tensors:
        return
    randomise(step, 5)
    trial, test = step.layout.space.TnT()
    u, w = Fields.of(step.layout, trial), Fields.of(step.layout, test)
    rates = step.context.rates
    power = [Integrand(part) for part in rates.creep_power(u, rates.creep(u), w, "z")]
    creep = block(step, powers(step, power), "z")
    assert [v.name for v in step.model.material.variables] == ["F", "J"]
    per_component = creep.reshape(-1, creep.size // step.now.z.dim)
    assert np.abs(per_component[:-1]).max() > 1e-3  # F creeps
    assert np.abs(per_component[-1]).max() == 0  # J, the last component, does not creep


def elastic_rows(case: Case, values: dict) -> tuple[Step, np.ndarray]:
    """The elastic force at smooth variables with exact traces and conjugates, and a random velocity."""
    step = step_of(case)
    randomise(step, 6)
    parts = parts_of(step)
    velocity = parts["v"].vec.FV().NumPy().copy()
    z_values = step.model.material.states(case.dim).components(values)
    parts["z"].Set(z_values)
    complete(step)
    parts["v"].vec.FV().NumPy()[:] = velocity
    return step, rows(step, "ElasticForce")


def check_against_stress(case: Case, values: dict) -> None:
    """Rows equal int T : grad w for every w with w.n = 0 on the walls, whatever the velocity is."""
    step, force = elastic_rows(case, values)
    T = cauchy_stress(step.model.material, step.now.z_tensors)
    fields = Fields.of(step.layout, step.layout.space.TestFunction())
    expected = powers(step, [Integrand(inner(T, fields.L))])
    free = np.array(list(step.layout.blocks["v"].FreeDofs()), dtype=bool)
    force, expected = block(step, force, "v"), block(step, expected, "v")
    assert np.abs(expected[free]).max() > 1e-2
    assert force[free] == pytest.approx(expected[free], abs=1e-12)
    # on walls the pressure part of T pushes the wall; B_h has no such term
    assert np.abs((force - expected)[~free]).max() > 1e-3


@pytest.mark.parametrize("dim", [2, 3])
def test_elastic_force_of_a_linear_strain_equals_that_of_the_stress(dim: int) -> None:
    """E is continuous and in P_1: T = S + phi I varies in space, and B_h is exact for E."""
    E = CF((0.2 * x, 0.1 * y, 0, 0.1 * y, -0.1 * x, 0, 0, 0, 0.3 * y), dims=(3, 3))
    check_against_stress(Case(dim=dim, material="linear", p=None), {"E": E + 0.1 * Id(3)})


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("m", [0, 1])
def test_elastic_force_of_a_uniform_distortion_equals_that_of_the_stress(dim: int, m: int) -> None:
    F = Id(3) + 0.3 * OuterProduct(CF((1, 0.5, 0)), CF((0.2, 1, 0)))
    case = Case(dim=dim, m=m, p=None)
    check_against_stress(case, {"F": F, "J": CF(1.4)})


def test_the_stokes_force_contains_both_viscosities() -> None:
    """The force is int (K_v tr eps I + 2 G_v dev eps) : eps(w), also in 2D with the deviator of the 3x3
    tensor."""
    for dim in (2, 3):
        step = step_of(Case(dim=dim, p=None))
        randomise(step, 7)
        law = step.model.viscosity
        assert isinstance(law, StokesViscosity)
        power = block(step, rows(step, "Stokes"), "v") @ coefficients(step, "v")
        G = embed_gradient(step.now.grad_v, dim)
        eps = 0.5 * (G + G.trans)
        trace = sum(eps[i, i] for i in range(3))
        squares = sum(eps[i, j] * eps[i, j] for i in range(3) for j in range(3))
        by_hand = law.K_v * trace * trace + 2 * law.G_v * (squares - trace * trace / 3)
        assert power == pytest.approx(step.quadrature.integrate_cells(by_hand), rel=1e-12)
