"""Bodies of different material in one domain: mass, fractions, the ledger, both solvers, refusals."""

import warnings
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from ngsolve import CF, IfPos, Integrate, cos, pi, sin, x, y
from support import assert_same, by_both_solvers, by_ci, others_by_ci, small_run, swirling

import ngvisco as nv
from ngvisco.forms.term import PointTerm
from ngvisco.geometries import box, structured_box
from ngvisco.physics.arrays import Array
from ngvisco.physics.bodies import AMOUNT
from ngvisco.physics.mixture import Mixture
from ngvisco.physics.variables import Jacobian
from tests.verification.cases.discs import control

STOKES = nv.StokesViscosity(K_v=0.05, G_v=0.05)
SOLID = nv.ReferentialNeoHookean(K_e=10.0, G_e=1.0)
FLUID = nv.CustomMaterial(transported=(Jacobian(),), stored_energy=lambda J: 5 * (J - 2 + 1 / J))
BY_F = nv.ReferentialNeoHookean(K_e=10.0, G_e=1.0, elastic_state="F")
BREAKS = nv.Damaged(material=SOLID, G_c=0.1, length=0.5, part="all")
HOT_BREAKS = nv.Thermal(material=BREAKS, c=1.0, theta_R=1.0, expansion=0.1)
QUADRATIC = nv.WithQuadratic(material=SOLID, delta=0.01)
VARIED = nv.ReferentialNeoHookean(K_e=10.0 + x, G_e=1.0)


def disc(**changes):
    options = {"name": "disc", "where": nv.Ball((0.6, 0.5), 0.25), "material": SOLID, "density": 2.0}
    return nv.Body(**(options | {"viscosity": STOKES} | changes))


def rest(**changes):
    options = {"name": "rest", "material": FLUID, "density": 1.0, "viscosity": STOKES}
    return nv.Body(**(options | changes))


CASES = {
    "solid in a fluid": lambda: [disc(), rest()],
    "two solids": lambda: [
        disc(),
        rest(material=nv.ReferentialMooneyRivlin(K_e=5.0, G_e=0.5, G_mr=0.5), viscosity=None),
    ],
    "creeping and not": lambda: [
        disc(),
        rest(
            material=nv.ReferentialNeoHookean(K_e=10.0, G_e=0.2 + 0.1 * x),
            creep=nv.Creep(G_m=0.02 + 0.02 * y),
        ),
    ],
    "hardening and yielding": lambda: [
        disc(creep=nv.Perzyna(sigma_Y=0.02, G_m=0.02, H=0.5 + 0.2 * x, Q=0.1)),
        rest(
            material=nv.ReferentialMooneyRivlin(K_e=10.0, G_e=0.5, G_mr=0.5),
            creep=nv.Perzyna(sigma_Y=0.01, G_m=0.02, H=0.2),
        ),
    ],
    "three, a layer on a layer": lambda: [
        disc(order=1),
        nv.Body(
            name="layer",
            where=nv.HalfSpace((0.0, 0.4), (0.0, 1.0)),
            material=SOLID,
            density=3.0,
            viscosity=nv.StokesViscosity(K_v=0.1, G_v=0.1),
        ),
        rest(),
    ],
    "compressible": lambda: [
        nv.Body(name="gas", material=nv.BarotropicFluid(B=1.0, gamma=1.4, rho_R=0.5), viscosity=STOKES),
        disc(material=nv.ReferentialNeoHookean(K_e=10.0, G_e=1.0)),
    ],
}


def simulation(name, solver="auto", maxh=0.3, m=1, **options):
    orders, hyper = nv.Discretisation(m=m), nv.HyperViscosity(mu=1e-5)
    settings = {"hyperviscosity": hyper, "solver": solver, "discretisation": orders} | options
    return swirling(maxh, bodies=CASES[name](), **settings)


def masses(run):
    u, q = run.rothe_step.now, run.rothe_step.quadrature
    of_bodies = [b.density * q.integrate_cells(u.z_tensors[AMOUNT + b.name]) for b in run.model.bodies]
    return np.array(of_bodies)


def fractions(run):
    theta = run.model.material.fractions.at(run.rothe_step.now.z_tensors)
    return np.array([run.sampler.values(value) for value in theta.values()])


@pytest.mark.filterwarnings("ignore:bodies .* meet with different stresses")  # the gas has a pressure at rest
@pytest.mark.parametrize(
    "name",
    others_by_ci(CASES, "solid in a fluid"),
)
def test_the_ledger_closes_masses_are_conserved_and_both_solvers_agree(name):
    """The columns bregman and limiter are >= 0 in every step. With bodies, rho is no unknown."""
    found = []
    for solver in ("split", "coupled"):
        run = simulation(name, solver, maxh=0.4)
        before = masses(run)
        ledger, u = run.run(0.04), run.rothe_step.now
        size = ledger.column("kinetic")[0]
        assert np.abs(ledger.column("closure_relative")).max() <= 1e-12
        assert ledger.column("bregman")[1:].min() >= -1e-12 * size
        assert ledger.column("limiter")[1:].min() >= -1e-12 * size
        assert np.abs(masses(run) / before - 1).max() <= 1e-12
        assert ledger.rows[-1]["mass"] == pytest.approx(before.sum(), rel=1e-13)
        rho = sum(b.density * u.z_tensors[AMOUNT + b.name] for b in run.model.bodies)
        assert np.abs(run.sampler.values(u.rho - rho)).max() < 1e-14 * np.abs(run.sampler.values(rho)).max()
        assert set(run.rothe_step.layout.evolving) == {"v", "z"}
        assert np.abs(fractions(run).sum(axis=0) - 1).max() <= 1e-14
        found.append(run)
    assert_same(*found)


def test_the_body_of_higher_order_fills_the_overlap_of_two_bodies():
    """The bodies are halves of 1 and 3 kg/m^3 that overlap by 0.2 m."""
    for order, mass in ((1, 0.6 + 3 * 0.4), (-1, 0.4 + 3 * 0.6)):
        bodies = [
            rest(name="left", where=nv.HalfSpace((0.6, 0.0), (1.0, 0.0)), order=order),
            rest(name="right", where=nv.HalfSpace((0.4, 0.0), (-1.0, 0.0)), density=3.0),
        ]
        run = small_run(structured_box((1, 1), (10, 1)), bodies=bodies)
        assert Integrate(run.fields["density"], run.mesh) == pytest.approx(mass, rel=1e-9)


@pytest.mark.parametrize("name", CASES)
def test_energies_of_bodies_are_jointly_convex(name):
    """Two and three bodies, linear in X or not, have one volumetric energy or several."""
    material = nv.Model(bodies=CASES[name]()).material
    assert nv.check_convexity(material, dim=2).passed
    if name in ("solid in a fluid", "three, a layer on a layer", "compressible"):
        with control(), pytest.warns(nv.ConvexityWarning):
            assert not nv.check_convexity(material, dim=2).passed


@pytest.mark.parametrize(("m", "scheme"), [by_ci(0, "sdirk2"), (2, "midpoint")])
def test_ledger_of_bodies_closes_for_other_orders_and_schemes(m, scheme):
    run = simulation("solid in a fluid", m=m, scheme=scheme)
    before = masses(run)
    run.run(0.06)
    assert np.abs(run.ledger.column("closure_relative")).max() <= 1e-12
    assert np.abs(masses(run) / before - 1).max() <= 1e-12


def test_two_halves_of_one_material_move_like_one_body():
    """The energy equals that of an undivided body, up to the stress that neither half bears in cells at the
    line between them."""
    halves = [
        nv.Body(name="left", where=0.5 - x, material=SOLID, density=2.0, viscosity=STOKES),
        nv.Body(name="right", material=SOLID, density=2.0, viscosity=STOKES),
    ]
    whole = [nv.Body(name="whole", material=SOLID, density=2.0, viscosity=STOKES)]
    energies = []
    for bodies in (halves, whole):
        ledger = swirling(0.35, bodies=bodies, velocity_scale=1.0).run(0.1)
        energies.append(ledger.column("kinetic") + ledger.column("stored"))
    assert abs(energies[0] - energies[1]).max() <= 1e-2 * energies[0][0]


def test_traces_of_a_stiff_body_in_a_thin_fluid_gain_no_energy():
    """A thin fluid bears no stress beside traces of a stiff body.

    Only the scheme dissipates energy, at most 2 % of the kinetic energy.
    """
    stiff = nv.ReferentialNeoHookean(K_e=100.0, G_e=50.0)
    fluid = nv.CustomMaterial(transported=(Jacobian(),), stored_energy=lambda J: 50 * (J - 2 + 1 / J))
    thin = nv.StokesViscosity(K_v=0.0, G_v=1e-5)
    bodies = [disc(material=stiff, viscosity=None, density=1.0), rest(material=fluid, viscosity=thin)]
    ledger = swirling(0.25, bodies=bodies, halvings=0, velocity_scale=1.0).run(0.2)
    energy = ledger.column("kinetic") + ledger.column("stored")
    assert np.diff(energy).max() <= 0 <= ledger.column("bregman").min()
    assert energy[0] - energy[-1] <= 0.02 * ledger.column("kinetic")[0]


@pytest.mark.parametrize("bounded", [True, False])
def test_density_at_points_is_at_least_half_of_the_lightest_body_s(bounded, monkeypatch):
    """If the means of the density exceed half of the lightest body's density, so does the density at each
    point. With the bound rho > 0 alone (the control), the density falls further."""
    if not bounded:
        monkeypatch.setattr(Mixture, "positive", lambda self, z: {"": {"N": self.fractions.total(z)}})
    bodies = [disc(density=1.0), rest(density=0.2)]
    ledger = swirling(0.3, 0.04, bodies=bodies, velocity_scale=1.0).run(0.2)
    assert (ledger.column("rho_min").min() >= 0.5 * 0.2 * 0.9) == bounded  # N is at least 0.9


BY_J_MIN = nv.ReferentialNeoHookean(K_e=20.0, G_e=0.05, J_min=0.1)
DOUBLE_WELL = nv.CustomMaterial(
    transported=(Jacobian(),), stored_energy=lambda J: (J - 1) ** 4 - 5 * (J - 1) * (J - 1) + 3 / J
)


class SharesOnly:
    """A shape that gives shares of cells but no surface, so that it cannot cover other shapes."""

    def inside(self, mesh):
        return CF(1.0)


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: [disc(name="a b")], "Body.name"),
        (lambda: [disc(), disc()], r"bodies\[1\].name = 'disc': .*a name that no other body has"),
        (lambda: [disc(), rest(name="disc_momentum")], "other names.*'disc_momentum'"),
        (lambda: [rest(), rest(name="other")], r"bodies\[1\].where = None: .*a place, since 'rest' without"),
        (lambda: [disc(where="here"), rest()], r"bodies\['disc'\].where"),
        (lambda: [disc(where=nv.Ball), rest()], r"bodies\['disc'\].where.*a shape"),
        (lambda: [disc(where=SharesOnly()), rest()], r"bodies\['disc'\].where.*a shape"),
        (lambda: [disc(where=CF((x, y))), rest()], r"bodies\['disc'\].where"),
        (lambda: [disc(density=None), rest()], r"bodies\['disc'\].density.*a body has mass"),
        (lambda: [disc(density=-1.0), rest()], r"bodies\['disc'\].density"),
        (lambda: [disc(material=None), rest()], r"bodies\['disc'\].material"),
        (lambda: [disc(order=0.5), rest()], r"bodies\['disc'\].order"),
        (lambda: [disc(where=nv.Ball((3.0, 3.0), 0.2)), rest()], r"disc'\].where.*within the domain"),
        (lambda: [disc(), disc(name="over", where=nv.Ball((0.5, 0.5), 0.2)), rest()], r"'over'\].order"),
        (lambda: [disc()], "in no body"),
        (lambda: [rest(order=1), disc()], r"bodies\['rest'\].order.*what all other bodies leave"),
        (lambda: [disc(where=CF(1.0) + 0 * x), rest()], r"bodies\['disc'\].where.*a smaller place"),
        (lambda: [disc(), rest(material=nv.NeoHookean(K_e=1.0, G_e=1.0, epsilon=0.1))], "per reference"),
        (lambda: [disc(), rest(material=nv.LinearElastic(K_e=1.0, G_e=1.0))], "of these. At small strains"),
        (lambda: [disc(material=BY_F), rest()], r"bodies\['disc'\].material.*elastic_state"),
        (lambda: [disc(material=VARIED), rest()], "a material whose bulk modulus is a number"),
        (lambda: [disc(material=nv.Yosida(material=SOLID, eps=0.01)), rest()], "Yosida approximation"),
        (lambda: [disc(material=BY_J_MIN), rest()], "without J_min.*PerReferentialVolume.* around"),
        (lambda: [disc(material=HOT_BREAKS), rest()], r"bodies\['disc'\].material.*does not give the damage"),
        (lambda: [disc(material=QUADRATIC), rest()], r"bodies\['disc'\].material.*also around WithQuadratic"),
        (lambda: [disc(creep=nv.Creep(G_m=1.0, nu=0.1)), rest()], "nu = 0, since the creep .* gradient"),
        (lambda: [disc(), rest(material=DOUBLE_WELL)], r"bodies\['rest'\].material.*per reference volume"),
        (disc, r"Model\.bodies"),
    ],
)  # fmt: skip
def test_bad_bodies_are_refused_by_name(make, match):
    with pytest.raises(nv.NgviscoError, match=match):
        small_run(bodies=make())


@pytest.mark.parametrize("regularised", ["J_min", by_ci("delta")])
def test_bodies_are_regularised_per_referential_volume(regularised):
    """``PerReferentialVolume`` around a regularised energy keeps convexity: no remainder is negative."""
    law = nv.NeoHookean(K_e=10.0, G_e=1.0, epsilon=0.1, J_min=2.0 if regularised == "J_min" else None)
    changed = nv.WithQuadratic(material=law, delta=1e-2, only=("J",)) if regularised == "delta" else law
    swirl, stored = CF((sin(pi * x) * cos(pi * y), -cos(pi * x) * sin(pi * y))), []
    for material in (changed, replace(law, J_min=None)):
        bodies = [disc(material=nv.PerReferentialVolume(material=material)), rest()]
        runs = [small_run(bodies=bodies, velocity=swirl, solver=s) for s in ("coupled", "split")]
        for run in runs:
            run.run(2 * run.dt)
            assert abs(run.ledger.column("closure_relative")).max() < 1e-10
            assert run.ledger.column("bregman").min() >= 0
        stored.append([run.ledger.column("stored")[-1] for run in runs])
    assert stored[0] == pytest.approx([stored[0][0]] * 2, rel=1e-8)
    assert abs(stored[0][0] / stored[1][0] - 1) > 1e-6


class Growth(PointTerm):
    """A source of mass, 1 kg/(m^3 s), that names no body."""

    def cells(self, u, w):
        return [-1.0 * w.rho]


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"viscosity": STOKES}, r"Model.viscosity.*None with bodies"),
        ({"density": 1.0}, r"Initial.density.*None, since each body has a density"),
        ({"regularisation": nv.Regularisation(rho_max=2.0)}, "rho_max.* density of bodies is a sum"),
        (
            {"regularisation": nv.Regularisation(delta_density=1e-3)},
            "delta_density.* density of bodies is a sum",
        ),
        (
            {"terms": [Growth()], "solver": "coupled"},
            r"Growth has a row of rho, .* with bodies the density is not an unknown",
        ),
    ],
)
def test_arguments_of_a_model_without_bodies_are_refused_in_a_model_with_bodies(options, match):
    with pytest.raises(nv.ParameterError, match=match):
        small_run(bodies=[disc(), rest()], **options)


@pytest.mark.long
@pytest.mark.ci
def test_fields_of_bodies_diffuse_only_with_one_volumetric_energy():
    """Diffusion has a column and changes no body's mass; other bodies are refused with a remedy."""
    diffusing = {"regularisation": nv.Regularisation(delta_fields=1e-2)}
    runs = by_both_solvers(lambda solver: simulation("solid in a fluid", solver, **diffusing), 0.04)
    for run in runs:
        start = masses(simulation("solid in a fluid"))
        assert np.abs(masses(run) / start - 1).max() <= 1e-12
        assert run.ledger.rows[-1]["dissipation_delta_fields"] > 0
    soft = nv.CustomMaterial(transported=(Jacobian(),), stored_energy=lambda J: J - 2 + 1 / J)
    with pytest.raises(nv.ParameterError, match=r"delta_fields.*give all bodies the same volumetric energy"):
        small_run(bodies=[disc(), rest(material=soft)], **diffusing)


@pytest.mark.long
@pytest.mark.ci
def test_both_solvers_keep_the_masses_of_a_ball_in_three_dimensions():
    """Two steps on a few tetrahedra."""
    parts = [disc(where=nv.Ball((0.5, 0.5, 0.5), 0.35)), rest()]
    make = partial(swirling, box((1, 1, 1), maxh=0.8), bodies=parts)
    start = masses(make())
    for run in by_both_solvers(lambda solver: make(solver=solver), 0.04, 1e-10):
        assert np.abs(masses(run) / start - 1).max() <= 1e-12


@pytest.mark.parametrize(("K_e", "m", "warns"), [(0.4, 1, True), (0.4, 0, False), (2.0, 1, False)])
def test_bulk_moduli_that_differ_much_are_warned_of_by_name(K_e, m, warns):
    soft = nv.CustomMaterial(transported=(Jacobian(),), stored_energy=lambda J: K_e / 2 * (J - 2 + 1 / J))
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        small_run(bodies=[disc(), rest(material=soft)], discretisation=nv.Discretisation(m=m))
    found = [str(one.message) for one in said if "common pressure" in str(one.message)]
    assert len(found) == warns
    assert all("'disc' and 'rest' have bulk moduli of 10 and 0.4 Pa" in text for text in found), found


@pytest.mark.parametrize(
    ("options", "error"),
    [
        by_ci({"solver": "split"}, 0.01),
        ({"solver": "coupled", "stiffer": "low"}, 0.01),
        ({"solver": "split", "k": 1}, 0.05),
        ({"solver": "split", "sharp": True}, 0.03),
    ],
)
def test_elastic_layers_with_a_face_inside_a_cell_are_in_series(options, error):
    """Layers with shear moduli of 1 : 10 are sheared; their face is in the middle of the third of five cells.

    With one strain rate in this cell, the force is 9 per cent too large, with k = 1 15 and with sharp
    interfaces 6 per cent.
    """
    k, shear, face = options.get("k", 2), 5e-3, 0.5
    moduli = {"low": 1.0, "high": 1.0} | {options.get("stiffer", "high"): 10.0}

    def layer(name, where=None):
        material = nv.ReferentialNeoHookean(K_e=50.0, G_e=moduli[name] / 2)
        thin = nv.StokesViscosity(K_v=1e-4, G_v=1e-4)
        return nv.Body(name=name, where=where, material=material, viscosity=thin, density=1e-3, layered=True)

    run = nv.Simulation(
        structured_box((0.2, 1.0), (1, 5), periodic="x"),
        nv.Model(bodies=[layer("low", face - y), layer("high")]),
        dt=0.5,
        walls={"top": nv.PrescribedTangential((shear, 0)), "bottom": nv.NoSlip()},
        solver=options["solver"],
        discretisation=nv.Discretisation(k=k, m=k - 1, sharp=options.get("sharp", False)),
        newton=nv.NewtonOptions(tolerance=1e-11),
    )
    ledger = run.run(1.0)
    exact = shear / (face / moduli["low"] + (1 - face) / moduli["high"])
    assert ledger.column("power_wall_top")[-1] / (0.2 * shear) == pytest.approx(exact, rel=error)
    assert abs(ledger.column("closure_relative")).max() <= 1e-12
    assert ledger.column("bregman")[1:].min() >= -1e-15 * ledger.column("stored")[0]


def test_layered_solids_of_one_modulus_have_this_modulus_wherever_they_meet():
    """sum theta chi^2 is one for any fractions of layered solids, and less than one for others."""
    for layered in (True, False):
        bodies = [disc(layered=layered), rest(material=SOLID, layered=layered)]
        mixture = nv.Model(bodies=bodies).material
        for share in (-0.2, 0.02, 0.15, 0.3, 0.9):
            z = {AMOUNT + "disc": Array(np.array([share])), AMOUNT + "rest": Array(np.array([1 - share]))}
            theta, chi = mixture.fractions.not_negative(z), mixture.taking_part(z)
            total = sum(theta[name] * chi[f"B_{name}"] * chi[f"B_{name}"] for name in theta)
            assert layered == (float(total.value[0]) == pytest.approx(1.0, abs=1e-12)) or share < 0


def test_derivatives_of_runs_with_layered_bodies_are_refused():
    bodies = [disc(layered=True), rest(material=SOLID, layered=True)]
    run = nv.Simulation(box((1, 1), 0.5), nv.Model(bodies=bodies), dt=0.1)
    with pytest.raises(nv.ParameterError, match="layered bodies"):
        nv.gradient(run, 0.1, of=["kinetic at 0.1"], by=["bodies.disc.material.G_e"])


@pytest.mark.parametrize(
    "bodies",
    [
        [disc(layered=True), rest()],
        [disc(layered=True), rest(layered=True)],
        [disc(layered=True, parts=True), rest(material=SOLID, layered=True)],
        [disc(layered=True, creep=nv.Creep(G_m=0.1)), rest(material=SOLID, layered=True)],
    ],
)
def test_layered_bodies_are_several_elastic_bodies_that_do_not_part(bodies):
    with pytest.raises(nv.ParameterError, match=r"bodies\['(disc|rest)'\]\.(layered|parts)"):
        nv.Simulation(box((1, 1), 0.5), nv.Model(bodies=bodies), dt=0.1)


@pytest.mark.parametrize(
    ("solver", "viscosities", "k"),
    [
        by_ci("split", (1.0, 10.0), 2),
        ("coupled", (10.0, 1.0), 2),
        by_ci("coupled", (1.0, 10.0), 1),
        ("split", (10.0, 1.0), 1),
    ],
)
def test_layers_that_meet_inside_a_cell_act_in_series(solver, viscosities, k):
    """A Couette flow has two layers, whose face is in the middle of a cell.

    With the arithmetic mean in this cell, the force is 7 per cent too large. With constants in cells, the
    force is 8 and 10 per cent too large. In the cell of the face, the computed shear rate changes linearly
    from one layer's to the other's, whereas the exact shear rate jumps by D. The velocity at the face is
    therefore D h/8 off, 2.3 and 2.8 per cent. So the force, the velocity beside this cell and the mean
    velocity are right within 2 per cent, but the velocity in the cell is not. The best parabola between the
    cell's ends is 0.037 D h off, and its rates at the ends are outside of the range of both layers. At the
    face, a velocity of order 1 is D h/4 off, whatever its rate is.
    """
    face, (low, high) = 0.5625, viscosities
    stress = 1 / (face / low + (1 - face) / high)
    exact = IfPos(face - y, stress / low * y, 1 - stress / high * (1 - y))
    matter = nv.CustomMaterial(transported=(Jacobian(),), stored_energy=lambda J: 50 * (J - 2 + 1 / J))

    def layer(name, G_v, where=None):
        viscosity = nv.StokesViscosity(K_v=G_v, G_v=G_v)
        return nv.Body(name=name, where=where, material=matter, viscosity=viscosity, density=1.0)

    run = nv.Simulation(
        structured_box((0.25, 1.0), (2, 8), periodic="x"),
        nv.Model(bodies=[layer("low", low, face - y), layer("high", high)]),
        dt=2.0,
        initial=nv.Initial(velocity=CF((exact, 0))),
        walls={"top": nv.PrescribedTangential((1.0, 0)), "bottom": nv.NoSlip()},
        solver=solver,
        discretisation=nv.Discretisation(k=k, m=k - 1),
        newton=nv.NewtonOptions(tolerance=1e-12),
    )
    ledger = run.run(8.0)
    assert ledger.column("power_wall_top")[-1] == pytest.approx(0.25 * stress, rel=1e-3)
    assert abs(ledger.column("closure_relative")).max() <= 1e-11
    at = np.linspace(0.05, 0.95, 145)
    off = [run.fields["velocity"](run.mesh(0.06, place))[0] - exact(run.mesh(0.06, place)) for place in at]
    is_beside, off = (at < 0.5) | (at > 0.625), np.abs(off)
    # the errors are 0.0232 and 0.0285 with 8 cells and k = 2
    missed = stress * abs(1 / low - 1 / high) / 8 / (4 * k)
    assert off[is_beside].max() <= 0.001 and np.sqrt(np.mean(off**2)) <= 0.25 * missed
    through = Integrate(run.fields["velocity"][0], run.mesh)
    mean = stress / low * face**2 / 2 + (1 - face) - stress / high * (1 - face) ** 2 / 2
    assert through == pytest.approx(0.25 * mean, rel=0.02)
    assert 0.9 * missed <= off.max() <= 1.05 * missed
