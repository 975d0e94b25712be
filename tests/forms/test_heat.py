"""Heat in both solvers: dissipation becomes heat, the total energy is kept, and entropy grows."""

import math
import warnings
from dataclasses import replace

import numpy as np
import pytest
from ngsolve import CF, L2, Integrate, LinearForm, cos, pi, sin, x, y
from support import others_by_ci

import ngvisco as nv
from ngvisco.forms.projections import set_traces
from ngvisco.forms.term import PRODUCTION, Entry, Integrand, PointTerm
from ngvisco.forms.terms.transport import Upwinding
from ngvisco.geometries import box, structured_box
from ngvisco.physics.tensors import inner, square
from ngvisco.run.signs import EntropyWarning

SOLID = nv.Thermal(
    material=nv.IsochoricNeoHookean(K_e=20.0, G_e=1.0, elastic_state="B"), c=3.0, expansion=0.1, theta_R=1.0
)
SWIRL = CF((sin(pi * x) * cos(pi * y), -cos(pi * x) * sin(pi * y)))
VISCOSITY = nv.StokesViscosity(K_v=0.05, G_v=0.05)
ALL = {
    "viscosity": VISCOSITY,
    "hyperviscosity": nv.HyperViscosity(mu=1e-4),
    "creep": nv.Creep(G_m=1.0),
    "regularisation": nv.Regularisation(epsilon=0.1),
}
"""Mechanisms that dissipate."""
STEPS = nv.AdaptiveSteps(dt_min=1e-3, dt_max=0.05)


def run_of(solver, heat=None, steps=2, laws=ALL, material=SOLID, **options):
    model = nv.Model(material=material, heat=heat, **laws)
    start = nv.Initial(density=1.0, velocity=SWIRL, temperature=options.pop("temperature", 1 + 0.2 * x))
    options |= {} if "time" in options else {"dt": 0.05}
    run = nv.Simulation(box((1, 1), maxh=0.7), model, initial=start, solver=solver, **options)
    run.run(until=steps * 0.05)
    return run


def energy(ledger):
    return ledger.column("kinetic") + ledger.column("stored")


def produced(ledger):
    """Entropy by mechanism, W/K, (mechanisms, steps)."""
    return np.array([ledger.column(name)[1:] for name in ledger.columns if name.startswith(PRODUCTION)])


CLOSED = {
    "euler": (lambda theta: 0.05 * theta * theta, {}, True),
    "relaxed midpoint": (0.05, {"scheme": "midpoint", "relaxation": True, "adaptive": STEPS}, False),
}
"""Schemes that keep the energy of a closed box: conductivity, options of the steps, numerical heating."""


BREAKING = nv.Damaged(material=SOLID.material, G_c=0.4, length=1.0, viscosity=0.02, part="all")
YIELDING = nv.Perzyna(sigma_Y=0.1, G_m=1.0)


@pytest.mark.filterwarnings("ignore:.*no longer belong to one distortion")  # with four cells, F and J differ
@pytest.mark.parametrize("kind", others_by_ci(CLOSED, "euler"))
def test_a_closed_box_keeps_its_energy_and_gains_entropy_in_both_solvers(kind):
    """Creep beyond a yield stress, growing damage and friction at a wall dissipate. The energy is kept to the
    tolerance of the iteration. The energy in the column ``bregman_damage`` is not heat.
    """
    conductivity, options, numerical = CLOSED[kind]
    all_on = {"material": replace(SOLID, material=BREAKING), "laws": ALL | {"creep": YIELDING}}
    heat, found = nv.Heat(conductivity=conductivity, numerical_heating=numerical), []
    for solver in ("coupled", "split"):
        time = nv.TimeSteps(dt=0.05, **options)
        newton, walls = nv.NewtonOptions(tolerance=1e-12), {"bottom": nv.NavierFriction(0.2)}
        ledger = run_of(solver, heat, walls=walls, time=time, newton=newton, **all_on).ledger
        names = {name for name in ledger.columns if name.startswith("dissipation_")}
        assert names >= {
            f"dissipation_{n}" for n in ("hyper", "creep", "epsilon", "friction_bottom", "damage")
        }
        dt = ledger.column("dt")
        heated = (dt * ledger.column("power_heat_dissipated")).sum()
        kept = energy(ledger) + np.cumsum(ledger.column("bregman_damage"))
        assert (
            abs(kept - kept[0]).max() <= 1e-12 * heated and (ledger.column("power_heat_damage")[1:] > 0).all()
        )
        entropy = ledger.column("entropy")
        assert (np.diff(entropy) > 0).all() and (produced(ledger) >= 0).all()
        assert np.diff(entropy) == pytest.approx(dt[1:] * produced(ledger).sum(axis=0), rel=1e-10)
        assert len(produced(ledger)) == len(names) + numerical + 1  # conduction also produces entropy
        found.append([ledger.column(name)[-1] for name in ("kinetic", "stored", "entropy", *sorted(names))])
    assert found[0] == pytest.approx(found[1], rel=1e-8)


@pytest.mark.long
@pytest.mark.ci
# with twelve cells, F and J differ
@pytest.mark.filterwarnings("ignore:.*no longer belong to one distortion")
def test_both_solvers_keep_the_energy_and_agree_with_a_tensor_in_three_dimensions():
    heat, found = nv.Heat(conductivity=np.diag([0.05, 0.02, 0.1]), numerical_heating=True), []
    start = nv.Initial(density=1.0, velocity=CF((*SWIRL, 0.0)), temperature=1 + 0.2 * x)
    model = nv.Model(material=SOLID, heat=heat, **ALL)
    for solver in ("coupled", "split"):
        options = {"solver": solver, "newton": nv.NewtonOptions(tolerance=1e-12)}
        ledger = nv.Simulation(box((1, 1, 1), maxh=1.0), model, dt=0.05, initial=start, **options).run(0.1)
        heated = 0.05 * ledger.column("power_heat_dissipated").sum()
        assert abs(energy(ledger) - energy(ledger)[0]).max() <= 1e-12 * heated
        assert (np.diff(ledger.column("entropy")) > 0).all() and (produced(ledger) >= 0).all()
        found.append([ledger.column(name)[-1] for name in ("kinetic", "stored", "entropy")])
    assert found[0] == pytest.approx(found[1], rel=1e-9)


@pytest.mark.parametrize("solver", ["coupled", "split"])
def test_heat_from_sources_and_walls_is_counted_in_the_energy(solver):
    walls = {
        "left": nv.Slip(heat=nv.WallHeat(temperature=1.5, coefficient=0.4)),
        "right": nv.NoSlip(heat=nv.WallHeat(flux=0.1 * (1 + y))),
    }
    heat = nv.Heat(conductivity=0.05, source=0.3 * (1 + x))
    run = run_of(solver, heat, scheme="midpoint", laws={"viscosity": VISCOSITY}, walls=walls)
    ledger = run.ledger
    assert ledger.column("power_heat_source")[-1] == pytest.approx(0.45, rel=1e-12)
    assert ledger.column("power_heat_right")[-1] == pytest.approx(0.15, rel=1e-12)
    assert 0.05 < ledger.column("power_heat_left")[-1] < 0.25
    columns = [f"power_heat_{name}" for name in ("source", "left", "right")]
    supplied = 0.05 * sum(ledger.column(name) for name in columns)
    remainder = ledger.column("inertial") + ledger.column("bregman")
    assert np.diff(energy(ledger)) == pytest.approx((supplied - remainder)[1:], rel=1e-9)
    assert abs(remainder).max() < 0.01 * supplied[-1]
    assert abs(ledger.column("closure_relative")).max() <= 1e-10


@pytest.mark.parametrize("conductivity", [0.3, np.diag([0.3, 0.1, 1.0])])
def test_conduction_at_rest_solves_the_heat_equation(conductivity):
    """The temperature theta_R + 10 cos(pi x) decays by kappa pi^2/c; without expansion nothing moves."""
    material = nv.Thermal(material=nv.LinearElastic(K_e=1e3, G_e=1e3), c=2.0, theta_R=100.0)
    model = nv.Model(material=material, heat=nv.Heat(conductivity=conductivity))
    start = nv.Initial(density=1.0, temperature=100 + 10 * cos(pi * x))
    options = {"scheme": "midpoint", "solver": "coupled"}
    run = nv.Simulation(box((1, 0.3), maxh=0.25), model, dt=0.05, initial=start, **options)
    run.run(until=0.1)
    amplitude = 2 / 3 * Integrate(run.fields["temperature"] * cos(pi * x), run.mesh)
    assert amplitude == pytest.approx(math.exp(-0.3 / 2 * pi**2 * 0.1), rel=0.01)


def test_heat_of_upwinding_is_shared_by_both_sides_of_a_facet():
    """The test looks at the facet between two triangles, at a random state."""
    start = nv.Initial(density=1.0, velocity=SWIRL, temperature=1 + 0.2 * x)
    run = nv.Simulation(box((1, 1), maxh=2.0), nv.Model(material=SOLID), dt=0.05, initial=start)
    step, rng = run.rothe_step, np.random.default_rng(0)
    parts = dict(zip(step.layout.names, step.state.components, strict=True))
    for name in ("v", "z"):
        parts[name].vec.FV().NumPy()[:] += 0.05 * rng.uniform(-1, 1, len(parts[name].vec))
    step.local_unknowns.update_without_means()
    set_traces(step.layout, step.state, step.context, step.quadrature)
    step.local_unknowns.update()
    (term,) = (term for term in step.terms if isinstance(term, Upwinding))
    (lost,) = term.dissipated_on_facets(step.now).values()
    heat = LinearForm(step.quadrature.facets(lost * L2(run.mesh, order=0).TestFunction())).Assemble()
    first, second = heat.vec.FV().NumPy()
    assert first == pytest.approx(second, rel=1e-12)
    assert first > 1e-6


def test_conduction_with_cellwise_constant_temperatures_is_refused():
    options = {"discretisation": nv.Discretisation(m=0), "laws": {"viscosity": VISCOSITY}}
    with pytest.raises(nv.NgviscoError, match=r"Discretisation\.m = 0: expected 1 or 2 with a flux of heat"):
        run_of("coupled", nv.Heat(conductivity=0.1), steps=0, **options)
    ledger = run_of("coupled", nv.Heat(source=1.0), **options).ledger  # heat is not conducted here
    assert ledger.column("power_heat_source")[-1] == pytest.approx(1.0, rel=1e-12)


class Drag(PointTerm):
    """A resistance whose dissipation is heat."""

    def cells(self, u, w):
        return [2.0 * inner(u.v, w.v)]

    def dissipated(self, u):
        return {"dissipation_drag": 2.0 * square(u.v)}


class Hidden(Drag):
    """A resistance that has its dissipation only in its columns."""

    def dissipated(self, u):
        return {}

    def entries(self, u):
        return [Entry("dissipation_drag", "dissipation", Integrand(2.0 * square(u.v)))]


def test_an_outdated_method_name_is_refused_with_the_new_name():
    for before, now in (("nodes", "collocated"), ("dissipated_at_nodes", "dissipated_collocated")):
        with pytest.raises(nv.ParameterError, match=rf"Old\.{before}.*{now}"):
            type("Old", (PointTerm,), {before: lambda term, u: []})


@pytest.mark.parametrize("solver", ["coupled", "split"])
def test_the_dissipation_of_a_user_s_term_becomes_heat_or_is_refused(solver):
    laws = {"viscosity": VISCOSITY}
    ledger = run_of(solver, laws=laws, terms=[Drag()], scheme="midpoint").ledger
    lost = ledger.column("dissipation_drag")
    assert lost[-1] > 0.05 and ledger.column(PRODUCTION + "drag")[-1] > 0.04
    assert energy(ledger) == pytest.approx(energy(ledger)[0], rel=1e-3)
    with pytest.raises(nv.NgviscoError, match=r"Hidden.*dissipated"):
        run_of(solver, laws=laws, terms=[Hidden()], steps=0)


class Feeding(Drag):
    """A force that gives energy to the motion, and takes it from the heat."""

    def cells(self, u, w):
        return [-0.1 * inner(u.v, w.v)]

    def dissipated(self, u):
        return {"dissipation_feeding": -0.1 * square(u.v)}


def test_a_mechanism_that_takes_entropy_away_is_warned_of_by_name():
    feeding = pytest.warns(
        nv.DissipationWarning, match=r"dissipation_feeding is negative .* and produces energy"
    )
    with (
        feeding,
        pytest.warns(EntropyWarning, match=r"entropy_production_feeding is -.*its law produces energy"),
    ):
        ledger = run_of("coupled", laws={"viscosity": VISCOSITY}, terms=[Feeding()]).ledger
    assert abs(ledger.column("closure_relative")).max() <= 1e-10  # the closure does not show this fault


def test_rounding_of_an_entropy_that_stays_zero_brings_no_warning():
    """A solid at its reference temperature is compressed adiabatically and uniformly: entropy stays zero, and
    its production is rounding."""
    run = nv.Simulation(
        structured_box((1.0, 1.0), (1, 1)),
        nv.Model(
            material=nv.Thermal(
                material=nv.ReferentialNeoHookean(K_e=100.0, G_e=10.0), c=10.0, theta_R=300.0, gruneisen=2.0
            )
        ),
        dt=0.005,
        scheme="midpoint",
        initial=nv.Initial(density=1e-4, velocity=(-0.1 * x, 0.0)),
        walls={"right": nv.PrescribedNormal(velocity=-0.1)},
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error", EntropyWarning)
        run.run(0.05)
    # the heat of one step has a rounding error of this size
    assert 0 < -min(run.ledger.column(PRODUCTION + "upwinding")) < 1e-12


@pytest.mark.filterwarnings("ignore:.*of the present momentum")
def test_rounding_of_the_heat_exchange_by_a_huge_coefficient_brings_no_warning():
    """The exchange is the coefficient times a difference of temperatures that agree up to their last
    digits."""
    walls = {"left": 400.0, "right": 300.0}
    run = nv.Simulation(
        structured_box((0.01, 0.01), (2, 1)),
        nv.Model(
            material=nv.Thermal(
                material=nv.LinearElastic(K_e=1e9, G_e=1e9), c=3.6e6, theta_R=293.0, expansion=0.0
            ),
            heat=nv.Heat(conductivity=50.0),
        ),
        dt=20.0,
        initial=nv.Initial(density=7800.0, temperature=350.0 - 1e4 * (x - 0.005)),
        walls={
            name: nv.NoSlip(heat=nv.WallHeat(temperature=theta, coefficient=1e11))
            for name, theta in walls.items()
        },
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error", nv.ClosureWarning)
        run.run(200.0)
    difference_of = {entry.name: entry.difference_of for entry in run.rothe_step.entries()}
    assert {name for name, size in difference_of.items() if size is not None} >= {
        f"power_heat_{name}" for name in walls
    }
    power = run.ledger.column("power_heat_left")[-1]
    assert power == pytest.approx(50.0 * 1e4 * 0.01, rel=1e-2)  # the power is in W/m


def test_the_dissipation_of_field_diffusion_becomes_heat_in_the_coupled_solver():
    gas = nv.Thermal(c=3.0, gruneisen=0.4, theta_R=1.0)
    options = {"material": gas, "laws": {"regularisation": nv.Regularisation(delta_fields=1e-2)}}
    ledger = run_of("coupled", nv.Heat(numerical_heating=True), **options).ledger
    heated = 0.05 * ledger.column("power_heat_dissipated").sum()
    assert abs(energy(ledger) - energy(ledger)[0]).max() <= 1e-9 * heated
    assert ledger.column(PRODUCTION + "delta_fields")[-1] > 0.01
    with pytest.raises(
        nv.NgviscoError, match=r"'coupled', since .*Heating \(the dissipation of delta_fields"
    ):
        run_of("split", steps=0, **options)


@pytest.mark.parametrize(
    ("curvature", "said"),
    [(0.0, r"Initial\.values.*a value of 's'"), (-3.0, r"Model\.material.*convex in the entropy")],
)
def test_a_user_s_energy_must_have_a_temperature_that_rises_with_the_entropy(curvature, said):
    good = nv.Thermal(material=nv.LinearElastic(K_e=10.0, G_e=5.0), c=3.0, theta_R=1.0)
    own = nv.CustomMaterial(
        transported=good.variables, stored_energy=lambda **z: good.energy(z) + curvature * z["s"] * z["s"]
    )
    with pytest.raises(nv.NgviscoError, match=said):
        run_of("coupled", material=own, laws={}, temperature=None, steps=0)


def test_a_heat_flux_through_a_wall_without_conductivity_is_warned_of():
    walls = {"left": nv.Slip(heat=nv.WallHeat(flux=1.0))}
    with pytest.warns(nv.InputWarning, match=r"walls\['left'\]\.heat: without a conductivity"):
        run_of("coupled", walls=walls, steps=0)


THINNER = nv.ActivatedViscosity(viscosity=VISCOSITY, E=20.0, theta_R=1.0)


def bodies_of(pair, **changes):
    """Two bodies side by side, each half of the box; the left one creeps, and both are less viscous where
    they are warm."""
    cold = nv.ReferentialNeoHookean(K_e=10.0, G_e=1.0)
    laws = {"left": {"where": 0.5 - x, "creep": nv.Creep(G_m=1.0)}, "rest": changes}
    return [
        nv.Body(
            name=name,
            material=nv.Thermal(**({"material": cold, "theta_R": 1.0} | given)),
            viscosity=THINNER,
            density=1.0,
            **own,
        )
        for (name, own), given in zip(laws.items(), pair, strict=True)
    ]


LONG = (pytest.mark.long, pytest.mark.ci)
PAIRS_OF_BODIES = [
    pytest.param("euler", {"expansion": 0.1}, id="one thermal pressure"),
    pytest.param("relaxed midpoint", {"expansion": 0.3}, marks=LONG, id="two thermal pressures"),
    pytest.param("relaxed midpoint", {"gruneisen": 0.3, "material": None}, marks=LONG, id="gas"),
]
"""Schemes, and the body beside a solid with the thermal expansion 0.1/K. The common energy of both bodies has
an expression only if the expansions are equal."""


@pytest.mark.parametrize(("kind", "other"), PAIRS_OF_BODIES)
def test_bodies_keep_their_energy_and_gain_entropy_in_both_solvers(kind, other):
    """Viscosity, creep, friction and conduction act; the right half has its own law of heat. Energy taken by
    the limiter does not become heat."""
    _, options, numerical = CLOSED[kind]
    tolerance = 3e-14 if numerical else 1e-13  # the lost energy is in proportion to the tolerance
    pair = ({"c": 3.0, "expansion": 0.1}, {"c": 1.0} | other)
    bodies = bodies_of(pair, heat=nv.Heat(conductivity=lambda theta: 0.1 * theta))
    model = nv.Model(bodies=bodies, heat=nv.Heat(conductivity=0.02, numerical_heating=numerical))
    start, found = nv.Initial(velocity=SWIRL, temperature=1.2), []
    for solver in ("coupled", "split"):
        run = nv.Simulation(
            box((1, 1), maxh=0.7),
            model,
            time=nv.TimeSteps(dt=0.05, **options),
            initial=start,
            solver=solver,
            walls={"bottom": nv.NavierFriction(0.2)},
            newton=nv.NewtonOptions(tolerance=tolerance),
        )
        before = run.fields["temperature"]
        # cells that both bodies share have another pressure
        exact = 1e-12 if numerical else 1e-2
        assert [before(run.mesh(at, 0.3)) for at in (0.1, 0.9)] == pytest.approx([1.2, 1.2], rel=exact)
        ledger = run.run(0.1)
        dt = ledger.column("dt")
        heated = (dt * ledger.column("power_heat_dissipated")).sum()
        taken = np.cumsum(ledger.column("limiter") + ledger.column("limiter_walls"))
        assert abs(energy(ledger) + taken - energy(ledger)[0]).max() <= 1e-12 * heated
        entropy = ledger.column("entropy")
        assert (np.diff(entropy) > 0).all() and (produced(ledger) >= 0).all()
        assert np.diff(entropy) == pytest.approx(dt[1:] * produced(ledger).sum(axis=0), rel=1e-10)
        assert {"entropy_production_creep", "entropy_production_conduction"} <= set(ledger.columns)
        found.append(
            [ledger.column(name)[-1] for name in ("kinetic", "stored", "entropy", "temperature_min")]
        )
    assert found[0] == pytest.approx(found[1], rel=1e-8)


def test_a_heated_body_becomes_warmer_than_the_other_body():
    """A source of 2 W/m^3 heats the right half (c = 1) for 0.05 s, by 0.1 K; the left half has no source."""
    pair = ({"c": 3.0}, {"c": 1.0})
    bodies = bodies_of(pair, heat=nv.Heat(source=2.0))
    model = nv.Model(bodies=bodies, heat=nv.Heat(numerical_heating=True))
    start = nv.Initial(temperature=1.0)
    run = nv.Simulation(box((1, 1), maxh=0.5), model, dt=0.05, initial=start)
    ledger = run.run(0.05)
    u, q = run.rothe_step.now, run.rothe_step.quadrature
    share = run.model.material.fractions.not_negative(u.z_tensors)["rest"]
    assert ledger.column("power_heat_source")[-1] == pytest.approx(2.0 * q.integrate_cells(share), rel=1e-9)
    assert np.diff(energy(ledger)) == pytest.approx(0.05 * ledger.column("power_heat_source")[1:], rel=1e-9)
    theta = run.fields["temperature"]
    warmed = [theta(run.mesh(at, 0.5)) for at in (0.05, 0.95)]
    assert warmed == pytest.approx([1.0, 1.1], rel=1e-3)  # the tolerance is for cells that both bodies share


@pytest.mark.parametrize("solver", ["coupled", "split"])
def test_the_wall_takes_its_share_of_the_friction_heat(solver):
    share = 0.25
    wall = nv.NavierFriction(0.2, heat=nv.WallHeat(friction_share=share))
    ledger = run_of(solver, nv.Heat(numerical_heating=True), laws={}, walls={"bottom": wall}).ledger
    lost = -ledger.column("power_heat_friction_bottom")
    assert (lost[1:] > 0).all()
    assert lost[1:] == pytest.approx(
        (1 - share) * ledger.column("dissipation_friction_bottom")[1:], rel=1e-12
    )
    # 1e-11 J is 3e-12 of the energy, which is some tolerances of the solver
    assert np.diff(energy(ledger)) == pytest.approx(-0.05 * lost[1:], rel=1e-8, abs=1e-11)
    kept = produced(ledger).sum(axis=0) + ledger.column("entropy_supply_friction_bottom")[1:]
    assert np.diff(ledger.column("entropy")) == pytest.approx(0.05 * kept, rel=1e-9)
    with pytest.raises(nv.NgviscoError, match=r"walls\['left'\]\.heat\.friction_share.*without friction"):
        walls = {"left": nv.Slip(heat=nv.WallHeat(friction_share=share))}
        run_of(solver, walls=walls, steps=0)
