"""Density and J of materials with a referential density, and further laws of case files."""

from pathlib import Path

import numpy as np
import pytest
from ngsolve import CF, Det, x

import ngvisco as nv
from ngvisco.case.build import parse_case
from ngvisco.geometries import box

MESH = box((1, 1), maxh=0.6)
FLUID = nv.BarotropicFluid.from_state_equation(a=3.0, gamma=1.7, rho_R=2.5)
SOLID = nv.PerMass(material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1, elastic_state="F"), rho_R=2.5)
F_0 = CF((1.1, 0.1, 0, 0, 0.9, 0, 0, 0, 1), dims=(3, 3))


def started(material, **initial):
    return nv.Simulation(MESH, nv.Model(material=material), dt=0.1, initial=nv.Initial(**initial))


def at(run, f):
    return np.array(f(MESH(0.3, 0.4))).reshape(tuple(f.dims) or ())


def test_J_follows_from_the_density():
    run = started(FLUID, density=2.5 + x)
    J, rho = (run.sampler.values(run.fields[name]) for name in ("J", "density"))
    assert J * rho == pytest.approx(2.5, rel=0.02)  # J and rho are projections
    assert at(run, run.fields["pressure"]) == pytest.approx(3 * 2.8**1.7, rel=0.02)
    run = started(SOLID, density=2.0)
    assert at(run, run.fields["A"]) == pytest.approx(0.8, rel=1e-13)
    assert at(run, run.fields["AF"]) == pytest.approx(0.8 * 1.25 ** (1 / 3) * np.eye(3), rel=1e-13)


@pytest.mark.parametrize(
    ("material", "initial", "density"),
    [
        (FLUID, {}, 2.5),
        (FLUID, {"values": {"J": 1.25}}, 2.0),
        (SOLID, {}, 2.5),
        (SOLID, {"F": F_0}, 2.5 / 0.99),
        (nv.BarotropicFluid(B=1.0, gamma=1.4), {}, 1.0),
    ],
)
def test_the_density_follows_from_J(material, initial, density):
    run = started(material, **initial)
    assert at(run, run.fields["density"]) == pytest.approx(density, rel=1e-13)


def test_density_and_J_may_both_be_given_if_they_agree():
    started(SOLID, F=F_0, density=2.5 / Det(F_0))
    started(FLUID, values={"J": 1.25}, density=2.0)
    # without rho_R, density and J are independent
    started(nv.BarotropicFluid(B=1.0, gamma=1.4), values={"J": 1.25}, density=7.0)


@pytest.mark.parametrize(
    ("material", "initial"),
    [
        (FLUID, {"values": {"J": 1.25}, "density": 2.5}),
        (FLUID, {"values": {"J": 1.25 + 0.001 * x}, "density": 2.0}),
        (SOLID, {"F": F_0, "density": 2.5}),
        (nv.Yosida(material=FLUID, eps=1e-3), {"values": {"J": 1.25}, "density": 2.5}),
    ],
)
def test_a_density_that_contradicts_J_is_refused(material, initial):
    with pytest.raises(
        nv.InitialDataError, match=r"rho_0 J_0 is from .*expected rho_0 J_0 = rho_R, which is 2.5"
    ):
        started(material, **initial)


def test_energy_per_mass_runs_with_a_closed_ledger_and_rho_stays_rho_R_A():
    model = nv.Model(
        material=SOLID, viscosity=nv.StokesViscosity(K_v=0.5, G_v=0.5), loads=[nv.Gravity((0.0, -1.0))]
    )
    found = []
    for solver in ("coupled", "split"):
        run = nv.Simulation(MESH, model, dt=0.05, initial=nv.Initial(), solver=solver)
        ledger = run.run(0.2)
        assert np.abs(ledger.column("closure_relative")).max() < 1e-9
        assert ledger.column("bregman").min() >= -1e-12
        A, rho = (run.sampler.values(run.fields[name]) for name in ("A", "density"))
        assert rho == pytest.approx(2.5 * A, rel=2e-3)
        found.append(ledger.column("kinetic"))
    assert found[0] == pytest.approx(found[1], rel=1e-7)


def test_D_that_leaves_the_plane_is_refused_in_two_dimensions():
    D = np.eye(6)
    D[0, 3] = D[3, 0] = 0.1
    law = nv.LinearViscosity(D=D, notation="voigt")
    model = nv.Model(material=FLUID, viscosity=law)
    with pytest.raises(nv.ParameterError, match=r"LinearViscosity.D = .*D_13kl = D_23kl = 0"):
        nv.Simulation(MESH, model, dt=0.1)
    nv.Simulation(box((1, 1, 1), maxh=2), model, dt=0.1)


CASE = """\
[domain]
geometry = "box"
size = [1, 1]
maxh = 0.6
[material]
kind = "IsentropicFluid"
a = 3.0
gamma = 1.7
rho_R = 2.5
[rheology.viscosity]
kind = "LinearViscosity"
D = [[3, 1, 1, 0, 0, 0], [1, 3, 1, 0, 0, 0], [1, 1, 3, 0, 0, 0],
     [0, 0, 0, 1, 0, 0], [0, 0, 0, 0, 1, 0], [0, 0, 0, 0, 0, 1]]
notation = "voigt"
[initial]
density = "2.5 + 0.1*x"
[time]
dt = 0.02
until = 0.04
"""


def case(*settings):
    return parse_case(CASE, "case", Path("."), settings)


def built(*settings):
    made = case(*settings)
    return made.simulation(made.mesh())


def test_a_case_may_have_a_fluid_by_its_state_equation():
    run = built()
    assert at(run, run.fields["pressure"]) == pytest.approx(3 * 2.53**1.7, rel=1e-3)
    assert (run.model.viscosity.K_v, run.model.viscosity.G_v) == (pytest.approx(5 / 3), pytest.approx(1.0))
    assert run.model.material.rho_R == 2.5
    by_unit = case('material.a="3 kPa*(m^3/kg)^1.7"').model(2).material
    assert pytest.approx(1000 * run.model.material.B) == by_unit.B


def test_hash_of_a_case_without_a_density_is_that_of_the_default():
    plain = CASE.replace('density = "2.5 + 0.1*x"', "").replace(
        'kind = "IsentropicFluid"\na = 3.0\ngamma = 1.7\nrho_R = 2.5',
        'kind = "LinearElastic"\nK_e = 1\nG_e = 1',
    )
    without, given = (
        parse_case(text, "case", Path("."))
        for text in (plain, plain.replace("[initial]", "[initial]\ndensity = 1.0"))
    )
    assert without.hash == given.hash and without.resolved == given.resolved


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ('initial.values={J="1.1"}', ["initial.density", "rho_0 J_0 is from 2.75"]),
        ("material.gamma=900", ["material.a", "finite"]),
        ("rheology.viscosity.D=[[1, 2], [3, 4]]", ["rheology.viscosity.D", "6x6"]),
        ("rheology.viscosity.D=[[1, 'a']]", ["rheology.viscosity.D", "the entry 'a'"]),
        ("rheology.viscosity.notation='kelvin'", ["rheology.viscosity.notation"]),
    ],
)
def test_faults_of_referential_densities_are_refused_under_their_keys(setting, words):
    with pytest.raises(nv.CaseError) as caught:
        built(setting)
    assert all(word in str(caught.value) for word in words), str(caught.value)


CUSTOM = """\
[domain]
geometry = "box"
size = [1, 1]
maxh = 0.6
[material]
kind = "Custom"
variables = ["F", "J"]
energy = "5*norm2(F)/J**(2/3) + 20*(J - 1)**2"
per = "mass"
rho_R = 2.0
[time]
dt = 0.02
until = 0.04
"""


def test_an_energy_per_mass_is_multiplied_by_the_referential_density():
    def material(*settings, head=""):
        return parse_case(head + CUSTOM, "case", Path("."), settings).model(2).material

    z = {"AF": 0.9 * F_0, "A": CF(0.9)}
    per_mass, per_volume = material(), material('material.per="referential volume"')
    found = [float(at(None, m.energy(z))) for m in (per_mass, per_volume)]
    assert isinstance(per_mass, nv.PerMass) and found[0] == pytest.approx(2 * found[1], rel=1e-14)
    # [units] changes the unit of an energy per volume, but has no unit for J/kg
    kilo = '[units]\npressure = "kPa"\n'
    scaled = [material(head=kilo), material('material.per="referential volume"', head=kilo)]
    assert [float(at(None, m.energy(z))) for m in scaled] == pytest.approx([found[0], 1000 * found[1]])
    with pytest.raises(nv.CaseError, match=r"material.rho_R.*for an energy per mass"):
        parse_case(CUSTOM.replace("rho_R = 2.0\n", ""), "case", Path("."))
    with pytest.raises(nv.CaseError, match=r"material.variables.*'E' is none of these"):
        material('material.variables=["E"]', 'material.energy="norm2(E)"')
