"""Exactly one part of the split solver takes each term of the system, or the solver refuses the term by
name."""

from dataclasses import dataclass

import numpy as np
import pytest
from ngsolve import CF, Norm, x, y
from support import SWIRL, assert_same, by_ci, swirling

import ngvisco as nv
from ngvisco.errors import ParameterError
from ngvisco.forms.term import Entry, Integrand, PointTerm
from ngvisco.forms.terms.transport import Conjugates
from ngvisco.geometries import box
from ngvisco.physics.tensors import exp, inner, sqrt, square, tr
from ngvisco.physics.variables import Distortion, Variable
from ngvisco.reduced.declared import Couplings, term_obstacle
from tests.parallel.own import Drag


@dataclass(frozen=True)
class DragByForms:
    """A drag that has a form of its own, with an operation that arrays do not have."""

    c: float

    def form(self, u, w):
        return [Integrand(self.c * u.rho * (Norm(u.v) * Norm(u.v)) ** 0 * inner(u.v, w.v))]

    def entries(self, u):
        power = Integrand(self.c * u.rho * square(u.v))
        return [Entry("dissipation_drag_by_forms", "dissipation", power)]


def speed(u):
    """|v . n|, smoothed."""
    through = u.v * u.context.normal
    return sqrt(through * through + 1e-6)


@dataclass(frozen=True)
class Leak(PointTerm):
    """int c |v . n| (rho q + 1/2 rho v . w) on all sides of cells: rows on facets."""

    c: float

    def facets(self, u, w):
        out = self.c * speed(u) * u.rho
        return [out * w.rho, 0.5 * out * inner(u.v, w.v)]

    def entries(self, u):
        loss = 0.5 * self.c * speed(u) * u.rho * square(u.v)
        return [Entry("dissipation_leak", "dissipation", Integrand(facets=loss))]


@dataclass(frozen=True)
class Healing(PointTerm):
    """The row int s (J - 1)(2 + J) H, by which J returns to 1 in a hundredth of a step."""

    s: float  # 1/s

    def cells(self, u, w):
        J = u.z_tensors["J"]
        return [self.s * (J - 1) * (2 + J) * w.z_tensors["J"]]

    def entries(self, u):
        J = u.z_tensors["J"]
        power = self.s * (J - 1) * (2 + J) * u.zeta_tensors["J"]
        return [Entry("dissipation_healing", "dissipation", Integrand(power))]


# both functions are kept between steps, but have new values in each step
FACTOR, NET = 1 + x + 20 * nv.time, CF((y, nv.time))


@dataclass(frozen=True)
class GrowthOfPlaceAndTime(PointTerm):
    """A source of mass that depends on place and time, and a drag by a moving net on the sides of cells."""

    s: float

    def factor(self, u):
        return self.s * u.context.given(FACTOR)

    def cells(self, u, w):
        s = self.factor(u)
        return [-s * u.rho * w.rho, -0.5 * s * u.rho * inner(u.v, w.v)]

    def facets(self, u, w):
        net = u.context.given(NET)
        return [self.factor(u) * inner(u.v - net, w.v)]

    def entries(self, u):
        s, net = self.factor(u), u.context.given(NET)
        source = Integrand(0.5 * s * u.rho * square(u.v))
        loss = Integrand(facets=s * inner(u.v - net, u.v))
        return [Entry("power_growth", "power", source), Entry("dissipation_net", "dissipation", loss)]


@dataclass(frozen=True)
class GrowthByForms:
    """A term with a row of rho that only a form gives."""

    s: float

    def form(self, u, w):
        return [Integrand(-self.s * u.rho * w.rho)]

    def entries(self, u):
        return []


class FormOnly(PointTerm):
    """A term at points that only a form gives."""

    def form(self, u, w):
        return [Integrand(4.0 * u.rho * inner(u.v, w.v))]

    def entries(self, u):
        return [Entry("dissipation_form_only", "dissipation", Integrand(4.0 * u.rho * square(u.v)))]


class OldViscosity(PointTerm):
    """A viscosity that depends on the old state, on gradients of the old state, and on the size of cells."""

    def _modulus(self, u):
        c = u.context
        return 0.1 * c.old.rho + 0.1 * square(c.momentum_old) + 0.1 * (1 + c.h) * square(c.old.grad_rho)

    def cells(self, u, w):
        return [self._modulus(u) * inner(u.grad_v, w.grad_v)]

    def entries(self, u):
        power = self._modulus(u) * square(u.grad_v)
        return [Entry("dissipation_old_viscosity", "dissipation", Integrand(power))]


class Impulse(PointTerm):
    """The row -J . w/tau, by which each step adds the momentum J; ``rate`` is a number."""

    def cells(self, u, w):
        return [u.context.rate(-0.01) * w.v[0]]

    def entries(self, u):
        return [Entry("power_impulse", "power", Integrand(u.context.rate(0.01) * u.v[0]))]


class RowsOfBoth(PointTerm):
    """Rows of v, and of z with gradients of the tests."""

    def cells(self, u, w):
        return [0.1 * inner(u.v, w.v), 1e-3 * inner(u.grad_z, w.grad_z)]

    def entries(self, u):
        power = 0.1 * square(u.v) + 1e-3 * inner(u.grad_z, u.grad_zeta)
        return [Entry("dissipation_rows_of_both", "dissipation", Integrand(power))]


class GrowthInTime(PointTerm):
    """Growth at a rate that depends on place and time. The term makes this function, whose mean over the step
    acts."""

    def _rate(self, u):
        return u.context.average(0.5 + x + 20 * nv.time)

    def cells(self, u, w):
        s = self._rate(u)
        return [-s * u.rho * w.rho, -0.5 * s * u.rho * inner(u.v, w.v)]

    def entries(self, u):
        power = 0.5 * self._rate(u) * u.rho * square(u.v)
        return [Entry("power_growth_in_time", "power", Integrand(power))]


@dataclass(frozen=True)
class ByArray(PointTerm):
    """A drag whose parameter is an array, so that two such terms cannot be compared."""

    c: np.ndarray

    def cells(self, u, w):
        return [self.c[0] * inner(u.v, w.v) + self.c[1] * (1 + square(u.v)) * inner(u.grad_v, w.grad_v)]

    def entries(self, u):
        power = self.c[0] * square(u.v) + self.c[1] * (1 + square(u.v)) * square(u.grad_v)
        return [Entry(f"dissipation_by_array_{self.c[1]:g}", "dissipation", Integrand(power))]


class DragByEnergy(PointTerm):
    """A drag that depends on the stored energy, which only forms have."""

    couples = "flow"

    def cells(self, u, w):
        return [3.0 * u.context.energy.density(u) * inner(u.v, w.v)]

    def entries(self, u):
        power = 3.0 * u.context.energy.density(u) * square(u.v)
        return [Entry("dissipation_drag_by_energy", "dissipation", Integrand(power))]


@dataclass(frozen=True, kw_only=True)
class HyperByPlace(nv.HyperViscosity):
    def moduli(self, z):
        return self.mu * (1 + x), self.mu_1


NEO_HOOKEAN = nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1)


def simulation(terms=(), maxh=0.5, **options):
    hyper, initial = nv.HyperViscosity(mu=1e-5, p=4), nv.Initial(density=1 + 0.2 * x, velocity=SWIRL)
    loads = [nv.Gravity((0.0, -1.0))]
    return swirling(maxh, hyperviscosity=hyper, loads=loads, initial=initial, terms=terms, **options)


def solved(*terms, until=0.06, **options):
    """Ledgers of both solvers, whose states agree."""
    runs = []
    for solver in ("split", "coupled"):
        nv.time.Set(0.0)
        runs.append(simulation(terms, solver=solver, **options))
        assert np.abs(runs[-1].run(until).column("closure_relative")).max() <= 1e-12
    assert_same(*runs)
    return [run.ledger for run in runs]


@pytest.mark.parametrize(
    ("term", "scheme"), [(Drag(8.0), "midpoint"), by_ci(DragByForms(8.0), "backward-euler")]
)
def test_a_user_s_term_acts_in_both_solvers(term, scheme):
    free = simulation(scheme=scheme, solver="split").run(0.06)
    for ledger in solved(term, scheme=scheme):
        (name,) = (name for name in ledger.columns if name.startswith("dissipation_drag"))
        assert ledger.column(name).max() > 0.1
        assert ledger.column("kinetic")[-1] < 0.8 * free.column("kinetic")[-1]


# the drag is relative to a moving net, which may give energy
@pytest.mark.filterwarnings("ignore::ngvisco.run.signs.DissipationWarning")
@pytest.mark.parametrize("term", [Leak(0.5), GrowthOfPlaceAndTime(0.5)], ids=lambda term: type(term).__name__)
def test_terms_in_rows_of_the_density_and_on_facets_act_in_both_solvers(term):
    for ledger in solved(term):
        mass = ledger.column("mass")
        assert abs(mass[-1] / mass[0] - 1) > 1e-2


@pytest.mark.filterwarnings("ignore::ngvisco.run.signs.DissipationWarning")  # healing gives energy
def test_the_tangent_contains_a_term_s_effect_on_the_fields():
    split, _ = solved(Healing(2e3), maxh=0.25)
    assert split.column("newton_iterations").max() <= 12
    assert split.column("dissipation_healing").max() > 1e-3


@pytest.mark.parametrize("scheme", ["backward-euler", by_ci("sdirk2")])
def test_a_term_may_read_any_state_in_both_solvers(scheme):
    terms = FormOnly(), OldViscosity(), Impulse(), RowsOfBoth(), GrowthInTime()
    for ledger in solved(*terms, scheme=scheme):
        for name in ("form_only", "old_viscosity", "rows_of_both"):
            assert ledger.column(f"dissipation_{name}").max() > 1e-6
        for name in ("power_impulse", "power_growth_in_time"):
            assert np.abs(ledger.column(name)).max() > 1e-6


def test_terms_may_hold_arrays_because_terms_are_compared_by_identity():
    solved(ByArray(np.array([1.0, 0.1])), ByArray(np.array([1.0, 0.2])))


def test_a_form_reads_the_energy_of_the_present_state():
    """The energy may also have values at points only, which are stored."""
    solved(DragByEnergy(), material=nv.Yosida(material=NEO_HOOKEAN, eps=0.05), until=0.04)


def test_the_split_solver_refuses_a_hyperviscosity_that_arrays_cannot_evaluate():
    model = nv.Model(
        material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1), hyperviscosity=HyperByPlace(mu=1e-5)
    )
    with pytest.raises(
        nv.ParameterError,
        match=r"'coupled', since .*Hyperviscosity \(its law cannot be evaluated with arrays",
    ):
        nv.Simulation(box((1, 1), maxh=0.5), model, dt=0.02, solver="split")
    auto = nv.Simulation(box((1, 1), maxh=0.15), model, dt=0.02)
    assert type(auto.solver.newton).__name__ == "Newton"


def test_auto_chooses_the_split_solver_if_it_can_evaluate_the_user_s_term():
    assert type(simulation([Drag(1.0)], maxh=0.15).solver.newton).__name__ == "Split"
    assert type(simulation([GrowthByForms(1.0)], maxh=0.15).solver.newton).__name__ == "Newton"


def test_a_term_that_only_forms_can_express_is_refused_by_its_name():
    term = GrowthByForms(0.1)
    with pytest.raises(nv.ParameterError, match=r"GrowthByForms has a row of rho.* rows of v alone"):
        simulation([term], solver="split")
    ledger = simulation([term], solver="coupled").run(0.04)
    mass = ledger.column("mass")  # the mass grows by (1 - s tau)^-1 in a step
    assert mass[-1] / mass[0] == pytest.approx((1 - 0.1 * 0.02) ** -2, rel=1e-12)


def test_the_split_solver_evaluates_every_term_of_a_step_exactly_once():
    """The test covers every term that models of the package make."""
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
    found = Couplings(run.rothe_step)
    parts = [found.at_points, found.by_forms, *found.of_kernel.values()]
    assert sorted(id(term) for part in parts for term in part) == sorted(map(id, run.rothe_step.terms))
    assert term_obstacle(run.rothe_step) is None
    # terms on facets of walls are forms; all other terms with rows of the flow are evaluated at points
    assert [type(term).__name__ for term in found.by_forms] == ["TangentialStress"]


class UndeclaredDragByEnergy(DragByEnergy):
    """A drag that depends on the energy, but declares that it is a function of the values at a point."""

    couples = "local"


class FacetDragByForms(Leak):
    """A leak whose dissipation on facets has an operation that arrays do not have."""

    def dissipated_on_facets(self, u):
        return {"dissipation_leak": self.c * u.rho * Norm(u.v)}

    entries = PointTerm.entries


class FacetDragOfNumbers(FacetDragByForms):
    """A leak whose dissipation on facets is no function of the values on the facets."""

    def dissipated_on_facets(self, u):
        return {"dissipation_leak": CF(1.0)}


class HeavierDrag(Drag):
    """A drag that only the coupled solver takes."""

    coupled_only = "its authors say so"


@pytest.mark.parametrize(
    ("term", "reason"),
    [
        (UndeclaredDragByEnergy(), r"there is no array of energy.*declare couples = 'flow'"),
        (
            FacetDragByForms(1.0),
            r"FacetDragByForms \(dissipated_on_facets\(u\) cannot be evaluated with arrays",
        ),
        (
            FacetDragOfNumbers(1.0),
            r"FacetDragOfNumbers \(.*'dissipation_leak' is of type CoefficientFunction",
        ),
        (HeavierDrag(1.0), r"HeavierDrag \(its authors say so"),
    ],
    ids=lambda value: type(value).__name__,
)
def test_a_term_that_contradicts_its_declaration_is_refused_by_name(term, reason):
    with pytest.raises(ParameterError, match=reason):
        simulation([term], solver="split")
    assert type(simulation([term], maxh=0.15).solver.newton).__name__ == "Newton"


def test_a_subclass_with_another_equation_does_not_inherit_the_kernel():
    class Twice(Conjugates):
        def cells(self, u, w):
            return [2.0 * part for part in super().cells(u, w)]

    class Renamed(Conjugates):
        pass

    assert Twice.kernel is None and Renamed.kernel == "conjugates"


@dataclass(frozen=True)
class Bent(Variable):
    """A scalar whose rate is a square of it, or a square of grad v."""

    name: str = "s"
    kind: str = "scalar"
    of_gradient: bool = False

    def rate(self, z, L, Pi):
        return square(L) if self.of_gradient else tr(L) * (1 + z["s"] * z["s"])

    def from_distortion(self, F):
        return CF(0.0)


def with_bent(**of_variable):
    return nv.CustomMaterial(
        transported=(Distortion(), Bent(**of_variable)),
        stored_energy=lambda F, s: 3.0 * square(F) + 2.0 * s * s + 6.0 * exp(-s),
    )


def test_only_the_coupled_solver_takes_a_rate_not_linear_in_the_variables():
    """The split solver tabulates rates that are linear in the variables. The split solver refuses this rate,
    and names the variable."""
    with pytest.raises(
        ParameterError, match="'coupled', since the rate of 's' is not linear in the variables"
    ):
        simulation(material=with_bent(), solver="split")
    run = simulation(material=with_bent(), solver="coupled")
    assert np.abs(run.run(0.04).column("closure_relative")).max() <= 1e-12


def test_a_rate_that_is_not_linear_in_the_velocity_gradient_is_refused():
    with pytest.raises(ParameterError, match=r"Bent\.rate = 's': expected a rate that is linear in L and Pi"):
        simulation(material=with_bent(of_gradient=True), solver="coupled")
